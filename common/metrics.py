"""How far a simulated signal is from the measured one; a number that cannot be given is NaN."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NORMAL_95 = 1.96  # standard deviations from the middle to the ends of a 95 % interval


def rms(error: Array) -> float:
    """Return the root of the mean square of an error (n,); NaN if it is empty or not finite."""
    return (
        float(np.sqrt(np.mean(np.square(error))))
        if len(error) and np.isfinite(error).all()
        else math.nan
    )


def fit_percent(measured: Array, predicted: Array) -> float:
    """Return 100 (1 - |y - y^| / |y - mean y|) of signals (n,), 100 for a perfect model; NaN for a
    constant y or a failed y^.

    Source: ljung1999 (fit of a model, in per cent).
    """
    spread = rms(measured - np.mean(measured)) if len(measured) else math.nan
    return 100.0 * (1.0 - rms(measured - predicted) / spread) if spread > 0 else math.nan


def mse_percent(measured: Array, predicted: Array) -> float:
    """Return 100 var(measured - predicted) / var(measured); NaN if anything in it is not finite.

    Source: dixit2008 eq. (25)
    """
    spread = float(np.var(measured))
    with np.errstate(all="ignore"):
        value = 100.0 * float(np.var(measured - predicted)) / spread if spread > 0 else math.nan
    return value if math.isfinite(value) else math.nan
