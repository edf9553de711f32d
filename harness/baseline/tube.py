"""The tube of a signal: how far repeated runs are from a reference in value and in time, times a
safety factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

Array = NDArray[np.float64]

# allowed over measured deviation in value; benchmarks/results/baselines.md says how often less is
# too little
SAFETY = 10.0
SHIFT_SAFETY = 3  # the same in time: shifts are a few rows, and do not spread over decades
# rows by which events may move, of which the narrowest tube is taken
TUBE_SHIFTS = (0, 1, 2, 4, 8, 16, 32)
TUBE_BLOCKS = 200  # parts of a run, each with a spread of its own
TUBE_NEIGHBOURS = 3  # such parts on either side whose spread counts too
WRITTEN_SHARE = 1e-9  # of a value: signals.csv has ten digits
LEAST_MARGIN = 1e-300  # of a signal that is 0 throughout
# a smaller one is that of a signal that is 0, in a baseline rounded to single precision
EXACT_MARGIN = 1e-40


@dataclass(frozen=True)
class Tube:
    """Lower and upper bound of a signal, shape (n,) each; `shift` is the measured shift of events
    in rows.

    They mean nothing where the reference has no number.
    """

    lower: Array
    upper: Array
    shift: int


class Spread:
    """How far runs of one scenario are from a reference, collected run by run: per signal, shift
    and block the largest distance.
    """

    def __init__(self, reference: Mapping[str, Array]) -> None:
        self.reference = reference
        rows = len(next(iter(reference.values())))
        self.blocks = min(TUBE_BLOCKS, rows)
        self.starts = np.linspace(0, rows, self.blocks, endpoint=False).astype(np.intp)
        self.shifts = tuple(shift for shift in TUBE_SHIFTS if 10 * shift < rows)
        self.worst = {name: np.zeros((len(self.shifts), self.blocks)) for name in reference}
        self._widths: dict[str, float] = {}

    def add(self, signals: Mapping[str, Array]) -> None:
        """Take another run into account; where it has no number, nothing is said of the bounds."""
        for name, expected in self.reference.items():
            got = signals.get(name)
            if got is None or len(got) != len(expected):
                self.worst[name][:] = np.inf
                continue
            if np.array_equal(got, expected, equal_nan=True):
                continue
            known = np.isfinite(expected)
            self._add(name, np.where(known, got, 0.0), np.where(known, expected, 0.0))

    def _add(self, name: str, got: Array, expected: Array) -> None:
        for k, shift in enumerate(self.shifts):
            lower, upper = envelope(expected, shift)
            distance = np.maximum(np.maximum(lower - got, got - upper), 0.0)
            distance[~np.isfinite(got)] = np.inf
            block = np.maximum.reduceat(distance, self.starts)
            self.worst[name][k] = np.maximum(self.worst[name][k], block)
            # a wider envelope gives no narrower tube
            if 2 * block.max() <= self._least_width(name, expected):
                self.worst[name][k + 1 :] = np.maximum(self.worst[name][k + 1 :], block)
                break

    def _least_width(self, name: str, expected: Array) -> float:
        """Return how wide a tube is at least in which events may move at all."""
        if name not in self._widths:
            lower, upper = envelope(expected, TUBE_SHIFTS[1])
            self._widths[name] = float(np.mean(upper - lower))
        return self._widths[name]

    def tube(self, name: str) -> Tube:
        """Return the tube of a signal: of all shifts the one with which it is narrowest."""
        given = self.reference[name]
        expected = np.where(np.isfinite(given), given, 0.0)
        best: tuple[float, int] | None = None
        for k, shift in enumerate(self.shifts):
            lower, upper = envelope(expected, shift)
            width = float(np.mean(upper - lower)) + 2 * float(np.mean(self._smoothed(name, k)))
            if best is None or width < best[0]:
                best = width, k
            if 2 * self.worst[name][k].max() <= self._least_width(name, expected):
                break
        k = 0 if best is None else best[1]
        lower, upper = envelope(expected, SHIFT_SAFETY * self.shifts[k])
        each = np.repeat(
            SAFETY * self._smoothed(name, k), np.diff(np.append(self.starts, len(expected)))
        )
        return Tube(
            lower - each - written_margin(lower),
            upper + each + written_margin(upper),
            self.shifts[k],
        )

    def _smoothed(self, name: str, k: int) -> Array:
        return np.asarray(
            maximum_filter1d(self.worst[name][k], 2 * TUBE_NEIGHBOURS + 1, mode="nearest")
        )


def envelope(values: Array, shift: int) -> tuple[Array, Array]:
    """Return the least and the largest value within so many rows of each row."""
    if not shift:
        return values, values
    size = 2 * shift + 1
    return np.asarray(minimum_filter1d(values, size, mode="nearest")), np.asarray(
        maximum_filter1d(values, size, mode="nearest")
    )


def written_margin(values: Array) -> Array:
    """Return what the digits of signals.csv alone may change in each value."""
    return WRITTEN_SHARE * np.abs(values) + LEAST_MARGIN
