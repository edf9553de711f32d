"""How large an error is, so that no chance event decides: squares of segments, and by which factor they fall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.fit import Fit

Array = NDArray[np.float64]

OUTLYING = 10.0  # of the upper quartile: where a segment counts no more, be it that the servo stuck or slipped by chance


def errors(fit: Fit, mask: NDArray[np.bool_]) -> list[Array]:
    """Return the error of each segment, an array (bins,) each, start states at their best [output].

    Where the simulation failed it is that of a servo that stands still: no model may gain by failing.
    """
    seen = fit.simulator.segments.seen
    lost = np.where(fit.good[:, None], fit.residual, seen - seen.mean(axis=1, keepdims=True))
    pairs = zip(lost[mask], fit.raw_by_start[mask], strict=True)  # segments are few and short
    return [r - c @ np.linalg.lstsq(c, r, rcond=1e-9)[0] for r, c in pairs]


def squares(fit: Fit, mask: NDArray[np.bool_]) -> Array:
    """Return the mean squared error of each segment (segments,), start states at their best [output squared]."""
    return np.array([np.mean(np.square(error)) for error in errors(fit, mask)])


def mean_square(fit: Fit, mask: NDArray[np.bool_]) -> float:
    """Return the mean squared error over segments, start states at their best [output squared]."""
    return float(np.mean(squares(fit, mask)))


def typical_fall(before: Array, after: Array) -> float:
    """Return by which factor the mean squared error of a typical segment falls."""
    return float(np.exp(np.mean(np.log(np.maximum(before, 1e-300) / np.maximum(after, 1e-300)))))


def fall(before: Array, after: Array, local: bool = False) -> float:
    """Return by which factor mean squared errors of segments (segments,) fall.

    None counts more than some usual ones, unless the effect is `local`: one that can only show in a few segments.
    """
    most = np.inf if local else OUTLYING * max(float(np.quantile(after, 0.75)), 1e-300)
    return float(np.minimum(before, most).sum() / np.minimum(after, most).sum())


def acting_fall(before: Array, after: Array) -> float:
    """Return by which factor mean squared errors (segments,) fall where an effect acts: where they change more than is usual.

    What acts in a few segments is hidden by all others in a mean.
    """
    acting = np.abs(before - after) > np.quantile(after, 0.75)
    return float(before[acting].sum() / max(float(after[acting].sum()), 1e-300)) if acting.any() else 1.0
