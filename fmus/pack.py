"""Write files into a ZIP archive: equal files give equal bytes, and the archive appears only when
it is complete.
"""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

from bristle.common.errors import BristleError
from bristle.common.work import work_folder

ARCHIVE_TIME = (1980, 1, 1, 0, 0, 0)  # time stamp of all files: the earliest one of the ZIP format
ARCHIVE_PERMISSIONS = 0o100644 << 16


def _fill(path: Path | BinaryIO, files: Mapping[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, ARCHIVE_TIME)
            entry.create_system = 3  # Unix, whatever machine builds it
            entry.external_attr = ARCHIVE_PERMISSIONS
            archive.writestr(entry, files[name], zipfile.ZIP_DEFLATED, 9)


def archive_bytes(files: Mapping[str, bytes]) -> bytes:
    """Return the ZIP archive of `files` (name -> content)."""
    buffer = io.BytesIO()
    _fill(buffer, files)
    return buffer.getvalue()


def write_archive(out: Path, files: Mapping[str, bytes]) -> Path:
    """Write `files` (name -> content) as the ZIP archive `out`.

    Raises
    ------
    BristleError
        If it cannot be written; `out` is then as it was.
    """
    try:
        with work_folder(out.parent) as folder:
            fresh = folder / out.name
            _fill(fresh, files)
            os.replace(fresh, out)
    except OSError as error:
        raise BristleError(
            f"cannot write {out}: {error.strerror}; choose a writable folder with space"
        ) from None
    return out
