"""Output files: JSON content, a check that the folder is writable before a long computation, writing through to the disk."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
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
