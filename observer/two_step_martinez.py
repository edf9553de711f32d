"""Approach II from an encoder alone: least squares for step 1, the switching observer for step 2."""

from __future__ import annotations

from bristle.observer import kalman, martinez_poznyak, rls, smoothing, zhang
from bristle.observer.martinez_poznyak_position import EQUIVALENT_NOISE, MARTINEZ_BANDWIDTH
from bristle.observer.method import EquationContext, Method, Sample, Update
from bristle.observer.two_step import begun, start_parameter, when


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run both steps; step 2 starts from the present velocity.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p
    step1 = rls.estimates(p)
    velocity, filters = smoothing.smooth(p, s)
    step2 = martinez_poznyak.step(p, velocity, step1["alpha2"], step1["b"])
    waiting = {name: p[name] for name in step2} | {"x0": velocity.y1}
    estimates, signals = martinez_poznyak.published(p, step1["alpha2"])
    return Update(
        next=rls.fit(p, s) | filters | when(begun(context, s), step2, waiting),
        estimates=step1 | estimates,
        signals=signals,
        valid={name: begun(context, s) for name in zhang.ESTIMATES},
    )


METHOD = Method(
    "two_step_martinez",
    "Approach II from position: least squares, then the switching observer with least squares on its alpha2 and b",
    "dixit2008 section III, Approach II; martinez2001",
    "y_theta",
    (
        start_parameter("two_step_martinez", 20.0),
        kalman.resolution_parameter("two_step_martinez"),
        *rls.parameters("two_step_martinez"),
        smoothing.parameter("two_step_martinez"),
        *martinez_poznyak.parameters("two_step_martinez", MARTINEZ_BANDWIDTH, EQUIVALENT_NOISE),
    ),
    (*rls.STATES, *(state for state in smoothing.STATES if state not in rls.STATES), *martinez_poznyak.STATES),
    _equations,
)
