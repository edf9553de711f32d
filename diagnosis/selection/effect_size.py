"""Factor by which the squared errors of segments fall, robust against outliers."""

from __future__ import annotations

import numpy as np

from bristle.common.table import Array

OUTLIER_QUARTILES = 10.0  # times the upper quartile of the segments' squared errors: most that one segment counts for


def typical_fall(before: Array, after: Array) -> float:
    """Return by which factor the mean squared error of a typical segment falls."""
    return float(np.exp(np.mean(np.log(np.maximum(before, 1e-300) / np.maximum(after, 1e-300)))))


def fall(before: Array, after: Array, sparse: bool = False) -> float:
    """Return by which factor mean squared errors of segments (segments,) fall.

    Outliers are clipped, unless the effect is `sparse`: one that acts in a few segments only.
    """
    most = np.inf if sparse else OUTLIER_QUARTILES * max(float(np.quantile(after, 0.75)), 1e-300)
    return float(np.minimum(before, most).sum() / np.minimum(after, most).sum())


def acting_fall(before: Array, after: Array) -> float:
    """Return by which factor mean squared errors (segments,) fall in segments where they change much.

    In the mean of all segments an effect that acts in a few is hidden.
    """
    acting = np.abs(before - after) > np.quantile(after, 0.75)
    return float(before[acting].sum() / max(float(after[acting].sum()), 1e-300)) if acting.any() else 1.0
