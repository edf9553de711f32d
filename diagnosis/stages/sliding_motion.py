"""After the search: the parameters from the likelihood of the sliding motion, which holds in tight
loops too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from bristle.common.metrics import NORMAL_95
from bristle.diagnosis.answer import Diagnosis, Estimate
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel, sliding_fit
from bristle.diagnosis.estimation.simulator import LOOP_DELAY
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.sliding.fit import SlidingFit
from bristle.diagnosis.stages.case import Budget, SearchedCase
from bristle.plant.controller import CONTROLLER
from bristle.plant.effects import effects
from bristle.plant.servo import A2, J

Estimates = Mapping[str, Estimate]

MUCH_WIDER = 3.0  # than intervals by segments: of what the sliding motion hardly shows


def from_sliding_motion(case: SearchedCase, answer: Diagnosis, _: Budget) -> Diagnosis:
    """Return an answer with the parameters that the sliding motion shows more closely than the
    segments do: none where the torque is only asked for.
    """
    if case.model.controller is not None:
        held = case.model.controller
        of = [_beside_late_damping(each, held) for each in (answer.base, answer.fitted)]
        return replace(answer, base=of[0], fitted=of[1])
    base = sliding_estimates(case.dataset, case.model, case.base, answer.base)
    fitted = base
    if case.final is not case.base:
        fitted = sliding_estimates(case.dataset, case.model, case.final, answer.fitted)
    effects = tuple(effect.with_estimates(fitted) for effect in answer.effects)
    return replace(answer, base=base, fitted=fitted, effects=effects)


def _beside_late_damping(
    estimates: Mapping[str, Estimate], controller: Mapping[str, float]
) -> dict[str, Estimate]:
    """Return estimates with an inertia that reaches as far as a controller may make it seem less:
    one that answers a velocity that it sees late takes the damping times that delay from it. A kd
    of 0 is given: no damping is the controller's then.
    """
    if J.name not in estimates or (inertia := estimates[J.name]).ci95 is None:
        return dict(estimates)
    if controller.get("kd") == 0:
        return dict(estimates)
    kd, lag = (f"{CONTROLLER.name}.{name}" for name in ("kd", "lag"))
    value = {name: e.value for name, e in estimates.items()}
    damping = value.get(A2.name, 0.0) + value.get(kd, 0.0)
    seen = value.get(kd, 0.0) * value.get(lag, 0.0)
    low, high = inertia.ci95
    more = max(damping * LOOP_DELAY - seen, 0.0)
    return {**estimates, J.name: replace(inertia, ci95=(low, high + more))}


def sliding_estimates(
    dataset: Dataset, model: Model, fitted: FittedModel, before: Estimates
) -> dict[str, Estimate]:
    """Return estimates with those of the sliding motion in their place: of inertia, viscous and dry
    friction, whose intervals by segments are too short where bristles or the encoder's steps decide
    when the servo sticks, and of all that it shows with intervals that are not much wider.

    The others stay within their intervals: what acts at low speed, such as Stribeck friction, does
    not show while the servo slides, and effects that switch have likelihoods without useful slopes.
    """
    kept = {**fitted.fit.values, **{name: e.value for name, e in before.items()}}
    own = [f for f in fitted.servo.free if f.name in before]
    shown = {f.name for f in own if not _switches(f.name)}
    while True:
        # the others are known as well as the segments show them
        free = tuple(f if f.name in shown else _known(f, before[f.name]) for f in own)
        slides = sliding_fit(dataset, replace(fitted.servo, free=free), kept)
        if slides is None:
            return dict(before)
        known = slides.deviations()
        found = {name: _estimate(model, slides, name, known[name]) for name in shown}
        closer = {
            name
            for name in shown
            if _is_of_motion(name) or _width(found[name]) <= MUCH_WIDER * _width(before[name])
        }
        if closer == shown:
            return _moved(before, slides) | found
        shown = closer


def _moved(before: Estimates, slides: SlidingFit) -> dict[str, Estimate]:
    """Return the estimates of the segments, within their intervals as they go with those of the
    sliding motion: a wider dead zone leaves less dry friction.
    """

    def within(name: str, estimate: Estimate) -> float:
        low, high = estimate.ci95 or (-math.inf, math.inf)
        return float(min(max(slides.values.get(name, estimate.value), low), high))

    return {name: replace(each, value=within(name, each)) for name, each in before.items()}


def _known(free: Free, estimate: Estimate) -> Free:
    """Return a free parameter with its estimate as prior."""
    low, high = estimate.ci95 or (free.low, free.high)
    sd = max(high - low, 1e-6 * abs(estimate.value), 1e-12) / (2 * NORMAL_95)
    return replace(free, factor=False, nominal=estimate.value, prior_sd=sd)


def _estimate(model: Model, slides: SlidingFit, name: str, deviation: float) -> Estimate:
    value, (low, high) = slides.values[name], model.allowed(name)
    [free] = [f for f in slides.model.free if f.name == name]
    ends = (value - NORMAL_95 * deviation, value + NORMAL_95 * deviation)
    ci95 = float(max(ends[0], low)), float(min(ends[1], high))
    return Estimate(float(value), model.unit(name), ci95, free.at_bound(value))


def _is_of_motion(parameter: str) -> bool:
    return parameter in (J.name, A2.name) or parameter.endswith(".Fc")


def _switches(parameter: str) -> bool:
    name = parameter.split(".")[0]
    return name in effects() and (effects()[name].nonsmooth or effects()[name].sparse)


def _width(estimate: Estimate) -> float:
    low, high = estimate.ci95 or (0.0, float("inf"))
    return high - low
