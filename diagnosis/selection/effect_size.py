"""How large an error is, so that no chance event decides: squares of segments, and by which factor they fall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
OUTLIER_QUARTILES = 10.0  # of the upper quartile: where a segment counts no more, be it that the servo stuck or slipped by chance


def typical_fall(before: Array, after: Array) -> float:
    """Return by which factor the mean squared error of a typical segment falls."""
    return float(np.exp(np.mean(np.log(np.maximum(before, 1e-300) / np.maximum(after, 1e-300)))))


def fall(before: Array, after: Array, local: bool = False) -> float:
    """Return by which factor mean squared errors of segments (segments,) fall.

    None counts more than some usual ones, unless the effect is `local`: one that can only show in a few segments.
    """
    most = np.inf if local else OUTLIER_QUARTILES * max(float(np.quantile(after, 0.75)), 1e-300)
    return float(np.minimum(before, most).sum() / np.minimum(after, most).sum())


def acting_fall(before: Array, after: Array) -> float:
    """Return by which factor mean squared errors (segments,) fall where an effect acts: where they change more than is usual.

    What acts in a few segments is hidden by all others in a mean.
    """
    acting = np.abs(before - after) > np.quantile(after, 0.75)
    return float(before[acting].sum() / max(float(after[acting].sum()), 1e-300)) if acting.any() else 1.0
