"""Cache of compiled files: one folder, in which each file is named by the hash of its sources."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from bristle.common.errors import BristleError


def cache_folder() -> Path:
    """Return the cache folder: $BRISTLE_CACHE, else the platform's usual place; it is created if missing."""
    if given := os.environ.get("BRISTLE_CACHE"):
        folder = Path(given)
    elif sys.platform == "win32":
        folder = Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "bristle"
    elif sys.platform == "darwin":
        folder = Path.home() / "Library" / "Caches" / "bristle"
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")) / "bristle"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unusable(folder, error) from None
    return folder


def _unusable(folder: Path, error: OSError) -> BristleError:
    elsewhere = error.filename and not Path(str(error.filename)).is_relative_to(folder)
    if elsewhere:  # what a cached file is made from, or a tool that makes it
        return BristleError(f"{error.filename}: {error.strerror}; needed for a file of the cache {folder}")
    return BristleError(f"cache folder {folder}: {error.strerror}; set BRISTLE_CACHE to a folder you can write")


def digest(*parts: str | bytes) -> str:
    """Return the SHA-256 of the parts, each preceded by its length."""
    total = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        total.update(f"{len(data)}:".encode() + data)
    return total.hexdigest()


def cached(name: str, make: Callable[[Path], None]) -> Path:
    """Return the cached file `name`, made by `make(path)` if it is missing.

    Other processes see a complete file or none; of those that miss the same file at once, one makes it and the others wait.
    """
    target = cache_folder() / name
    try:
        if not target.exists():
            with _alone(target):
                if not target.exists():
                    _make(target, make)
    except OSError as error:
        raise _unusable(target.parent, error) from None
    return target


def _alone(target: Path) -> AbstractContextManager[object]:
    from filelock import FileLock  # only if something is missing: a run from the cache starts sooner

    folder = target.parent / ".locks"
    folder.mkdir(exist_ok=True)
    return FileLock(folder / f"{target.name}.lock")


def _make(target: Path, make: Callable[[Path], None]) -> None:
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".making-") as folder:
        fresh = Path(folder) / target.name
        make(fresh)
        os.replace(fresh, target)
