"""The input between two samples: held, or on its way to the next value."""

from __future__ import annotations

import numpy as np

from bristle.common.table import Array


def mixed(u: Array, share: float) -> Array:
    """Return an input, shape (n,), as the mean of each sample and the next one, which has this
    share; the last sample stays.
    """
    return np.append((1 - share) * u[:-1] + share * u[1:], u[-1])
