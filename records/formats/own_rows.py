"""Tables in which each signal has rows of its own, as plotting tools write what came at its own
times: the other fields of such a row are empty.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from bristle.common.columns import Array, Columns

EMPTY_SHARE = 0.3  # of the rows: a column that is empty in more has rows of its own


def own_rows(columns: Columns) -> dict[str, str]:
    """Return the columns that have rows of their own, each with the first that has the same."""
    if len({len(values) for values in columns.values()}) != 1:
        return {}
    filled = {name: np.isfinite(values) for name, values in columns.items()}
    first: dict[bytes, str] = {}
    return {
        name: first.setdefault(rows.tobytes(), name)
        for name, rows in filled.items()
        if 0.0 < rows.mean() < 1.0 - EMPTY_SHARE
    }


def at_rows_of(columns: Columns, name: str, used: Collection[str]) -> Columns:
    """Return the rows of a column, its own if it has such, in which those of the used columns that
    have others are as they were last known, NaN before.
    """
    sparse = {each: first for each, first in own_rows(columns).items() if each in used}
    if not sparse or name not in columns:
        return columns
    rows = np.isfinite(columns[name]) if name in sparse else np.full(len(columns[name]), True)
    same = sparse.get(name, "")
    held = {each for each, first in sparse.items() if first != same}
    found = {each: (_last_known(x) if each in held else x)[rows] for each, x in columns.items()}
    said = (f"columns have rows of their own; taken at those of '{name}', as last known there",)
    result = Columns(
        found,
        columns.unusable,
        units=columns.units,
        clocks=columns.clocks,
        findings=(*columns.findings, *said),
    )
    result.rate = columns.rate
    return result


def _last_known(values: Array) -> Array:
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))
    return np.where(last < 0, np.nan, values[last])
