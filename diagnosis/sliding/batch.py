"""Normalised parameters of a servo from a whole record at once, beside torques of its position."""

from __future__ import annotations

import math

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.sliding.fit import SlidingFit, SlidingModel, fit_sliding
from bristle.diagnosis.sliding.screen import with_position_torques
from bristle.diagnosis.sliding.stretches import Stretches, stretches_of
from bristle.records.resolution import noise_step

LARGEST_BATCH = 200_000  # samples of a record, from its start, that are taken
SEARCHED_FACTOR = 1e3  # times the start values: how far parameters may move
# normalised parameters of the observers by the names that they have here for an inertia of 1
OF_UNIT_INERTIA = {"a2": "alpha2", "b": "b", "coulomb.Fc": "Fc"}


def batch_estimates(
    u: Array, y: Array, h: float, velocity: bool, resolution: float | None, rotary: bool
) -> dict[str, tuple[float, float]]:
    """Return alpha2, b and Fc [SI, over the inertia], each with its standard deviation; none where
    the record does not slide for long enough.

    Parameters are those of `batch_fit`.
    """
    fit = batch_fit(u, y, h, velocity, resolution, rotary)
    if fit is None:
        return {}
    known = fit.deviations()
    found = {name: (fit.values[own], known[own]) for own, name in OF_UNIT_INERTIA.items()}
    return {name: each for name, each in found.items() if all(map(math.isfinite, each))}


def batch_fit(
    u: Array, y: Array, h: float, velocity: bool, resolution: float | None, rotary: bool
) -> SlidingFit | None:
    """Return a servo with an inertia of 1 fitted to a record, beside the torques of its position
    that gain much; None where too little slides.

    Parameters
    ----------
    u, y : array (n,)
        Input, and position or `velocity` [SI], every `h` s.
    resolution : float or None
        Step of the sensor [unit of the output]; None: estimated from the readings.
    rotary : bool
        Whether a turn of the axis repeats its position.
    """
    u, y = u[:LARGEST_BATCH], y[:LARGEST_BATCH]
    try:
        resolution = resolution or noise_step(y)
        times = h * np.arange(len(y), dtype=np.float64)
        over = stretches_of([(times, u, y)], h, velocity, resolution)
        fit = _fitted(over, resolution)
        span = 2 * math.pi if rotary else float(np.ptp(over.theta))
        return fit and with_position_torques(fit, span, not rotary)
    except BristleError:  # without a compiler there is no filter
        return None


def _fitted(over: Stretches, resolution: float) -> SlidingFit | None:
    """Return the fit without these torques, from a regression on the smoothed motion."""
    c = over.counted
    if not len(c):
        return None
    columns = np.column_stack([over.u[c], -over.v[c], -np.sign(over.v[c])])
    size = np.sqrt(np.square(columns).mean(axis=0)) + 1e-300
    start = np.abs(np.linalg.lstsq(columns / size, over.a[c], rcond=None)[0] / size)
    least = 1e-3 * float(np.sqrt(np.mean(np.square(over.a[c])))) / size + 1e-300
    b, a2, friction = np.maximum(start, least).tolist()
    free = (
        Free("b", b / SEARCHED_FACTOR, b * SEARCHED_FACTOR, True),
        Free("a2", 0.0, a2 * SEARCHED_FACTOR),
        Free("coulomb.Fc", 0.0, friction * SEARCHED_FACTOR),
    )
    values = {"J": 1.0, "u_max": math.inf, "b": b, "a2": a2, "coulomb.Fc": friction}
    return fit_sliding(SlidingModel("coulomb", (), free, over, resolution), values)
