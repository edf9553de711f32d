"""Approach II from an encoder alone: least squares for step 1, the switching observer for step 2."""

from __future__ import annotations

from bristle.observer import kalman, martinez_poznyak, rls, smoothing, step2
from bristle.observer.martinez_poznyak_position import EQUIVALENT_NOISE, MARTINEZ_BANDWIDTH
from bristle.observer.method import EquationContext, Method, Sample, Update


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run both steps; step 2 starts from the present velocity.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p
    step1_fields = rls.published(p, s.period)
    alpha2, b = (step1_fields["estimates"][name] for name in ("alpha2", "b"))
    velocity, filters = smoothing.smooth(p, s)
    own = martinez_poznyak.step(p, velocity, alpha2, b)
    waiting = {name: p[name] for name in own} | {"x0": velocity.y1}
    estimates, signals = martinez_poznyak.published(p, alpha2)
    go = step2.begun(p, s, step1_fields)
    given = step2.from_position(p, s)
    beside = step2.observe(context, velocity, step2.known(step1_fields), given)
    return Update(
        next=rls.fit(p, s) | filters | beside | step2.when(go, own, waiting),
        **step2.published(p, step1_fields, estimates, given),
        signals=signals,
    )


METHOD = Method(
    "two_step_martinez",
    "Approach II from position: least squares, then the switching observer with least squares on its alpha2 and b",
    "dixit2008 section III, Approach II; martinez2001",
    "y_theta",
    (
        step2.start_parameter("two_step_martinez"),
        kalman.resolution_parameter("two_step_martinez"),
        *rls.parameters("two_step_martinez"),
        smoothing.parameter("two_step_martinez"),
        *martinez_poznyak.parameters("two_step_martinez", MARTINEZ_BANDWIDTH, EQUIVALENT_NOISE),
    ),
    (*rls.STATES, *(state for state in smoothing.STATES if state not in rls.STATES), *step2.STATES, *martinez_poznyak.STATES),
    _equations,
)
