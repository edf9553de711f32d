"""The step in which values are written: that of a sensor, or of a printed time."""

from __future__ import annotations

import numpy as np

from bristle.common.table import Array


def common_step(values: Array) -> float | None:
    """Return the step whose multiples nearly all values are (from the smallest on), None if there is none."""
    distinct = np.unique(values)
    distinct = distinct - distinct[0]
    gaps = np.diff(distinct)
    gaps = gaps[gaps > 1e-12 * max(1.0, float(np.max(np.abs(values))))]
    if len(gaps) < 2:
        return None
    # most neighbours are one step apart, but a spike lies anywhere, and some steps come in twos and threes only
    for start in dict.fromkeys((float(np.min(gaps)), float(np.median(gaps)))):
        for divisor in (1.0, 2.0, 3.0):
            step = _refined(start / divisor, gaps, distinct)
            if step is not None:
                return step
    return None


def _refined(step: float, gaps: Array, distinct: Array) -> float | None:
    """Return the step that fits gaps and values best, None if more than one in a hundred is no multiple of it."""
    reach = 8.0
    while True:  # small multiples fix the step roughly, larger ones ever better
        near = np.concatenate([gaps[gaps < reach * step], distinct[distinct < reach * step]])
        count = np.round(near / step)
        good = np.abs(near / step - count) < 0.1
        if not (count * good).any() or np.mean(~good) > 0.01:
            return None
        step = float(count[good] @ near[good] / (count[good] @ count[good]))
        if reach * step > distinct[-1]:
            return step
        reach *= 4.0
