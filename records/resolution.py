"""The resolution of a column: the step of a sensor, or of the digits of a written time; and a step
that stands for noise.
"""

from __future__ import annotations

import math

import numpy as np

from bristle.common.table import Array

MULTIPLE_TOLERANCE = 0.15  # steps: deviation from a whole number of steps that cut digits may cause
# of the distances between distinct values: where their step is looked for, coarse first
GAP_QUANTILES = (0.9, 0.5, 0.0)
# of the differences of neighbours, in which noise is left and the motion of a servo is not
NOISE_ORDER = 5


def common_step(values: Array, finest: bool = False) -> float | None:
    """Return the step of which nearly all values, counted from the smallest, are multiples; None if
    there is none.

    The coarsest such step is that of a sensor; the `finest` is that of the digits in which it is
    written.
    """
    distinct = np.unique(values)
    distinct = distinct - distinct[0]
    gaps = np.diff(distinct)
    gaps = gaps[gaps > 1e-12 * max(1.0, float(np.max(np.abs(values))))]
    if len(gaps) < 2:
        return None
    # Many distinct neighbours are one step apart, but an outlier is not, some readings change by
    # two or three steps only, and where digits are cut a reading may be written in several ways,
    # which lie close together.
    starts = np.quantile(gaps, GAP_QUANTILES[::-1] if finest else GAP_QUANTILES, method="nearest")
    for start in dict.fromkeys(starts.tolist()):
        for divisor in (1.0, 2.0, 3.0):
            step = _refined(start, divisor, gaps, distinct)
            if step is not None:
                return step
    return None


def _refined(gap: float, parts: float, gaps: Array, distinct: Array) -> float | None:
    """Return the step near a part of a gap that fits gaps and values best; None if one in a hundred
    is no multiple of it.
    """
    step, range_steps = gap / parts, 2.5 * parts
    # small multiples give a rough step, larger ones refine it: printed digits may be a few per cent
    # of a step
    while True:
        within = np.concatenate(
            [gaps[gaps < range_steps * step], distinct[distinct < range_steps * step]]
        )
        count = np.round(within / step)
        fits = np.abs(within / step - count) < MULTIPLE_TOLERANCE
        if not (count * fits).any() or np.mean(~fits) > 0.01:
            return None
        step = float(count[fits] @ within[fits] / (count[fits] @ count[fits]))
        if range_steps * step > distinct[-1]:
            return step
        range_steps *= 2.0


def noise_step(values: Array) -> float:
    """Return the step of a sensor whose rounding would be as noisy as these values are.

    The variance of differences of order k of white noise is binomial(2k, k) times that of the
    noise; that of rounding is a twelfth of the square of its step. The mean deviation takes little
    notice of the few samples in which a motion has corners, and that of rounded values is not
    itself rounded. Source: hall1990 (noise from differences); widrow2008 chapter 1 (rounding).
    """
    differences = np.diff(values, NOISE_ORDER)
    if not len(differences):
        return 0.0
    # standard deviation of normal values
    deviation = math.sqrt(math.pi / 2) * float(np.mean(np.abs(differences)))
    return math.sqrt(12.0 / math.comb(2 * NOISE_ORDER, NOISE_ORDER)) * deviation
