"""Files that hold another file: gzip, bzip2, xz and ZIP."""

from __future__ import annotations

import bz2
import gzip
import lzma
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any
from zipfile import ZipFile, is_zipfile

from bristle.common.columns import must_fit
from bristle.common.errors import BristleError

STREAMS: dict[str, Callable[[Path], Any]] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
ZIP = ".zip"
COPIED_CHUNK = 2**20  # bytes unpacked at a time
SHOWN_MEMBERS = 5  # names of files in an archive that an error shows at most


def is_packed(path: Path) -> bool:
    """Return whether a file holds another one, by its suffix."""
    return path.suffix.lower() in (*STREAMS, ZIP)


@contextmanager
def unpacked(path: Path, suffixes: Collection[str]) -> Iterator[Path]:
    """Give the path of a temporary copy of what a file holds: of an archive, the only file with one
    of these suffixes.
    """
    with TemporaryDirectory() as folder:
        if path.suffix.lower() == ZIP:
            yield _member(path, Path(folder), suffixes)
        else:
            inner = Path(folder) / path.stem
            with STREAMS[path.suffix.lower()](path) as stream:
                _copy(path, stream, inner)
            yield inner


def _member(path: Path, folder: Path, suffixes: Collection[str]) -> Path:
    if not is_zipfile(path):
        raise BristleError(f"record {path}: is no ZIP archive; check the file")
    with ZipFile(path) as archive:
        names = [each.filename for each in archive.infolist() if not each.is_dir()]
        known = [
            name
            for name in names
            if Path(name).suffix.lower() in suffixes and not name.startswith("__MACOSX/")
        ]
        if len(known) != 1:
            shown = ", ".join((known or names)[:SHOWN_MEMBERS]) or "nothing"
            raise BristleError(
                f"record {path}: holds {len(known)} files of a known format, allowed 1 ({shown});"
                " unpack it"
            )
        inner = folder / Path(known[0]).name
        with archive.open(known[0]) as stream:
            _copy(path, stream, inner)
    return inner


def _copy(path: Path, stream: IO[bytes], target: Path) -> None:
    """Copy a stream, as far as a file may hold."""
    size = 0
    with target.open("wb") as out:
        while chunk := stream.read(COPIED_CHUNK):
            size += len(chunk)
            must_fit(path, size)
            out.write(chunk)
