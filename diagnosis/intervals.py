"""How far the parameters are known."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis import result as answer
from bristle.diagnosis.candidates import RIGID
from bristle.diagnosis.fit import Fit
from bristle.diagnosis.modelfile import Model
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects

Array = NDArray[np.float64]

WIDER, WIDER_AT_EDGES = 2.0, 5.0  # than what the spread of scores gives for an interval


def covariance(fit: Fit) -> Array:
    """Return the covariance of the free parameters (free, free), on the scale each moves on.

    The spread of the segments' own scores stands for the noise. Source: white1982 (sandwich).
    """
    scores = fit.slopes * fit.weight[:, None]
    inverse = np.linalg.pinv(fit.information, rcond=1e-14, hermitian=True)
    n = max(int(np.count_nonzero(fit.weight)) - len(fit.free), 1)
    return np.asarray(inverse @ (scores.T @ scores) @ inverse * (n + len(fit.free)) / n)


def estimates(model: Model, fit: Fit) -> dict[str, answer.Estimate]:
    """Return the free parameters with their 95 % intervals, as wide as development records showed that they must be."""
    deviation = np.sqrt(np.maximum(np.diag(covariance(fit)), 0.0))
    found = {}
    for f, each in zip(fit.free, deviation, strict=True):
        wide = 1.96 * (WIDER_AT_EDGES if _has_edges(f.name) else WIDER) * each
        if f.nominal is not None and f.name.startswith(f"{RIGID}."):
            continue
        value = fit.values[f.name]
        low, high = (value * math.exp(-wide), value * math.exp(min(wide, 50.0))) if f.factor else (value - wide, value + wide)
        found[f.name] = answer.Estimate(value, model.unit(f.name), (low, high), f.stuck(value))
    return found


def _has_edges(parameter: str) -> bool:
    """True for parameters of effects that begin at a place or a level: the likelihood is no parabola there."""
    name = parameter.split(".")[0]
    return name in all_effects() and (find_effect(name).local or find_effect(name).rugged)
