"""What measured files hold, as lines for a terminal: topics with their columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bristle.common.columns import Columns
from bristle.records.formats.reading import read_columns
from bristle.records.headings import heading


def listed(paths: Sequence[Path]) -> list[str]:
    """Return the columns of files with what they hold, those of a topic below its time.

    Raises
    ------
    BristleError
        One line, if a file cannot be read.
    """
    return [line for path in paths for line in (str(path), *_lines(read_columns(path)))]


def _lines(columns: Columns) -> Iterator[str]:
    width = max(map(len, columns), default=0)
    for time in dict.fromkeys((*columns.times.values(), "")):
        indent = "  "
        if time:
            yield f"  {time:<{width}}  {_clock(columns, time)}"
            indent = "    "
        for name in columns:
            if columns.times.get(name, "") == time and name != time:
                yield f"{indent}{name:<{width}}  {_values(columns, name)}"
    for name, what in columns.unusable.items():
        yield f"  {name:<{width}}  no numbers: {what}"
    if columns.rate is not None:
        yield f"  rate in the file: {columns.rate:.6g} Hz"


def _clock(columns: Columns, time: str) -> str:
    """Return number and rate of the samples of a topic."""
    instants = columns[time]
    step = float(np.median(np.diff(instants))) if len(instants) > 1 else 0.0
    rate = f", {1 / step:.4g} Hz" if step > 0.0 else ""
    return f"time, {len(instants)} samples{rate}"


def _values(columns: Columns, name: str) -> str:
    """Return the range of a column, and what its name and unit say."""
    values = columns[name][np.isfinite(columns[name])]
    if not len(values):
        return "empty"
    first, last = float(values.min()), float(values.max())
    if name in columns.clocks:
        return f"{last - first:.4g} s from {first:.10g} s  (time)"
    low, high = f"{first:.4g}", f"{last:.4g}"
    said = heading(name, columns.units.get(name))
    about = " ".join(filter(None, ("setpoint" if said.setpoint else "", said.quantity, said.unit)))
    span = f"constant {low}" if first == last else f"{low} to {high}"
    return f"{span}  ({about})" if about else span
