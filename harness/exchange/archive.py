"""Files of other makers that are zip archives: what is in them is read when it is asked for."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree as ET

from bristle.common.errors import BristleError
from bristle.common.files import check_regular
from bristle.common.signals import Array, signals_of

MOST_BYTES = 2 << 30  # that an archive may unpack to


class Archive:
    """A zip archive.

    Raises
    ------
    BristleError
        One line, if it is none, or unpacks to too much.
    """

    suffix = ".zip"  # of such a file, for messages

    def __init__(self, path: Path) -> None:
        self.path = path
        check_regular(path)
        try:
            with zipfile.ZipFile(path) as archive:
                self.names = frozenset(archive.namelist())
                size = sum(entry.file_size for entry in archive.infolist())
        except OSError as error:
            raise BristleError(
                f"{path}: {error.strerror}; check the path of the {self.suffix} file"
            ) from None
        except zipfile.BadZipFile:
            raise BristleError(f"{path}: not a zip archive; give an {self.suffix} file") from None
        if size > MOST_BYTES:
            raise BristleError(f"{path}: unpacks to {size} bytes; allowed are {MOST_BYTES}")

    def mistake(self, message: str) -> BristleError:
        """Return the one-line error about this file."""
        return BristleError(f"{self.path}: {message}")

    @contextmanager
    def named(self) -> Iterator[None]:
        """Put the name of this file in front of an error."""
        try:
            yield
        except BristleError as error:
            raise (
                error if str(error).startswith(f"{self.path}: ") else self.mistake(str(error))
            ) from None

    def read(self, name: str) -> bytes:
        """Return the content of one of its files."""
        if name not in self.names:
            raise self.mistake(f"holds no file '{name}'")
        try:
            with zipfile.ZipFile(self.path) as archive:
                return archive.read(name)
        except (OSError, zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError) as error:
            raise self.mistake(
                f"{name}: cannot be unpacked ({error}); make the file again"
            ) from None

    def unpack(self, name: str, folder: Path) -> Path:
        """Write one of its files into a folder, under its last name, and return where."""
        target = folder / PurePosixPath(name).name
        target.write_bytes(self.read(name))
        return target

    def columns(self, name: str) -> tuple[Array, dict[str, Array]]:
        """Return time and columns of one of its CSV files."""
        with self.named():
            return signals_of(self.read(name), name)

    def tree(self, name: str) -> ET.Element:
        """Return one of its XML files."""
        with self.named():
            return tree_of(self.read(name), name)


def tree_of(content: bytes, name: str) -> ET.Element:
    """Return the root of an XML file."""
    try:
        return ET.fromstring(content)
    except ET.ParseError as error:
        raise BristleError(f"{name}: no XML ({error})") from None
