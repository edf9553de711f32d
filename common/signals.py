"""Signals over time as CSV files: a head, then numbers, time first."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError

Array = NDArray[np.float64]


def table_text(columns: Mapping[str, Array], digits: int | None = None) -> str:
    """Return columns as CSV with a head; without `digits`, enough to give the same doubles."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerow(columns)
    np.savetxt(
        out,
        np.column_stack(list(columns.values())),
        fmt="%s" if digits is None else f"%.{digits}g",
        delimiter=",",
    )
    return out.getvalue()


def signals_of(content: bytes, name: str) -> tuple[Array, dict[str, Array]]:
    """Return time and columns of the content of a file.

    Raises
    ------
    BristleError
        If it is no such table; the message says `name`.
    """
    try:
        head, *rows = csv.reader(io.StringIO(content.decode("utf-8-sig")))
        table = np.array([[float(cell) for cell in row] for row in rows if row])
        values = dict(zip(head[1:], table.T[1:], strict=True))
    except (ValueError, IndexError, csv.Error):
        raise BristleError(
            f"{name}: no table of numbers with a head of as many names, and time first"
        ) from None
    if len(values) < len(head) - 1:
        raise BristleError(f"{name}: two columns have one name")
    if not len(table) or not np.isfinite(table).all() or (np.diff(table[:, 0]) < 0).any():
        raise BristleError(f"{name}: its times must rise, and its values be finite")
    return table[:, 0], values
