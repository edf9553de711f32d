"""Measured data sets as (name, time, u, y, extra): arrays in SI as `bristle.diagnosis.records_from_arrays` takes them."""

from __future__ import annotations

import gzip
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Entry = tuple[str, Array, Array, Array, dict[str, Any]]

ROOT = Path(os.environ.get("BRISTLE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
ODRIVE_TURN = 8192.0  # counts


def runs(folder: Path) -> list[tuple[str, dict[str, Any], dict[str, Array]]]:
    """Return (name, settings, logged columns) of each run of a folder in the format of Rhoban's bam, in order of time."""
    found = []
    for path in sorted(folder.glob("*.json.gz")):
        with gzip.open(path, "rt", encoding="utf-8") as stream:
            content = json.load(stream)
        entries = content.pop("entries")
        columns = {key: np.array([entry[key] for entry in entries], dtype=float) for key in entries[0]}
        found.append((path.name.removesuffix(".json.gz"), content, columns))
    return found
