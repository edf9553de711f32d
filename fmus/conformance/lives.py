"""Points of instances: lives, several at once, what they leave behind, where they are unpacked."""

from __future__ import annotations

import ctypes
import gc
import os
import shutil
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bristle.fmus.conformance.instance import CallFailed, Options, Subject
from bristle.fmus.conformance.registry import Severity
from bristle.fmus.conformance.running import (
    STEPS,
    NotApplicable,
    Run,
    ask,
    ask_several,
    behaviour,
    differing,
    fresh,
    steps_within,
    tuned,
)
from bristle.fmus.conformance.states import STORE

LIVES = 40  # of an instance, over which memory may not grow
FIRST_LIVES = 10  # after which memory in use is first looked at
LIVES_SECONDS = 5.0  # s that lives may take
ALLOWED_GROWTH = 48  # bytes a life, which are less than those of an instance
ALLOWED_HANDLES = 10  # files or threads that lives may leave
THREAD_STEPS = 200  # steps of the instances that run in threads
SIGNALS_OF_GLIBC = 0b11 << 31  # numbers 32 and 33, which it takes when a thread begins
SWITCH_INTERVAL = 1e-5  # s between two looks of Python at its other threads


@behaviour("run-life", "it is loaded, instantiated, initialised, stepped and freed")
def _life(subject: Subject) -> Iterator[str]:
    try:
        fresh(subject)
    except CallFailed:
        try:  # it may say more
            fresh(subject, Options(logging=True))
        except CallFailed as again:
            error = again
        yield str(error)


@behaviour("run-again", "a second instance gives the same digits")
def _again(subject: Subject) -> Iterator[str]:
    ask_several(subject)
    with Run(subject) as run:
        yield from differing(run.columns, fresh(subject), fresh(subject))


