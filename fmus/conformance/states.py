"""Points of stored states: taken, set, as bytes, and in another process."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from bristle.fmus.answer import read_answer, write_answer
from bristle.fmus.conformance.instance import Subject
from bristle.fmus.conformance.running import STEPS, Array, Run, ask, behaviour, differing, tuned

STORE = ("canGetAndSetFMUstate", "canGetAndSetFMUState")
FILLED = {"MALLOC_PERTURB_": "85"}  # of glibc: fills what is allocated
EMPTY: Mapping[str, str] = {}
SERIALISE = ("canSerializeFMUstate", "canSerializeFMUState")


def _begun(subject: Subject) -> Run:
    """Return a run that has done half the steps."""
    run = tuned(subject)
    run.steps(STEPS // 2)
    return run


def _place(run: Run) -> tuple[float, int]:
    return run.t, run.k


def _from(run: Run, place: tuple[float, int], n: int = STEPS) -> Array:
    """Return outputs from a place on."""
    run.t, run.k = place
    return run.steps(n)


@behaviour("run-state", "a stored state continues as before")
def _state(subject: Subject) -> Iterator[str]:
    ask(subject, *STORE)
    with _begun(subject) as run:
        place, state, inputs = _place(run), run.instance.get_state(), run.input_values()
        expected = run.steps()
        run.instance.set_state(state)
        for name, value in run.input_values().items():
            if value != inputs[name]:
                yield f"{name}: {value:.17g} instead of {inputs[name]:.17g}"
        yield from differing(run.columns, expected, _from(run, place))
        run.instance.free_state(state)


@behaviour(
    "run-state-again",
    "a stored state can be set several times, after a reset, too, and be filled again",
)
def _state_again(subject: Subject) -> Iterator[str]:
    ask(subject, *STORE)
    with _begun(subject) as run:
        place, state = _place(run), run.instance.get_state()
        expected = run.steps()
        for reset in (False, True):
            if reset:
                run.instance.do("Reset")
            run.instance.set_state(state)
            yield from differing(run.columns, expected, _from(run, place))
        later = _place(run)
        state = run.instance.get_state(state)
        expected = run.steps(3)
        run.instance.set_state(state)
        yield from differing(run.columns, expected, _from(run, later, 3))
        run.instance.free_state(state)


@behaviour("run-bytes", "a state as bytes continues as before in another instance")
def _bytes(subject: Subject) -> Iterator[str]:
    ask(subject, *SERIALISE)
    with _begun(subject) as run:
        place, state = _place(run), run.instance.get_state()
        data = run.instance.serialise(state)
        run.instance.free_state(state)
        expected = run.steps()
    with Run(subject) as run:
        run.begin()
        state = run.instance.deserialise(data)
        run.instance.set_state(state)
        run.instance.free_state(state)
        yield from differing(run.columns, expected, _from(run, place))


@behaviour("run-process", "a state as bytes continues as before in another process")
def _process(subject: Subject) -> Iterator[str]:
    ask(subject, *SERIALISE)
    with _begun(subject) as run:
        place, data = _place(run), run.instance.serialise(run.instance.get_state())
        yield from _elsewhere(run, run.steps(), data, place)


@behaviour(
    "run-uninitialised", "it gives the same digits where memory that it allocates is not zero"
)
def _uninitialised(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin()
        place = _place(run)
        yield from _elsewhere(run, run.steps(), b"", place, FILLED)


def _elsewhere(
    run: Run,
    expected: Array,
    data: bytes,
    place: tuple[float, int],
    environment: Mapping[str, str] = EMPTY,
) -> Iterator[str]:
    """Give what differs in another process, which continues from a state as bytes, or begins where
    there is none.
    """
    with tempfile.TemporaryDirectory() as folder:
        work, answer = Path(folder, "work"), Path(folder, "answer")
        write_answer(
            work,
            [
                str(run.subject.path),
                str(run.subject.folder),
                np.frombuffer(data, dtype=np.uint8),
                list(place),
            ],
        )
        command = [
            sys.executable,
            "-P",
            "-c",
            f"from {__name__} import continued; continued()",
            str(work),
            str(answer),
        ]
        subprocess.run(
            command, check=False, stdin=subprocess.DEVNULL, env={**os.environ, **environment}
        )
        found = read_answer(answer)
    if found is None:
        yield "the other process ends without an answer"
    elif isinstance(found, str):
        yield found
    else:
        yield from differing(run.columns, expected, found)


def continued() -> None:
    """Continue in this process from a state of another one; the program's arguments are the files
    of task and answer.
    """
    work, answer = map(Path, sys.argv[1:3])
    path, folder, data, (t, k) = read_answer(work)
    try:
        with Run(Subject(Path(path), Path(folder))) as run:
            run.begin()
            if len(data):
                run.instance.set_state(run.instance.deserialise(data.tobytes()))
            found: Array | str = _from(run, (t, k))
    except Exception as error:  # whatever it is, the process that asked tells it
        found = " ".join(str(error).split()) or type(error).__name__
    write_answer(answer, found)
