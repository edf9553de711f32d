"""Run a function in a process of its own, for FMUs from elsewhere: whatever one does there, this
process goes on.

The child process has a time limit, a limit on memory, on the size of a file and on what is kept of
its output; all that it starts ends with it; and it answers in plain numbers and text (`answer`).
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.work import TemporaryFolder
from bristle.fmus.answer import NOT_ASKED, read_answer
from bristle.fmus.calls import CONTROL_SIZE, Call, Control

POLL_INTERVAL = 0.05  # s between two looks at the child process
LONGEST_CALL = 60.0  # s that one call may take where no time is given
GRACE = 8.0  # s in which the child process ends what it has started
KEPT_OUTPUT = 4096  # bytes of its output that are kept, the last ones

Argument = TypeVar("Argument")
Answer = TypeVar("Answer")


def isolated(
    work: Callable[[Argument, Control], Any],
    argument: Argument,
    fmus: Sequence[Path],
    read: Callable[[Any], Answer],
    progress: Callable[[int], None] | None = None,
    timeout: float | None = None,
) -> Answer:
    """Return read(work(argument, control)), where `work` is done in a child process.

    Parameters
    ----------
    work : function of a module
        `control`, shape (CONTROL_SIZE,), is shared memory: [0] counts finished items, for
        `progress` and as a sign of life. Its answer is as of `write_answer`.
    argument : object
        Whatever can be pickled.
    fmus : sequence of Path
        The FMUs that take part; an error names the one whose call was under way.
    read : function
        Makes of the answer what is returned; an answer that it cannot read is an error of the FMUs.
    progress : function, optional
        Called now and then with the number of finished items.
    timeout : float, optional
        Seconds after which the child process is ended; without it, it is ended when one call takes
        `LONGEST_CALL`.

    Raises
    ------
    BristleError
        If the child process crashes or takes too long, or the work raises an error.
    """
    with TemporaryFolder("run") as folder:
        place = Path(folder)
        (place / "work.pkl").write_bytes(pickle.dumps((work, argument, list(fmus))))
        control = np.memmap(place / "control", dtype=np.int64, mode="w+", shape=(CONTROL_SIZE,))
        control[3] = -1
        child = _start(folder)
        output = _Output(child.stdout)
        try:
            late = _wait(child, control, progress, timeout)
            if late is not None:
                raise BristleError(_late_message(fmus, control, late, timeout))
        finally:
            _end(child)
            output.finish()
        answer = _read(place / "answer", fmus, control)
        if answer is None:
            raise BristleError(_crash_message(fmus, control, child.returncode, output.last_line()))
    if "error" in answer:
        raise BristleError(str(answer["error"]))
    if "plain" in answer:
        raise BristleError(
            f"{_name(fmus, control)}: {answer['plain']}; check the FMU and its parameters"
        )
    try:
        return read(answer["done"])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        raise BristleError(f"{_name(fmus, control)}: {NOT_ASKED}; do not trust this FMU") from None


def _read(path: Path, fmus: Sequence[Path], control: Control) -> dict[str, Any] | None:
    try:
        answer = read_answer(path)
    except BristleError as error:
        raise BristleError(f"{_name(fmus, control)}: {error}; do not trust this FMU") from None
    return answer if answer is None or isinstance(answer, dict) else {}


def _start(folder: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(  # -P: do not import from the working directory
        [sys.executable, "-P", "-m", "bristle.fmus.supervisor", folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        env={**os.environ, "TMPDIR": folder, "TEMP": folder, "TMP": folder},
    )


class _Output:
    """Reads what a process writes, so that it never waits, and keeps the end of it."""

    def __init__(self, pipe: IO[bytes] | None) -> None:
        assert pipe is not None
        self._pipe, self._kept = pipe, b""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            while part := os.read(self._pipe.fileno(), 1 << 16):
                self._kept = (self._kept + part)[-KEPT_OUTPUT:]

    def finish(self) -> None:
        """Stop reading."""
        self._thread.join(1.0)
        if not self._thread.is_alive():
            self._pipe.close()

    def last_line(self) -> str:
        """Return the last line that was written."""
        lines = self._kept.decode("utf-8", "replace").strip().splitlines()
        return lines[-1][:200] if lines else ""


def _wait(
    child: subprocess.Popen[bytes],
    control: Control,
    progress: Callable[[int], None] | None,
    timeout: float | None,
) -> float | None:
    """Wait until the child process ends; return the limit [s] that it ran into, or None."""
    begun = alive = time.monotonic()
    seen = control.tolist()
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(POLL_INTERVAL)
            return None
        now, state = time.monotonic(), control.tolist()
        if state != seen:
            alive, seen = now, state
        limit, since = (LONGEST_CALL, alive) if timeout is None else (timeout, begun)
        if now - since > limit:
            return limit
        if progress:
            progress(int(control[0]))


def _end(child: subprocess.Popen[bytes]) -> None:
    """Let the child process end what it has started, and end it."""
    if child.stdin:
        with contextlib.suppress(OSError):
            child.stdin.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(GRACE)
    with contextlib.suppress(OSError, AttributeError):
        os.killpg(child.pid, signal.SIGKILL)
    if child.poll() is None:
        child.kill()
    child.wait()


def _name(fmus: Sequence[Path], control: Control) -> str:
    """Name the FMU whose call is under way, else all."""
    place = int(control[3])
    return f"FMU {fmus[place] if 0 <= place < len(fmus) else ', '.join(map(str, fmus))}"


def _under_way(control: Control) -> str:
    calls = {
        Call.load: "loading it",
        Call.instantiate: "instantiating it",
        Call.initialise: "initialising it",
    }
    calls |= {Call.step: f"its step {int(control[0]) + 1}", Call.free: "freeing it"}
    return calls.get(int(control[2]), "")  # type: ignore[call-overload, no-any-return]


def _late_message(
    fmus: Sequence[Path], control: Control, limit: float, timeout: float | None
) -> str:
    during = f" ({_under_way(control)})" if _under_way(control) else ""
    what = (
        f"the simulation took longer than {limit:g} s{during}"
        if timeout
        else f"did not answer for {limit:g} s{during}"
    )
    return (
        f"{_name(fmus, control)}: {what}; give it longer with --timeout, or replace the FMU if it"
        " hangs"
    )


def _crash_message(fmus: Sequence[Path], control: Control, code: int, said: str) -> str:
    try:
        cause = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
    except ValueError:
        cause = f"exit code {code}"
    during = f" during {_under_way(control)}" if _under_way(control) else ""
    last = f": {said}" if said and code > 0 else ""
    return (
        f"{_name(fmus, control)}: crashed the simulation{during} ({cause}{last}); "
        "the fault is inside that FMU: replace it or report it to its maker"
    )
