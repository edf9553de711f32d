"""Signed numbers that a logger wrote as unsigned ones."""

from __future__ import annotations

import numpy as np

from bristle.common.columns import Columns
from bristle.common.table import Array
from bristle.records.layout import SETPOINT, Layout

SIGNED_BITS = (16, 32)  # of the registers of drives; of 8 bits, a switched input may look alike
LEAST_VALUES = 4  # distinct ones on both sides of zero


def signed_input(layout: Layout, columns: Columns) -> Columns:
    """Return the columns of a file with its input signed, where unsigned numbers stand for it."""
    name = layout.input.column
    if layout.input_kind == SETPOINT or name not in columns:
        return columns
    bits = next((n for n in SIGNED_BITS if _is_unsigned(columns[name], n)), None)
    if bits is None:
        return columns
    line = f"input '{name}' is a signed number of {bits} bits: {2**bits - 1} is read as -1"
    x = columns[name]
    own = {**columns, name: np.where(x >= 2 ** (bits - 1), x - 2**bits, x)}
    return Columns(
        own,
        columns.unusable,
        units=columns.units,
        clocks=columns.clocks,
        findings=(*columns.findings, line),
    )


def _is_unsigned(x: Array, bits: int) -> bool:
    """Return whether numbers lie near both ends of a register of so many bits, not between."""
    x = x[np.isfinite(x)]
    low, high = np.unique(x[x < 2 ** (bits - 2)]), np.unique(x[x >= 3 * 2 ** (bits - 2)])
    return bool(
        min(len(low), len(high)) >= LEAST_VALUES
        and len(low) + len(high) == len(np.unique(x))
        and low[0] >= 0
        and high[-1] < 2**bits
        and (x == np.round(x)).all()
    )
