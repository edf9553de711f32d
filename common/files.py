"""Files that users give: one that is none is refused before it is read, which may never end."""

from __future__ import annotations

from pathlib import Path

from bristle.common.errors import BristleError


def check_regular(path: Path, shown: str = "") -> None:
    """Raise `BristleError` for a pipe or a device, not for a path that does not exist; `shown` is
    the path in a message.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise BristleError(
            f"{shown or path}: is not a regular file but a pipe or device; write what it gives to a"
            " file first"
        )
