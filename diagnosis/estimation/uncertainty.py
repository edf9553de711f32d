"""How far the parameters are known."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.likelihood import Fit, Problem, evaluate
from bristle.diagnosis.estimation.optimiser import NONSMOOTH_SPREADS, nonsmooth_parameters, perturbed
from bristle.diagnosis.estimation.simulator import OWN_BRISTLES, Free, has_free_play
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report import result as answer
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects

Array = NDArray[np.float64]
INTERVAL_FACTOR, EDGE_INTERVAL_FACTOR = 2.0, 5.0  # than what the spread of scores gives for an interval
PARABOLA_TRIALS = 6  # values around the fit for each coefficient of the parabola that stands for a likelihood with many maxima
CONTACT_SPREAD = 0.05  # how far around, where a contact is one of them: its likelihood is a parabola no further
WIDEST_HALF_INTERVAL = 1.0  # a factor of e, or a second: half of the widest interval that it can give


def covariance(fit: Fit) -> Array:
    """Return the covariance of the free parameters (free, free), on the scale each moves on.

    The spread of the segments' own scores stands for the noise. Source: white1982 (sandwich).
    """
    scores = fit.slopes * fit.weight[:, None]
    inverse = np.linalg.pinv(fit.information, rcond=1e-14, hermitian=True)
    n = max(int(np.count_nonzero(fit.weight)) - len(fit.free), 1)
    return np.asarray(inverse @ (scores.T @ scores) @ inverse * (n + len(fit.free)) / n)


def parabola_half_widths(problem: Problem, fit: Fit, own: list[Free]) -> dict[str, float]:
    """Return half the width of the intervals of parameters of effects that switch, on the scale that `perturbed` moves them on.

    Their likelihood is full of small maxima, at any of which a fit may end; a derivative at one of them says nothing of the
    others. So a parabola is laid through the likelihood of values all around, and an interval is as wide as it takes to
    fall by what the likelihood's own unevenness, twice its standard deviation, may add to the usual fall.

    Source: box1951 (response surface).
    """
    k = len(own)
    pairs = [(i, j) for i in range(k) for j in range(i, k)]
    wide = np.array([CONTACT_SPREAD if has_free_play(f.name.split(".")[0]) else NONSMOOTH_SPREADS[0] for f in own])
    steps = wide * np.random.default_rng(3).standard_normal((PARABOLA_TRIALS * (1 + k + len(pairs)), k))
    totals = []
    for step in steps:
        near = {f.name: f.inside(perturbed(f.name, fit.values[f.name], d)) for f, d in zip(own, step, strict=True)}
        totals.append(evaluate(problem, fit.simulator, (), {**fit.values, **near}, fit.starts).total)
    columns = np.column_stack([np.ones(len(steps)), steps, *(steps[:, i] * steps[:, j] for i, j in pairs)])
    found = np.linalg.lstsq(columns, np.array(totals), rcond=None)[0]
    uneven = math.sqrt(float(np.square(totals - columns @ found).sum()) / (len(steps) - len(found)))
    curvature = np.zeros((k, k))
    for (i, j), c in zip(pairs, found[1 + k :], strict=True):
        curvature[i, j] -= c
        curvature[j, i] -= c
    fall_ = 0.5 * (1.96 * INTERVAL_FACTOR) ** 2 + 2 * uneven
    values, vectors = np.linalg.eigh(curvature)
    inverse = (vectors / np.maximum(values, 2 * fall_ / WIDEST_HALF_INTERVAL**2)) @ vectors.T
    return {f.name: float(min(math.sqrt(2 * fall_ * inverse[i, i]), WIDEST_HALF_INTERVAL)) for i, f in enumerate(own)}


def estimates(model: Model, fit: Fit, problem: Problem | None = None) -> dict[str, answer.Estimate]:
    """Return the free parameters with their 95 % intervals, as wide as development records showed that they must be,
    within what each may be.

    With a problem, those of effects that switch are looked for all around.
    """
    deviation = np.sqrt(np.maximum(np.diag(covariance(fit)), 0.0))
    own = nonsmooth_parameters(fit, all_effects()) if problem is not None else []
    wide_at = parabola_half_widths(problem, fit, own) if problem is not None and own else {}
    found = {}
    for f, each in zip(fit.free, deviation, strict=True):
        if f.nominal is not None and f.name.startswith(f"{OWN_BRISTLES}."):
            continue
        wide, value = 1.96 * (EDGE_INTERVAL_FACTOR if _has_edges(f.name) else INTERVAL_FACTOR) * each, fit.values[f.name]
        ends = [value * math.exp(-wide), value * math.exp(min(wide, 50.0))] if f.factor else [value - wide, value + wide]
        if f.name in wide_at:
            ends += [perturbed(f.name, value, side * wide_at[f.name]) for side in (-1, 1)]
        low, high = model.allowed(f.name)
        ci95 = float(max(min(ends), low)), float(min(max(ends), high))
        found[f.name] = answer.Estimate(float(value), model.unit(f.name), ci95, f.stuck(value))
    return found


def _has_edges(parameter: str) -> bool:
    """True for parameters of effects that begin at a place or a level, where the likelihood is no parabola, and of couplings,
    whose resonance the records know better than any step of a simulation shows it."""
    name = parameter.split(".")[0]
    return name in all_effects() and (find_effect(name).local or find_effect(name).coupling is not None)
