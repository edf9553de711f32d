"""A run in a process of its own, for FMUs of others: if one crashes, only that process dies."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from bristle.harness.loop import Bus, Progress, Trace, simulate
from bristle.model.errors import BristleError

LOOK = 0.05  # s between two looks at the child


def simulate_isolated(bus: Bus, progress: Progress | None = None, *, engine: str | None = None) -> Trace:
    """Run a bus in a child process.

    Raises
    ------
    BristleError
        If the child dies (which FMU is not known, hence all foreign ones are named) or refuses the bus.
    """
    with tempfile.TemporaryDirectory(prefix="bristle-run-", ignore_cleanup_errors=True) as folder:
        work = Path(folder)
        (work / "bus.pkl").write_bytes(pickle.dumps((bus, engine)))
        control = np.memmap(work / "control", dtype=np.int64, mode="w+", shape=(2,))
        with (work / "said").open("wb") as said:
            child = subprocess.Popen(
                [sys.executable, "-m", "bristle.harness.isolate", folder], stdin=subprocess.PIPE, stdout=said, stderr=said,
                env={**os.environ, "TMPDIR": folder, "TEMP": folder, "TMP": folder},
            )  # fmt: skip
            try:
                _wait(child, control, progress)
            finally:
                _end(child)
        answer = work / "trace.pkl"
        if not answer.exists():
            raise BristleError(_obituary(bus, child.returncode, work / "said"))
        outcome = pickle.loads(answer.read_bytes())
    if isinstance(outcome, str):
        raise BristleError(outcome)
    assert isinstance(outcome, Trace)
    return outcome


def _wait(child: subprocess.Popen[bytes], control: np.ndarray, progress: Progress | None) -> None:
    while True:
        try:
            child.wait(LOOK)
            return
        except subprocess.TimeoutExpired:
            if progress:
                progress(int(control[0]))


def _end(child: subprocess.Popen[bytes]) -> None:
    if child.poll() is None:
        child.kill()
    child.wait()
    if child.stdin:
        child.stdin.close()


def _obituary(bus: Bus, code: int, said: Path) -> str:
    names = ", ".join(str(i.fmu.path) for i in bus.instances if i.fmu.foreign)
    try:
        cause = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
    except ValueError:
        cause = f"exit code {code}"
    lines = said.read_text(errors="replace").strip().splitlines()
    last = f": {lines[-1][:200]}" if lines and code > 0 else ""
    return (
        f"FMU {names}: crashed the simulation ({cause}{last}); the fault is inside that FMU: replace it or report it to its maker"
    )


def _child(folder: str) -> None:
    """Do the work; end at once when the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    threading.Thread(target=_watch_parent, daemon=True).start()
    work = Path(folder)
    bus, engine = pickle.loads((work / "bus.pkl").read_bytes())
    control = np.memmap(work / "control", dtype=np.int64, mode="r+", shape=(2,))
    outcome: Trace | str
    try:
        outcome = simulate(bus, engine=engine, control=control)
    except BristleError as error:
        outcome = str(error)
    except Exception as error:  # FMPy raises plain exceptions for what an FMU refuses; not a crash
        names = ", ".join(str(instance.fmu.path) for instance in bus.instances if instance.fmu.foreign)
        outcome = f"FMU {names}: {' '.join(str(error).split()) or type(error).__name__}; check the FMU and its parameters"
    fresh = work / "trace.tmp"
    fresh.write_bytes(pickle.dumps(outcome))
    os.replace(fresh, work / "trace.pkl")


def _watch_parent() -> None:
    with contextlib.suppress(OSError):
        sys.stdin.buffer.read()
    os._exit(1)


if __name__ == "__main__":
    _child(sys.argv[1])
