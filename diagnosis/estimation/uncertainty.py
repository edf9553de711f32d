"""Covariance and confidence intervals of the fitted parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bristle.common.table import Array
from bristle.diagnosis.answer import Estimate
from bristle.diagnosis.estimation.likelihood import Fit, Problem, evaluate
from bristle.diagnosis.estimation.optimiser import (
    NONSMOOTH_SPREADS,
    nonsmooth_parameters,
    perturbed,
    perturbed_values,
)
from bristle.diagnosis.estimation.simulator import OWN_BRISTLES
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.modelfile import Model
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects

INTERVAL_FACTOR = 2.0  # ratio of an interval's width to the one that the covariance gives
# the same for effects that act beyond a place or a limit only, and for couplings
EDGE_INTERVAL_FACTOR = 5.0
# evaluations for each coefficient of the parabola through a nonsmooth likelihood
PARABOLA_TRIALS = 6
CONTACT_SPREAD = 0.05  # relative: spread of these evaluations if a load has free play
RECORD_BLOCKS = 4  # parts of a stretch of a record whose scores count as independent
# half an interval of the strength of an effect over its value, of one that must not be nothing: 0
# is outside its interval then
ANY_STRENGTH = 1.0
WIDEST_HALF_INTERVAL = 1.0  # factor of e, or s: widest half interval that the parabola gives


def covariance(fit: Fit) -> Array:
    """Return the covariance of the free parameters (free, free), on the scale each moves on.

    The spread of the segments' own scores stands for the noise. Source: white1982 (sandwich).
    """
    scores = fit.slopes * fit.weight[:, None]
    n = max(int(np.count_nonzero(fit.weight)) - len(fit.free), 1)
    return _sandwich(fit.free, fit.information, scores.T @ scores * (n + len(fit.free)) / n)


def _sandwich(free: Sequence[Free], information: Array, scores: Array) -> Array:
    """Return the covariance of parameters (free, free) from their information and the covariance of
    their scores, each (free, free).

    That each is somewhere in its interval counts as a measurement: what the records do not show,
    such as the lag of a controller beside the damping, has the width of its interval, and not none.
    """
    anywhere = np.diag([f.precision for f in free])
    inverse = np.linalg.pinv(information + anywhere, rcond=1e-14, hermitian=True)
    return np.asarray(inverse @ (scores + anywhere) @ inverse)


def block_covariance(fit: Fit) -> Array:
    """Return the covariance of the parameters of a fit to long stretches (free, free), on the scale
    each moves on.

    Output errors of a long simulation are strongly correlated in time: the spread of the scores of
    blocks of it stands for that. Source: white1982 (sandwich), kunsch1989 (blocks).
    """
    own = fit.elimination.project(fit.by_parameter)
    blocks = [np.array_split(each, RECORD_BLOCKS, axis=1) for each in (own, fit.white)]
    scores = np.concatenate(
        [np.einsum("sbp,sb->sp", columns, white) for columns, white in zip(*blocks, strict=True)]
    )
    n = len(scores)
    spread = scores.T @ scores * n / max(n - len(fit.free), 1)
    return _sandwich(fit.free, np.einsum("sbp,sbq->pq", own, own), spread)


def refitted_estimates(
    model: Model, fit: Fit, before: Mapping[str, Estimate]
) -> dict[str, Estimate]:
    """Return estimates with those parameters replaced that were fitted to long stretches.

    Their intervals hold at both ends: they reach over what the segments gave (`before`) and over
    what the stretches give.
    """
    refitted = dict(before)
    for f, deviation in zip(
        fit.free, np.sqrt(np.maximum(np.diag(block_covariance(fit)), 0.0)), strict=True
    ):
        value, wide, first = fit.values[f.name], 1.96 * INTERVAL_FACTOR * deviation, before[f.name]
        ends = (
            [value * math.exp(-wide), value * math.exp(min(wide, 50.0))]
            if f.factor
            else [value - wide, value + wide]
        )
        ends += [first.value, *(first.ci95 or ())]
        low, high = model.allowed(f.name)
        ci95 = float(max(min(ends), low)), float(min(max(ends), high))
        refitted[f.name] = Estimate(float(value), first.unit, ci95, f.at_bound(value))
    return refitted


def parabola_half_widths(problem: Problem, fit: Fit, own: list[Free]) -> dict[str, float]:
    """Return half the width of the intervals of parameters of nonsmooth effects, on the scale of
    `perturbed`.

    Their likelihood has many small maxima, and its derivative at one of them does not describe the
    others. A parabola is fitted to the likelihood of random values around the fit; the interval is
    where it falls by the usual amount plus twice the standard deviation of the residuals of the
    parabola.

    Source: box1951 (response surface).
    """
    k = len(own)
    pairs = [(i, j) for i in range(k) for j in range(i, k)]
    wide = np.array(
        [
            CONTACT_SPREAD if find_effect(f.name.split(".")[0]).free_play else NONSMOOTH_SPREADS[0]
            for f in own
        ]
    )
    # likelihoods of random values around the fit
    steps = wide * np.random.default_rng(3).standard_normal(
        (PARABOLA_TRIALS * (1 + k + len(pairs)), k)
    )
    totals = [
        evaluate(problem, fit.fixed().at(perturbed_values(fit.values, own, step))).total
        for step in steps
    ]
    # the parabola through them, and how far they scatter around it
    columns = np.column_stack(
        [np.ones(len(steps)), steps, *(steps[:, i] * steps[:, j] for i, j in pairs)]
    )
    coefficients = np.linalg.lstsq(columns, np.array(totals), rcond=None)[0]
    uneven = math.sqrt(
        float(np.square(totals - columns @ coefficients).sum()) / (len(steps) - len(coefficients))
    )
    # where it falls far enough; directions in which it hardly falls end at the widest
    curvature = np.zeros((k, k))
    for (i, j), c in zip(pairs, coefficients[1 + k :], strict=True):
        curvature[i, j] -= c
        curvature[j, i] -= c
    fall = 0.5 * (1.96 * INTERVAL_FACTOR) ** 2 + 2 * uneven
    values, vectors = np.linalg.eigh(curvature)
    inverse = (vectors / np.maximum(values, 2 * fall / WIDEST_HALF_INTERVAL**2)) @ vectors.T
    return {
        f.name: float(min(math.sqrt(2 * fall * inverse[i, i]), WIDEST_HALF_INTERVAL))
        for i, f in enumerate(own)
    }


def estimates(model: Model, fit: Fit, problem: Problem | None = None) -> dict[str, Estimate]:
    """Return the free parameters with their `intervals`, within what each parameter may be."""
    estimated = {}
    for f, (least, most) in zip(fit.free, intervals(fit, problem), strict=True):
        if f.nominal is not None and f.name.startswith(f"{OWN_BRISTLES}."):
            continue
        low, high = model.allowed(f.name)
        ci95 = float(max(least, low)), float(min(most, high))
        estimated[f.name] = Estimate(
            float(fit.values[f.name]), model.unit(f.name), ci95, f.at_bound(fit.values[f.name])
        )
    return estimated


def intervals(fit: Fit, problem: Problem | None = None) -> list[tuple[float, float]]:
    """Return the 95 % intervals of the free parameters, whatever each may be.

    They are wider than the covariance gives by factors found on development records. With a
    problem, those of nonsmooth effects are taken from `parabola_half_widths` if these are wider.
    """
    deviation = np.sqrt(np.maximum(np.diag(covariance(fit)), 0.0))
    own = nonsmooth_parameters(fit, all_effects()) if problem is not None else []
    wide_at = parabola_half_widths(problem, fit, own) if problem is not None and own else {}
    all_ends = []
    for f, each in zip(fit.free, deviation, strict=True):
        wide, value = (
            1.96 * (EDGE_INTERVAL_FACTOR if _has_edges(f.name) else INTERVAL_FACTOR) * each,
            fit.values[f.name],
        )
        ends = (
            [value * math.exp(-wide), value * math.exp(min(wide, 50.0))]
            if f.factor
            else [value - wide, value + wide]
        )
        if f.name in wide_at:
            ends += [perturbed(f.name, value, side * wide_at[f.name]) for side in (-1, 1)]
        all_ends.append((min(ends), max(ends)))
    return all_ends


def strength_is_known(fit: Fit, problem: Problem, name: str, share: float) -> bool:
    """Return whether an effect's strength, or its free play, is known to within this share.

    Several strengths count as one vector: each of them may be 0 where not all of them are.
    """
    strengths = find_effect(name).strengths
    places = [k for k, f in enumerate(fit.free) if f.name in strengths]
    if not places:
        return True
    if len(places) > 1:
        size = np.array([fit.values[fit.free[k].name] for k in places])
        spread = INTERVAL_FACTOR**2 * covariance(fit)[np.ix_(places, places)]
        return float(size @ np.linalg.pinv(spread, hermitian=True) @ size) > (1.96 / share) ** 2
    f, (low, high) = fit.free[places[0]], intervals(fit, problem)[places[0]]
    ends, value = (float(max(low, f.low)), float(min(high, f.high))), fit.values[f.name]
    return Estimate(value, "", ends, f.at_bound(value)).known_within(share)


def _has_edges(parameter: str) -> bool:
    """True for parameters of effects that act beyond a place or a limit, whose likelihood is no
    parabola, and of couplings.
    """
    name = parameter.split(".")[0]
    return name in all_effects() and (
        find_effect(name).sparse or find_effect(name).coupling is not None
    )
