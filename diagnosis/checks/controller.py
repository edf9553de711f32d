"""What follows a setpoint: start values of a controller, from the motion that slides.

All torques of such a model are relative to the controller's gain kp. Where that is not known, it is
chosen so that the inertia is the nominal one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bristle.common.errors import BristleError
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.sliding.fit import SlidingFit
from bristle.diagnosis.sliding.screen import GROSS_GAIN
from bristle.diagnosis.sliding.torque import drive_torque
from bristle.plant.controller import CONTROLLER
from bristle.plant.servo import J

LOOP_FREQUENCIES = (1.0, 3.0, 9.0, 27.0)  # Hz: of the loops from which a controller is fitted
START_LAG = 1e-3  # s: lag of a controller's velocity from which it is fitted
LARGE = 0.98  # quantile of the torque that is asked for: a limit from which it is fitted
START_WEIGHT = 0.8  # of the setpoint beside kp, from which it is fitted
START_INTEGRAL = 1.0  # 1/s: integral over proportional action from which it is fitted

Values = Mapping[str, float]
Slides = Callable[[Model], SlidingFit | None]


@dataclass(frozen=True)
class _Fitted:
    """A controller as the motion that slides shows it: its values, the log-likelihood, and a large
    torque that it asks for.
    """

    own: Values
    total: float
    large: float


def with_controller(model: Model, slides: Slides) -> Model:
    """Return a model with start values of what is not known of its controller; as it is where its
    input is no setpoint.

    `slides` fits a model to where the records slide. Damping, integral action and a limit are taken
    where the motion is likelier with them; a constant torque does not count as integral action.
    """
    known = model.controller
    if known is None or {"kp", "ki", "kd"} <= set(known):
        return model
    inertia = model.parameters[J.name]
    starts = [inertia * (2 * math.pi * f) ** 2 for f in LOOP_FREQUENCIES]
    tries = [_fitted(model, slides, {"kp": kp, "kd": 0.0}) for kp in starts]
    best = max(tries, key=lambda each: each.total)
    if not math.isfinite(best.total):
        raise BristleError(
            "records: too little motion to find the controller; record longer moves of the"
            " setpoint, or give kp, ki and kd in [controller]"
        )
    kp = best.own["kp"]
    best = _likelier(model, slides, best, {"kd": math.sqrt(inertia * kp)})
    shifted = replace(model, effects={"bias": {"torque": 0.0}, **model.effects})
    constant = _fitted(shifted, slides, best.own).total - best.total
    integral = {"ki": START_INTEGRAL * kp, "integral": 0.0}
    best = _likelier(model, slides, best, integral, max(constant, 0.0))
    if "ki" in best.own:
        best = _likelier(model, slides, best, {"weight": START_WEIGHT})
    best = _likelier(model, slides, best, {"limit": best.large})
    own = {"lag": START_LAG, **best.own, **known}
    return replace(model, effects={**model.effects, CONTROLLER.name: own})


def _likelier(
    model: Model, slides: Slides, best: _Fitted, more: Values, least: float = 0.0
) -> _Fitted:
    """Return a fit with more of a controller, where that gains more than `least` [nats]."""
    if set(more) <= set(model.controller or {}):
        return best
    other = _fitted(model, slides, {**best.own, **more})
    return other if other.total > best.total + least + GROSS_GAIN else best


def _fitted(model: Model, slides: Slides, start: Values) -> _Fitted:
    """Return a model fitted from start values of its controller, those that are known aside."""
    known = model.controller or {}
    own = {**start, **known}
    fit = slides(replace(model, effects={**model.effects, CONTROLLER.name: own}))
    if fit is None:
        return _Fitted(own, -math.inf, math.inf)
    # torques that nothing measures, in units in which the inertia is the nominal one
    scale = 1.0 if "kp" in known else model.parameters[J.name] / fit.values[J.name]
    found = {}
    for p in CONTROLLER.parameters:
        key = p.name.removeprefix(f"{CONTROLLER.name}.")
        if key in own:
            torque = "N.m" in p.unit and key not in known
            found[key] = fit.values[p.name] * (scale if torque else 1.0)
    asked = drive_torque(fit.model.effects, fit.values, fit.model.over)
    return _Fitted(found, fit.total, scale * float(np.quantile(np.abs(asked), LARGE)))
