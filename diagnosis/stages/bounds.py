"""Parameters that end at a bound: whether wider bounds explain the records without any effect, and
what is said of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bristle.diagnosis.answer import Estimate, Finding, Reason, finding
from bristle.diagnosis.checks.preparation import PreparedCase
from bristle.diagnosis.estimation.fitted_model import fit_with_noise
from bristle.diagnosis.estimation.likelihood import Fit
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.modelfile import BOUND_FACTOR, Model


def wider_bounds(case: PreparedCase, fit: Fit) -> Finding | None:
    """Return a proposal where wider bounds alone explain the records better than the effects found
    within them.
    """
    values, bounds = case.base.fit.values, case.model.bounds
    tight = {
        f.name: f
        for f in case.base.servo.free
        if f.name in bounds and f.at_binding_bound(values[f.name])
    }
    if not tight:
        return None
    free = tuple(f.widened(BOUND_FACTOR) if f.name in tight else f for f in case.base.servo.free)
    wide = fit_with_noise(case.dataset, replace(case.base.servo, free=free), values)
    # half of the Bayesian information criterion's penalty for the effects' parameters
    price = (
        0.5
        * (len(fit.free) - len(wide.fit.free))
        * math.log(np.count_nonzero(case.dataset.train) + 1.0)
    )
    worse = wide.fit.total < fit.total - price
    return None if worse else widening(case.model, tight, wide.fit.values)


def widening(
    model: Model, tight: Mapping[str, Free], values: Mapping[str, float]
) -> Finding | None:
    """Return the proposal to widen those tight bounds that the values of a better fit leave; None
    if they leave none.
    """
    # the others are at a bound only because of these
    outside = tuple(
        (name, values[name], model.unit(name), f.low, f.high)
        for name, f in tight.items()
        if not f.low <= values[name] <= f.high
    )
    return finding(Reason.WIDER_BOUNDS, parameters=outside) if outside else None


def bound_notes(
    model: Model, plain: Mapping[str, Estimate], whole: Mapping[str, Estimate]
) -> list[Finding]:
    """Return a note on parameters of the plain model that end at a bound, and on whether they still
    do with what was found.
    """
    return [
        finding(
            Reason.AT_BOUND,
            name=name,
            value=e.value,
            unit=e.unit,
            bounds=model.bounds.get(name, (-math.inf, math.inf)),
            still=name not in whole or whole[name].at_bound,
        )
        for name, e in plain.items()
        if e.at_bound
    ]
