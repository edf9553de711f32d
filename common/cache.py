"""Cache of compiled files: one folder, in which each file is named by the hash of its sources."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from bristle.common.errors import BristleError
from bristle.common.work import sweep_once, work_folder

# files that were compared with their hash: path, size, time, place
_seen: set[tuple[str, int, int, int]] = set()


def cache_folder() -> Path:
    """Return the cache folder, created if missing: $BRISTLE_CACHE, else the platform's place."""
    if given := os.environ.get("BRISTLE_CACHE"):
        return _usable(Path(given))
    try:
        return _usable(_usual_place())
    except RuntimeError:
        raise BristleError(
            "there is no home folder for the cache; set BRISTLE_CACHE to a folder you can write"
        ) from None


def _usual_place() -> Path:
    """Return the cache folder of the platform; raise RuntimeError without a home folder."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "bristle"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "bristle"
    return Path(os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")) / "bristle"


def _usable(folder: Path) -> Path:
    """Create the folder if it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unusable(folder, error) from None
    return folder


def _unusable(folder: Path, error: OSError) -> BristleError:
    elsewhere = error.filename and not Path(str(error.filename)).is_relative_to(folder)
    if elsewhere:  # what a cached file is made from, or a tool that makes it
        return BristleError(
            f"{error.filename}: {error.strerror}; needed for a file of the cache {folder}"
        )
    return BristleError(
        f"cache folder {folder}: {error.strerror}; set BRISTLE_CACHE to a folder you can write"
    )


def digest(*parts: str | bytes) -> str:
    """Return the SHA-256 of the parts, each preceded by its length."""
    total = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        total.update(f"{len(data)}:".encode() + data)
    return total.hexdigest()


def cached(name: str, make: Callable[[Path], None]) -> Path:
    """Return the cached file `name`, made by `make(path)` if it is missing or damaged.

    Other processes see a complete file or none; of those that miss the same file at once, one makes
    it and the others wait. A file is compared with its hash when this process uses it first: a
    library of which some bytes are wrong would kill it.
    """
    target = cache_folder() / name
    sweep_once(target.parent)
    try:
        if not _sound(target):
            with _alone(target):
                if not _sound(target):
                    _make(target, make)
    except OSError as error:
        raise _unusable(target.parent, error) from None
    return target


def _alone(target: Path) -> AbstractContextManager[object]:
    # only if something is missing: a run from the cache starts sooner
    from filelock import FileLock

    folder = target.parent / ".locks"
    folder.mkdir(exist_ok=True)
    return FileLock(folder / f"{target.name}.lock")


def _make(target: Path, make: Callable[[Path], None]) -> None:
    """Make a file with its hash beside it; a crash between both leaves a file that does not match,
    and is made again.
    """
    with work_folder(target.parent) as folder:
        fresh, digest_of = folder / target.name, folder / "sum"
        make(fresh)
        digest_of.write_text(_hash(fresh), encoding="ascii")
        for path in (fresh, digest_of):
            with path.open("rb+") as stream:
                os.fsync(stream.fileno())
        _sum(target).parent.mkdir(exist_ok=True)
        os.replace(digest_of, _sum(target))
        os.replace(fresh, target)


def _sum(target: Path) -> Path:
    return target.parent / ".sums" / target.name


def _hash(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _sound(target: Path) -> bool:
    """True if a file is there as it was made."""
    try:
        found = target.stat()
        state = (str(target), found.st_size, found.st_mtime_ns, found.st_ino)
        if state not in _seen:
            if _sum(target).read_text(encoding="ascii") != _hash(target):
                return False
            _seen.add(state)
    except FileNotFoundError:
        return False
    except UnicodeDecodeError:  # of a damaged hash
        return False
    return True
