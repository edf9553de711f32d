"""Rows without data at the ends of a table: those that a logger had reserved and never filled."""

from __future__ import annotations

import numpy as np

from bristle.common.columns import Columns

LEAST_PADDING = 2  # rows of zeros at the end from which on they are no sample


def without_padding(columns: Columns) -> Columns:
    """Return columns without rows at either end in which nothing is a number, and without rows of
    zeros at the end; columns of different length as they are.
    """
    if len({len(values) for values in columns.values()}) != 1:
        return columns
    table = np.column_stack(list(columns.values()))
    filled = np.flatnonzero(np.isfinite(table).any(axis=1))
    if not len(filled):
        return columns
    first, end = int(filled[0]), int(filled[-1]) + 1
    held = np.flatnonzero((np.nan_to_num(table[first:end]) != 0.0).any(axis=1))
    zeros = end - first - 1 - int(held[-1]) if len(held) else 0
    end -= zeros if zeros >= LEAST_PADDING else 0
    if first == 0 and end == len(table):
        return columns
    columns.findings = (*columns.findings, _said(first, len(table) - end))
    columns.update({name: values[first:end] for name, values in columns.items()})
    return columns


def _said(first: int, last: int) -> str:
    places = [
        f"{count} at the {where}" for count, where in ((first, "start"), (last, "end")) if count
    ]
    return f"rows without data: {' and '.join(places)}; left out"
