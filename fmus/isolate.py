"""Run a function in a child process, for FMUs from elsewhere: if one crashes, only the child process ends."""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError

POLL_INTERVAL = 0.05  # s between two checks of the child process

Control = NDArray[np.int64]
Argument = TypeVar("Argument")
Answer = TypeVar("Answer")


def isolated(
    work: Callable[[Argument, Control], Answer],
    argument: Argument,
    fmus: Sequence[Path],
    progress: Callable[[int], None] | None = None,
    timeout: float | None = None,
) -> Answer:
    """Return work(argument, control), done in a child process.

    Parameters
    ----------
    work : function of a module
        `control`, shape (2,), is shared memory: [0] counts finished items, for `progress`.
    argument, returned value
        Whatever can be pickled.
    fmus : sequence of Path
        The FMUs that take part; all are named in an error, since it is not known which one crashed.
    progress : function, optional
        Called now and then with the number of finished items.
    timeout : float, optional
        Seconds after which the child process is ended.

    Raises
    ------
    BristleError
        If the child process crashes or takes too long, or the work raises an error.
    """
    with tempfile.TemporaryDirectory(prefix="bristle-run-", ignore_cleanup_errors=True) as folder:
        place = Path(folder)
        (place / "work.pkl").write_bytes(pickle.dumps((work, argument, fmus)))
        control = np.memmap(place / "control", dtype=np.int64, mode="w+", shape=(2,))
        with (place / "log").open("wb") as log:
            child = subprocess.Popen(  # -P: do not import from the working directory
                [sys.executable, "-P", "-m", "bristle.fmus.isolate", folder], stdin=subprocess.PIPE, stdout=log, stderr=log,
                env={**os.environ, "TMPDIR": folder, "TEMP": folder, "TMP": folder},
            )  # fmt: skip
            try:
                if not _wait(child, control, progress, timeout):
                    advice = "give it longer with --timeout, or replace the FMU if it hangs"
                    raise BristleError(f"FMU {_names(fmus)}: the simulation took longer than {timeout:g} s; {advice}")
            finally:
                _end(child)
        written = place / "answer.pkl"
        if not written.exists():
            raise BristleError(_crash_message(fmus, child.returncode, place / "log"))
        done, answer = pickle.loads(written.read_bytes())
    if not done:
        raise BristleError(answer)
    result: Answer = answer
    return result


def _wait(child: subprocess.Popen[bytes], control: Control, progress: Callable[[int], None] | None, timeout: float | None) -> bool:
    """Wait until the child process ends; return False if it does not in time."""
    end = math.inf if timeout is None else time.monotonic() + timeout
    while time.monotonic() < end:
        try:
            child.wait(POLL_INTERVAL)
            return True
        except subprocess.TimeoutExpired:
            if progress:
                progress(int(control[0]))
    return False


def _end(child: subprocess.Popen[bytes]) -> None:
    if child.poll() is None:
        child.kill()
    child.wait()
    if child.stdin:
        child.stdin.close()


def _names(fmus: Sequence[Path]) -> str:
    return ", ".join(map(str, fmus))


def _crash_message(fmus: Sequence[Path], code: int, log: Path) -> str:
    try:
        cause = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
    except ValueError:
        cause = f"exit code {code}"
    lines = log.read_text(errors="replace").strip().splitlines()
    last = f": {lines[-1][:200]}" if lines and code > 0 else ""
    return (
        f"FMU {_names(fmus)}: crashed the simulation ({cause}{last}); "
        "the fault is inside that FMU: replace it or report it to its maker"
    )


def _child(folder: str) -> None:
    """Do the work in the child process; end at once if the parent process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles interrupts
    threading.Thread(target=_watch_parent, daemon=True).start()
    place = Path(folder)
    work, argument, fmus = pickle.loads((place / "work.pkl").read_bytes())
    control = np.memmap(place / "control", dtype=np.int64, mode="r+", shape=(2,))
    outcome: tuple[bool, Any]
    try:
        outcome = True, work(argument, control)
    except BristleError as error:
        outcome = False, str(error)
    except Exception as error:  # FMPy raises plain exceptions if an FMU returns an error status
        reason = " ".join(str(error).split()) or type(error).__name__
        outcome = False, f"FMU {_names(fmus)}: {reason}; check the FMU and its parameters"
    fresh = place / "answer.tmp"
    fresh.write_bytes(pickle.dumps(outcome))
    os.replace(fresh, place / "answer.pkl")


def _watch_parent() -> None:
    with contextlib.suppress(OSError):
        sys.stdin.buffer.read()
    os._exit(1)


if __name__ == "__main__":
    _child(sys.argv[1])