@behaviour("run-reload", "unloaded and loaded again, it gives the same digits")
def _reload(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        columns = run.columns
        run.begin()
        expected = run.steps()
    _unload(subject.library)
    del subject.library
    yield from differing(columns, expected, fresh(subject))


def _unload(library: ctypes.CDLL) -> None:
    from fmpy import freeLibrary

    freeLibrary(library._handle)


@behaviour("run-reset", "after a reset it is as new")
def _reset(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin()
        inputs, expected = run.input_values(), run.steps()
    with tuned(subject) as run:
        run.steps()
        run.instance.do("Reset")
        run.begin()
        for name, value in run.input_values().items():
            if value != inputs[name]:
                yield f"{name}: {value:.17g} instead of {inputs[name]:.17g}"
        yield from differing(run.columns, expected, run.steps())


@behaviour("run-two", "two instances at once do not disturb each other")
def _two(subject: Subject) -> Iterator[str]:
    ask_several(subject)
    with tuned(subject) as alone:
        expected = alone.steps(STEPS + STEPS // 2), fresh(subject)
    with ExitStack() as stack:
        first = stack.enter_context(tuned(subject))
        early = first.steps(STEPS // 2)
        second = stack.enter_context(Run(subject, Options(name=b"two")))
        second.begin()
        found: tuple[list[Any], list[Any]] = [*early], [second.outputs()]
        for _ in range(STEPS):
            for run, rows in zip((first, second), found, strict=True):
                rows.append(run.step())
        for which, other in zip(expected, found, strict=True):
            yield from differing(first.columns, which, np.array(other, dtype=float))


@behaviour("run-threads", "two instances in two threads do not disturb each other")
def _threads(subject: Subject) -> Iterator[str]:
    ask_several(subject)
    n = steps_within(subject, THREAD_STEPS)
    expected, found = fresh(subject, n=n), list[Any]([None, None])
    sys.setswitchinterval(SWITCH_INTERVAL)
    with ExitStack() as stack:
        runs = [stack.enter_context(Run(subject, Options(name=name))) for name in (b"one", b"two")]
        for run in runs:
            run.begin()
        gate = threading.Barrier(2)

        def work(k: int) -> None:
            gate.wait()
            found[k] = runs[k].steps(n)

        threads = [threading.Thread(target=work, args=(k,)) for k in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for rows in found:
            yield from (
                ["a thread failed"] if rows is None else differing(runs[0].columns, expected, rows)
            )


# -- what they leave behind ------------------------------------------------------------------------


class _Mallinfo(ctypes.Structure):
    """What glibc says of allocated memory."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "mapped",
            "usmblks",
            "fsmblks",
            "used",
            "fordblks",
            "keepcost",
        )
    ]


def _ask_allocated() -> Callable[[], int]:
    """Return a function that gives the bytes that are allocated, or NotApplicable where the C
    library does not tell.
    """
    question = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if question is None:
        raise NotApplicable("the C library does not say how much memory is allocated")
    question.restype = _Mallinfo

    def allocated() -> int:
        gc.collect()
        answer = question()
        return int(answer.used + answer.mapped)

    return allocated


def _grown(life: Callable[[], None], used: Callable[[], int]) -> int:
    """Return by how much what is in use grows over LIVES after the first ones."""
    begun = time.monotonic()
    for _ in range(FIRST_LIVES):
        life()
    if (time.monotonic() - begun) / FIRST_LIVES * LIVES > LIVES_SECONDS:
        raise NotApplicable(f"{LIVES} lives of it take longer than {LIVES_SECONDS:g} s")
    before = used()
    for _ in range(LIVES):
        life()
    return used() - before


def _ask_proc() -> None:
    if not Path("/proc/self/statm").exists():
        raise NotApplicable("this system does not say what is in use")


def _new_life(subject: Subject) -> None:
    with Run(subject) as run:
        run.begin()
        run.steps(2)


@behaviour("run-memory", "allocated memory does not grow from reset to reset", Severity.warning)
def _memory(subject: Subject) -> Iterator[str]:
    used = _ask_allocated()
    with Run(subject) as run:

        def life() -> None:
            run.begin()
            run.steps(2)
            run.instance.do("Terminate")
            run.instance.do("Reset")

        grown = _grown(life, used)
    if grown > ALLOWED_GROWTH * LIVES:
        yield f"{grown / LIVES:.0f} bytes a life"


@behaviour(
    "run-freed", "allocated memory does not grow from instance to instance", Severity.warning
)
def _freed(subject: Subject) -> Iterator[str]:
    ask_several(subject)
    grown = _grown(lambda: _new_life(subject), _ask_allocated())
    if grown > ALLOWED_GROWTH * LIVES:
        yield f"{grown / LIVES:.0f} bytes an instance"


@behaviour(
    "run-states-freed",
    "allocated memory does not grow with states that are stored and freed",
    Severity.warning,
)
def _states_freed(subject: Subject) -> Iterator[str]:
    ask(subject, *STORE)
    used = _ask_allocated()
    with Run(subject) as run:
        run.begin()
        grown = _grown(lambda: run.instance.free_state(run.instance.get_state()), used)
    if grown > ALLOWED_GROWTH * LIVES:
        yield f"{grown / LIVES:.0f} bytes a state"


def _entries(folder: str) -> int:
    return len(os.listdir(folder))


@behaviour("run-handles", "neither open files nor threads are left by instances", Severity.warning)
def _handles(subject: Subject) -> Iterator[str]:
    _ask_proc()
    ask_several(subject)
    for what, folder in (("open files", "fd"), ("threads", "task")):
        left = _grown(partial(_new_life, subject), partial(_entries, f"/proc/self/{folder}"))
        if left > ALLOWED_HANDLES:
            yield f"{left} {what} after {LIVES} instances"


def _environment() -> dict[str, str]:
    """Return what an FMU shares with its host and should leave alone."""
    library = ctypes.CDLL(None)
    library.setlocale.restype = ctypes.c_char_p
    files = os.umask(0)
    os.umask(files)
    seen = {
        "working directory": os.getcwd(),
        "locale": (library.setlocale(6, None) or b"").decode(),  # LC_ALL of glibc
        "file mode mask": oct(files),
        "rounding": str(_rounding()),
        "subnormal numbers": "kept"
        if float(np.float64(1e-310) * np.float64(0.5)) > 0
        else "flushed to zero",
    }
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(("SigBlk", "SigIgn", "SigCgt")):
            name, mask = line.split()
            seen[f"signals {name.rstrip(':')}"] = f"{int(mask, 16) & ~SIGNALS_OF_GLIBC:016x}"
    return seen


def _rounding() -> int:
    try:
        return int(ctypes.CDLL("libm.so.6").fegetround())
    except OSError:
        return 0


@behaviour(
    "run-environment",
    "it leaves directory, locale, signals and floating-point modes of its host alone",
    Severity.warning,
)
def _surroundings(subject: Subject) -> Iterator[str]:
    _ask_proc()
    before = _environment()
    fresh(subject)
    after = _environment()
    yield from (
        f"{name}: {before[name]} became {after[name]}"
        for name in before
        if before[name] != after[name]
    )


def _files(folder: Path) -> dict[str, tuple[int, int]]:
    found = {}
    for path in folder.rglob("*"):
        state = path.lstat()
        if stat.S_ISREG(state.st_mode):
            found[str(path.relative_to(folder))] = state.st_size, state.st_mtime_ns
    return found


@behaviour(
    "run-files", "it writes no files beside its host's or into its own folder", Severity.warning
)
def _no_files(subject: Subject) -> Iterator[str]:
    with tempfile.TemporaryDirectory() as place:
        moved = _moved(subject, Path(place) / "fmu")
        working = Path(place) / "work"
        working.mkdir()
        os.chdir(working)
        before = _files(Path(place))
        fresh(moved)
        after = _files(Path(place))
        os.chdir(Path(__file__).anchor)
    yield from (f"{name} is written" for name in sorted(after) if after[name] != before.get(name))
    yield from (f"{name} is removed" for name in sorted(set(before) - set(after)))


def _moved(subject: Subject, folder: Path) -> Subject:
    """Return the FMU unpacked elsewhere."""
    shutil.copytree(subject.folder, folder)
    return Subject(subject.path, folder, subject.note)


@behaviour(
    "run-folder", "it runs from a folder with spaces and other scripts in its name, read-only"
)
def _folder(subject: Subject) -> Iterator[str]:
    with tempfile.TemporaryDirectory() as place:
        moved = _moved(subject, Path(place) / "an FMU ü µ 中 50%")
        for path in moved.folder.rglob("*"):
            path.chmod(
                0o555 if path.is_dir() or path.is_relative_to(moved.folder / "binaries") else 0o444
            )
        try:
            with Run(subject) as run:
                yield from differing(run.columns, fresh(subject), fresh(moved))
        finally:
            for path in moved.folder.rglob("*"):
                path.chmod(0o755)


@behaviour("run-quiet", "nothing is written to standard output or error", Severity.warning)
def _quiet(subject: Subject) -> Iterator[str]:
    with tempfile.TemporaryFile() as file:
        kept = [os.dup(1), os.dup(2)]
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        try:
            fresh(subject)
            ctypes.CDLL(None).fflush(None)
        finally:
            for number, old in enumerate(kept, start=1):
                os.dup2(old, number)
        file.seek(0)
        written = file.read(200)
    if written:
        yield f"it writes: {' '.join(written.decode('utf-8', 'replace').split())[:80]}"
