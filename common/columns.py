"""Columns of numbers by name, as all readers return them, and how many a file may hold."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError

Array = NDArray[np.float64]

# bytes: a file that holds more, unpacked, is refused before it fills the memory
LARGEST_CONTENT = 2**29
LONGEST_LIST = 64  # numbers: a longer list in a sample is an image or a scan
MOST_COLUMNS = 2000  # columns: a file with more is no log of a servo
MATRIX_RATIO = 10  # least ratio of length and width from which on a matrix is a table of columns
KINDS = {
    "U": "text",
    "S": "text",
    "c": "complex numbers",
    "M": "timestamps",
    "m": "durations",
    "V": "a struct",
    "b": "booleans",
}


class Columns(dict[str, Array]):
    """Columns by name, each of shape (n,).

    Attributes
    ----------
    unusable : dict of str to str
        What all other columns hold instead of numbers.
    units : dict of str to str
        Units that the file gives apart from the names, as it writes them.
    clocks : frozenset of str
        Columns that held timestamps; here they are in s, of one epoch in all files.
    findings : tuple of str
        What was repaired while reading.
    rate : float or None
        Sampling rate [Hz] that the file gives apart from its columns.
    times : dict of str to str
        Of columns that have a time of their own, as the topics of a log do, the column that holds
        it.
    """

    def __init__(
        self,
        columns: Mapping[str, Array],
        unusable: Mapping[str, str] | None = None,
        *,
        units: Mapping[str, str] | None = None,
        clocks: Iterable[str] = (),
        findings: Iterable[str] = (),
    ) -> None:
        super().__init__(columns)
        self.unusable = dict(unusable or {})
        self.units = dict(units or {})
        self.clocks = frozenset(clocks)
        self.findings = tuple(findings)
        self.rate: float | None = None
        self.times: dict[str, str] = {}

    def at(self, time: str) -> Columns:
        """Return the columns at the instants of one time: those of another as they were last known
        then, NaN before; those without a time of their own as they are.
        """
        if time not in self.times.values():
            return self
        instants = self[time]
        columns = {name: self._at(name, instants, time) for name in self}
        other = {own for own in self.times.values() if own != time}
        left = {name: x for name, x in columns.items() if name not in other}
        return Columns(
            left, self.unusable, units=self.units, clocks=self.clocks, findings=self.findings
        )

    def _at(self, name: str, instants: Array, time: str) -> Array:
        own = self.times.get(name, time)
        if own == time:
            return self[name]
        before = np.searchsorted(self[own], instants, side="right") - 1
        return np.where(before < 0, np.nan, self[name][np.maximum(before, 0)])


def must_fit(path: Path, size: float, width: int = 0) -> None:
    """Refuse a file that holds more bytes, unpacked, or more columns than can be read."""
    if width > MOST_COLUMNS:
        raise BristleError(
            f"record {path}: has {width} columns, allowed {MOST_COLUMNS}; leave out those that are"
            " not needed"
        )
    if size > LARGEST_CONTENT:
        raise BristleError(
            f"record {path}: holds {size / 2**20:.0f} MiB unpacked, allowed"
            f" {LARGEST_CONTENT / 2**20:.0f}; cut the record or leave out columns"
        )


def columns_of(path: Path, found: Mapping[str, object], index: str = "[:, {}]") -> Columns:
    """Return the vectors among named arrays, and the columns of each matrix that is a table, named
    by `index`.
    """
    arrays = {name: np.asarray(value) for name, value in found.items()}
    must_fit(path, 8 * sum(math.prod(a.shape) for a in arrays.values() if a.dtype.kind in "fiuM"))
    first = 1 if "(" in index else 0
    vectors: dict[str, Array] = {}
    unusable: dict[str, str] = {}
    clocks = []
    for name, array in arrays.items():
        if why := _no_numbers(array):
            unusable[name] = why
        elif array.size == max(array.shape, default=0):
            vectors[name] = (
                in_seconds(array.ravel())
                if array.dtype.kind == "M"
                else array.ravel().astype(float)
            )
            clocks += [name] if array.dtype.kind == "M" else []
        else:
            table = array if array.shape[0] > array.shape[1] else array.T
            for k in range(table.shape[1]):
                vectors[name + index.format(first + k)] = np.ascontiguousarray(
                    table[:, k], dtype=float
                )
    must_fit(path, 0, len(vectors) + len(unusable))
    return Columns(vectors, unusable, clocks=clocks)


def _no_numbers(array: NDArray[np.generic]) -> str:
    """Return what an array holds if it cannot serve as columns; an empty text if it can."""
    if array.dtype.kind not in "fiuM":
        return KINDS.get(array.dtype.kind, "objects")
    if array.size == 0:
        return "nothing"
    if array.size == max(array.shape, default=0):
        return ""
    narrow = (
        array.ndim == 2
        and max(array.shape) >= MATRIX_RATIO * min(array.shape) > 0
        and array.dtype.kind != "M"
    )
    return "" if narrow else f"an array of shape {array.shape}"


def in_seconds(stamps: NDArray[np.generic]) -> Array:
    """Return timestamps in s since 1970; NaN where there is none."""
    since = stamps.astype("datetime64[ns]")
    seconds: Array = np.where(np.isnat(since), np.nan, since.astype(np.int64) * 1e-9)
    return seconds


def is_number(text: str) -> bool:
    """Return whether a text is a number with a decimal point."""
    try:
        float(text)
    except ValueError:
        return False
    return True
