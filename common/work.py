"""Folders for work in progress, with names of one kind; what a killed process left is swept when it
is a day old.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bristle.common.errors import BristleError

# how such a folder begins, in an output folder, in the cache and among the temporary files
WORK = ".bristle-"
JOURNAL = "journal.json"  # in such a folder: what it holds is being put into its place (`output`)
OLD = 24 * 3600.0  # s after which such a folder is taken for one of a process that was killed
# their names, as `tempfile` makes them
OURS = re.compile(re.escape(WORK) + r"([a-z]+-)?[a-z0-9_]{8}")

_swept: set[Path] = set()  # places that this process has looked at


class TemporaryFolder(tempfile.TemporaryDirectory[str]):
    """A folder among the temporary files, or in another `place`, that is removed at the end; `kind`
    says what for.
    """

    def __init__(self, kind: str, place: Path | None = None) -> None:
        parent = Path(tempfile.gettempdir()) if place is None else place
        sweep_once(parent)
        super().__init__(prefix=f"{WORK}{kind}-", dir=parent, ignore_cleanup_errors=True)
        self._lock = lock(Path(self.name))

    def cleanup(self) -> None:
        """Remove the folder."""
        unlock(self._lock)
        self._lock = None
        super().cleanup()


def no_room(error: BaseException) -> BristleError | None:
    """Return the error to raise if the folder for temporary files is full; None if the error is of
    another kind.
    """
    if not isinstance(error, OSError) or error.errno not in (errno.ENOSPC, errno.EDQUOT):
        return None
    return BristleError(
        f"temporary folder {tempfile.gettempdir()}: {error.strerror}; make room, or set TMPDIR to"
        " another folder"
    )


@contextmanager
def work_folder(place: Path) -> Iterator[Path]:
    """Give a folder to make files in that then are renamed into `place`; it stays only if a journal
    in it says so.
    """
    folder = Path(tempfile.mkdtemp(prefix=WORK, dir=place))
    held = lock(folder)
    try:
        yield folder
    finally:
        unlock(held)
        if not (folder / JOURNAL).exists():
            shutil.rmtree(folder, ignore_errors=True)


def lock(folder: Path, wait: bool = False) -> int | None:
    """Lock a folder and return what `unlock` takes; None if another process has it, or the system
    cannot lock folders.

    The lock ends with the process, however that ends, and leaves no file.
    """
    if sys.platform == "win32":
        return None
    import fcntl

    handle = -1
    try:
        handle = os.open(folder, os.O_RDONLY)
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        unlock(handle if handle >= 0 else None)
        return None
    return handle


def unlock(handle: int | None) -> None:
    """Undo `lock`."""
    if handle is not None:
        os.close(handle)


def sweep_once(place: Path) -> None:
    """Sweep a place that this process has not swept yet."""
    if place not in _swept:
        _swept.add(place)
        sweep(place)


def sweep(place: Path) -> None:
    """Remove the folders of killed processes from a place: those that are old, unlocked, of this
    user and without a journal.
    """
    with suppress(OSError):
        for path in [each for each in place.iterdir() if OURS.fullmatch(each.name)]:
            with suppress(OSError):
                if _left(path):
                    shutil.rmtree(path, ignore_errors=True)


def _left(folder: Path) -> bool:
    found = folder.lstat()
    if (
        not stat.S_ISDIR(found.st_mode)
        or time.time() - found.st_mtime < OLD
        or (folder / JOURNAL).exists()
    ):
        return False
    if sys.platform == "win32":
        return True
    handle = lock(folder)
    unlock(handle)
    return handle is not None and found.st_uid == os.getuid()
