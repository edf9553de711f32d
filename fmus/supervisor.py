"""The child process in which FMUs from elsewhere run: a supervisor, and the worker that it forks.

The supervisor outlives whatever the FMU does to the worker, and ends all that the worker has
started. On Linux that includes processes that left its group; where there is no fork, the worker
alone runs and only itself is ended.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import pickle
import select
import signal
import sys
import threading
import time
from pathlib import Path
from typing import NoReturn

import numpy as np

from bristle.common.errors import BristleError
from bristle.fmus.answer import write_answer
from bristle.fmus.calls import CONTROL_SIZE, WATCH

SET_DEATH_SIGNAL, SET_SUBREAPER = 1, 36  # of Linux's prctl
PATIENCE = 5.0  # s that ending what is left may take
LARGEST_FILE = 1 << 30  # bytes that the worker may write into one file
MEMORY_SHARE = 0.8  # of the machine's memory that the worker may have
END_POLL = 0.02  # s, where the system cannot wait for a process and a pipe at once


def main(folder: str) -> None:
    """Do the work that lies in a folder."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles interrupts
    if not hasattr(os, "fork"):
        threading.Thread(target=_watch_parent, daemon=True).start()
        _work(Path(folder))
        return
    _prctl(SET_SUBREAPER, 1)
    worker = os.fork()
    if worker:
        _supervise(worker)
    _prctl(SET_DEATH_SIGNAL, signal.SIGKILL)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    _limit()
    _work(Path(folder))


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(
            option, ctypes.c_ulong(value), ctypes.c_ulong(0), ctypes.c_ulong(0), ctypes.c_ulong(0)
        )


def _limit() -> None:
    """Limit what the worker may take of memory and disk."""
    import resource

    most = int(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") * MEMORY_SHARE)
    for kind, size in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, LARGEST_FILE),
        (resource.RLIMIT_AS, most),
    ):
        soft, _ = resource.getrlimit(kind)
        # a lower limit of the user's stays
        least = size if soft == resource.RLIM_INFINITY else min(size, soft)
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (least, least))


def _work(place: Path) -> None:
    work, argument, paths = pickle.loads((place / "work.pkl").read_bytes())
    control = np.memmap(place / "control", dtype=np.int64, mode="r+", shape=(CONTROL_SIZE,))
    WATCH.start(control, paths)
    try:
        outcome = {"done": work(argument, control)}
    except BristleError as error:
        outcome = {"error": str(error)}
    except MemoryError:
        outcome = {"plain": "no memory left"}
    except Exception as error:  # FMPy raises plain exceptions if an FMU returns an error status
        outcome = {"plain": " ".join(str(error).split()) or type(error).__name__}
    write_answer(place / "answer", outcome)


# -- the supervisor --------------------------------------------------------------------------------


def _watch_parent() -> None:
    with contextlib.suppress(OSError):
        sys.stdin.buffer.read()
    os._exit(1)


def _supervise(worker: int) -> NoReturn:
    """Wait for the worker or for the parent's end, end what is left, and end like the worker."""
    os.close(1)
    os.close(2)  # what the worker writes ends when the worker does
    status = _ended(worker)
    if status is None:
        os.kill(worker, signal.SIGKILL)
        _, status = os.waitpid(worker, 0)
    _end_the_rest()
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        with contextlib.suppress(OSError, ValueError):
            signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    os._exit(os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else 1)


def _ended(worker: int) -> int | None:
    """Return the status of the worker once it has ended, or None if the parent ends first."""
    waiting: list[int] = [0]
    with contextlib.suppress(AttributeError, OSError):
        waiting.append(os.pidfd_open(worker))
    while True:
        ready, _, _ = select.select(waiting, [], [], None if len(waiting) > 1 else END_POLL)
        pid, status = os.waitpid(worker, os.WNOHANG)
        if pid:
            return status
        if 0 in ready and not os.read(0, 4096):
            return None


def _end_the_rest() -> None:
    """End all processes that the worker has left behind; orphans are children of this one now."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            pid, _ = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if not pid:
            for child in _children():
                with contextlib.suppress(OSError):
                    os.kill(child, signal.SIGKILL)
            time.sleep(0.002)


def _children() -> list[int]:
    """Return the processes whose parent is this one, where the system lists them as files."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            if int(path.read_text(errors="replace").rpartition(")")[2].split()[1]) == os.getpid():
                found.append(int(path.parent.name))
    return found


if __name__ == "__main__":
    main(sys.argv[1])
