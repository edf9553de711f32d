"""Velocities that are the differences of a position's readings: told from others, and summed to
that position.
"""

from __future__ import annotations

import numpy as np

from bristle.common.table import Array
from bristle.records.resolution import common_step

# Correlation of neighbours among the second differences of white noise, and of the differences of
# white noise: ratios of autocovariances whose terms are products of binomial coefficients.
OF_NOISE, OF_DIFFERENCES = -4.0 / 6.0, -15.0 / 20.0


def are_differences(y: Array, step: float | None) -> bool:
    """Return whether a velocity (n,) comes in steps, and its noise is that of differences: it
    swings back at once.

    A tachometer's noise is white, or changes slowly.
    """
    twice = np.diff(y, 2)
    power = float(twice @ twice)
    return bool(
        step
        and power > 0.0
        and float(twice[1:] @ twice[:-1]) / power < (OF_NOISE + OF_DIFFERENCES) / 2
    )


def summed(y: Array, h: float) -> Array:
    """Return the position (n,) whose differences over a sampling period h [s] are a velocity (n,),
    from 0, in whole steps of it.
    """
    step = common_step(y)
    counts = y if step is None else step * np.round(y / step)
    return np.asarray(h * np.concatenate([[0.0], np.cumsum(counts[1:])]))
