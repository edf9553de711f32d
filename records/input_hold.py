"""The input between two samples: held, or on its way to the next value."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening, uniform_filter1d

from bristle.common.table import Array

OSCILLATION_SAMPLES = 50  # samples within which an oscillation is told
# of its power about the mean: second differences from which on the input oscillates faster than
# samples show, which a sine does from a quarter of the sampling rate on
ALIASED_POWER = 4.0
# of the whole input's power: what varies less within a window is at rest
REST_POWER = 1e-4


def mixed(u: Array, share: float) -> Array:
    """Return an input, shape (n,), as the mean of each sample and the next one, which has this
    share; the last sample stays.
    """
    return np.append((1 - share) * u[:-1] + share * u[1:], u[-1])


def aliased(u: Array) -> NDArray[np.bool_]:
    """Return where samples of an input (n,) that is not held do not show it: from where it
    oscillates faster than a quarter of the sampling rate until it rests.

    A sweep that has passed half the sampling rate looks slow again, so that its speed tells nothing
    from there on.
    """
    bend = np.concatenate([[0.0], np.diff(u, 2), [0.0]])
    power = uniform_filter1d(np.square(u), OSCILLATION_SAMPLES) - np.square(
        uniform_filter1d(u, OSCILLATION_SAMPLES)
    )
    rests = power <= REST_POWER * float(np.var(u))
    fast = ~rests & (uniform_filter1d(np.square(bend), OSCILLATION_SAMPLES) > ALIASED_POWER * power)
    # a step out of rest is fast for a few samples
    fast = binary_opening(fast, np.ones(OSCILLATION_SAMPLES // 2, dtype=bool))
    # what was seen last, of the two
    seen = np.maximum.accumulate(np.where(fast | rests, np.arange(len(u)), 0))
    return np.asarray(fast[seen])
