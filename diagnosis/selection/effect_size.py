"""Factor by which the squared errors of segments fall, robust against outliers."""

from __future__ import annotations

import numpy as np

from bristle.common.table import Array

LEAST_FALL = 1.2  # factor by which an effect must lower the mean squared error
OUTLIER_QUARTILES = 10.0  # times the upper quartile of the segments' squared errors: most that one segment counts for


def fall(before: Array, after: Array) -> float:
    """Return by which factor mean squared errors of segments (segments,) fall, with outliers clipped.

    Where a servo sticks and slips, a few segments that diverge by chance make up most of the mean.
    """
    most = OUTLIER_QUARTILES * max(float(np.quantile(after, 0.75)), 1e-300)
    return float(np.minimum(before, most).sum() / np.minimum(after, most).sum())
