"""Output files: JSON content, a check that the folder is writable before a long computation, all files or none."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.errors import BristleError


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it: arrays become lists, and what is not a finite number becomes null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value


def to_json(content: Mapping[str, Any]) -> str:
    """Return the text of a JSON file."""
    return json.dumps(plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def complain(folder: Path, error: OSError) -> BristleError:
    """Return the error for a folder that cannot be written."""
    return BristleError(
        f"output folder {folder}: {error.strerror or error}; choose another folder or make room (nothing was changed)"
    )


def check_writable(out: Path) -> None:
    """Create the output folder and check that it is writable, before a long computation."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out, prefix=".bristle-try-"):
            pass
    except OSError as error:
        raise complain(out, error) from None


@contextmanager
def output_folder(out: Path) -> Iterator[None]:
    """Create the output folder and check that it is writable; if the work in the context fails, remove it if it is empty."""
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        check_writable(out)
        yield
    except BaseException:
        for folder in made:
            with suppress(OSError):  # it is not empty
                folder.rmdir()
        raise


def write_file(path: Path, content: bytes) -> None:
    """Write a file through to the disk: a full disk may show only then."""
    with path.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def check_not_replaced(out: Path, names: Sequence[str], inputs: Iterable[Path]) -> None:
    """Raise `BristleError` if a file of these names in `out` would take the place of an input."""
    places = {(out / name).resolve() for name in names}
    for path in inputs:
        if path.resolve() in places:
            raise BristleError(f"{path}: would be replaced by what is written into {out}; give another folder")


def check_no_folder(out: Path, names: Sequence[str]) -> None:
    """Raise `BristleError` if a file of one of these names could not be written into `out`, because a folder is called so."""
    for name in names:
        if (out / name).is_dir():
            raise BristleError(f"{out}: '{name}' in it is a folder, and a file of that name is to be written; move it away")


def replace_files(out: Path, content: Mapping[str, bytes], names: Sequence[str]) -> list[Path]:
    """Put files into a folder in the place of older ones: all of them or none.

    Parameters
    ----------
    out : Path
        The folder, which exists.
    content : mapping of str to bytes
        The files by name, which may begin with a sub-folder.
    names : sequence of str
        All names that belong to the writer: files of these names that are not in `content` go.

    Returns
    -------
    list of Path
        The files that were written, in the order of `names`.

    Raises
    ------
    BristleError
        If the folder cannot be written or the disk is full; the folder is then as it was.
    """
    try:
        with tempfile.TemporaryDirectory(dir=out, prefix=".bristle-", ignore_cleanup_errors=True) as work:
            fresh, old = Path(work) / "new", Path(work) / "old"
            fresh.mkdir()
            old.mkdir()
            for name, data in content.items():
                (fresh / name).parent.mkdir(parents=True, exist_ok=True)
                write_file(fresh / name, data)
            _exchange(fresh, out, old, names)
    except OSError as error:
        raise complain(out, error) from None
    return [out / name for name in names if name in content]


def replace_file(path: Path, content: bytes) -> None:
    """Put one file in the place of an older one; raise `BristleError` as `replace_files`."""
    replace_files(path.parent, {path.name: content}, [path.name])


def _exchange(fresh: Path, out: Path, old: Path, names: Sequence[str]) -> None:
    """Move the files of `out` that have these names into `old`, those of `fresh` into `out`; undo it if that fails."""
    placed = []
    try:
        for name in names:
            if (out / name).exists():
                (old / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(out / name, old / name)
            if (fresh / name).exists():
                (out / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(fresh / name, out / name)
                placed.append(name)
    except BaseException:
        for name in placed:
            os.unlink(out / name)
        for path in (each for each in old.rglob("*") if each.is_file()):
            os.replace(path, out / path.relative_to(old))
        raise
