"""What follows a setpoint: start values of a controller, from the motion that slides.

All torques of such a model are relative to the controller's gain kp. Where that is not known, it is
chosen so that the inertia is the nominal one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.sliding.fit import SlidingFit
from bristle.diagnosis.sliding.screen import GROSS_GAIN
from bristle.diagnosis.sliding.stretches import Stretches
from bristle.diagnosis.sliding.torque import Names, driving_input
from bristle.plant.controller import CONTROLLER
from bristle.plant.servo import J

LOOP_FREQUENCIES = (1.0, 3.0, 9.0, 27.0)  # Hz: of the loops from which a controller is fitted
# of every controller: lag [s] of the position that it sees, and how far [rad] its reading is from
# the logged one, which may be rounded otherwise
BESIDE_ALL = {"lag": 1e-3, "offset": 0.0}
START_INTEGRAL = 1.0  # 1/s: integral over proportional action from which it is fitted
START_FORWARD = 0.5  # of the setpoint's rate beside kd, from which it is fitted
START_WEIGHT = 0.8  # of the setpoint beside kp, from which it is fitted
CONTROLLER_KINDS = (  # parts of a controller beside kp; a cascade has ki and weight
    (),
    ("kd",),
    ("ki",),
    ("kd", "ki"),
    ("ki", "weight"),
    ("kd", "ki", "weight"),
)
# quantiles of the torque that is asked for: limits from which it is fitted
LARGE_TORQUES = (0.98, 0.85)
MOST_SLIDING = 2  # kinds of controllers that are simulated

Values = Mapping[str, float]
Slides = Callable[[Model], SlidingFit | None]


@dataclass(frozen=True)
class _Fitted:
    """A controller as the motion that slides shows it: its values, the log-likelihood less the
    price of its parts, and large torques that it asks for.
    """

    own: Values
    total: float
    large: tuple[float, ...]


def controllers(model: Model, slides: Slides) -> list[Model]:
    """Return a model with start values of what is not known of its controller, for the likeliest
    kinds of it, the best first; as it is where its input is no setpoint. None where too little
    slides.

    `slides` fits a model to where the records slide. Damping, integral action and a limit each cost
    `GROSS_GAIN`; a constant torque does not count as integral action.
    """
    known = model.controller
    if known is None or {"kp", "ki", "kd"} <= set(known):
        return [model]
    inertia = model.parameters[J.name]
    starts = [inertia * (2 * math.pi * f) ** 2 for f in LOOP_FREQUENCIES]
    plain = max((_fitted(model, slides, {"kp": kp}) for kp in starts), key=lambda each: each.total)
    if not math.isfinite(plain.total):
        return []
    shifted = replace(model, effects={"bias": {"torque": 0.0}, **model.effects})
    constant = max(_fitted(shifted, slides, plain.own).total - plain.total, 0.0)
    kinds = [plain]
    for more in CONTROLLER_KINDS[1:]:
        if not set(more) & set(known):
            tries = [_fitted(model, slides, _start(model, more, kp)) for kp in starts]
            best = max(tries, key=lambda each: each.total)
            kinds.append(replace(best, total=best.total - constant * ("ki" in more)))
    if "limit" not in known:
        for kind in kinds[:]:
            limits = [_fitted(model, slides, {**kind.own, "limit": x}) for x in kind.large]
            best = max(limits, key=lambda each: each.total)
            # with a limit kp may be farther from its start than one fit may go
            kinds.append(_fitted(model, slides, best.own))
    kinds.sort(key=lambda each: -each.total)
    return [_with(model, {**BESIDE_ALL, **kind.own, **known}) for kind in kinds[:MOST_SLIDING]]


def _start(model: Model, more: Collection[str], kp: float) -> dict[str, float]:
    """Return start values of a controller with these parts, of about this gain."""
    ways = {
        "kd": damping_of(model, math.sqrt(model.parameters[J.name] * kp)),
        "ki": {"ki": START_INTEGRAL * kp, "integral": 0.0},
        "weight": {"weight": START_WEIGHT},
    }
    return {"kp": kp} | {key: x for part in more for key, x in ways[part].items()}


def damping_of(model: Model, kd: float) -> dict[str, float]:
    """Return start values of a damping, which may act on a part of the goal's rate; of all of it
    where that rate is the goal.
    """
    return {"kd": kd} | ({} if model.goal_is_rate else {"forward": START_FORWARD})


def _with(model: Model, own: Values) -> Model:
    return replace(model, effects={**model.effects, CONTROLLER.name: dict(own)})


def _fitted(model: Model, slides: Slides, start: Values) -> _Fitted:
    """Return a model fitted from start values of its controller, those that are known aside."""
    known = model.controller or {}
    own = {**start, **known}
    fit = slides(_with(model, own))
    if fit is None:
        return _Fitted(own, -math.inf, ())
    # torques that nothing measures, in units in which the inertia is the nominal one
    scale = 1.0 if "kp" in known else model.parameters[J.name] / fit.values[J.name]
    found = {}
    for p in CONTROLLER.parameters:
        key = p.name.removeprefix(f"{CONTROLLER.name}.")
        if key in own:
            torque = "N.m" in p.unit and key not in known
            found[key] = fit.values[p.name] * (scale if torque else 1.0)
    large = large_torques(fit.model.effects, fit.values, fit.model.over)
    return _Fitted(found, fit.total - price(own), tuple(scale * x for x in large))


def large_torques(effects: Names, values: Values, over: Stretches) -> list[float]:
    """Return large torques that a controller asks for [N.m]."""
    asked = np.abs(driving_input(effects, values, over))
    return [float(np.quantile(asked, share)) for share in LARGE_TORQUES]


def parts_of(own: Collection[str]) -> frozenset[str]:
    """Return the parts of a controller beside kp."""
    return frozenset(own) & {"kd", "forward", "ki", "weight", "limit"}


def price(own: Collection[str]) -> float:
    """Return what the parts of a controller cost [nats]."""
    return GROSS_GAIN * len(parts_of(own))
