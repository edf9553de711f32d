"""Where a result comes from: version, date, platform and folder of the run that made it."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any


@cache
def _version() -> str:
    return version("bristle")  # read from a file


def provenance() -> dict[str, Any]:
    """Return what the key `provenance` of a result begins with.

    Version of the library, date and time in UTC, platform, and the folder to which relative paths
    of a command belong, null if it is gone.
    """
    machine, folder = (
        f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        None,
    )
    with suppress(OSError):
        folder = str(Path.cwd())
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {"version": _version(), "date": now, "platform": machine, "folder": folder}


def provenance_of(
    model: Path | None, records: Iterable[Path], command: str = "", fmu: Path | None = None
) -> dict[str, Any]:
    """Return the same with the SHA-256 of the files that a result was made from, and the command
    that repeats it.

    Where an FMU is the model, `model` may be that file, or the model file that says what the
    records hold. That of a file that is gone since is null: the result is worth more than its hash.
    """

    def sha256(path: Path) -> str | None:
        with suppress(OSError):
            return hashlib.sha256(path.read_bytes()).hexdigest()
        return None

    found = provenance() | {"records_sha256": {str(path): sha256(path) for path in records}}
    found |= {} if model is None else {"model_sha256": sha256(model)}
    found |= {} if fmu is None else {"fmu_sha256": sha256(fmu)}
    return found | ({"command": command} if command else {})
