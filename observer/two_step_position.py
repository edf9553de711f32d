"""Approach II from an encoder alone: least squares for step 1, the third-order observer for step 2."""

from __future__ import annotations

from bristle.observer import besancon_position, kalman, rls, smoothing, step2, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update
from bristle.observer.two_step import waiting


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run both steps; step 2 starts from the last velocity of step 1.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p
    step1_fields = rls.published(p, s.period)
    alpha2, b = (step1_fields["estimates"][name] for name in ("alpha2", "b"))
    go = step2.begun(p, s, step1_fields)
    velocity, filters = smoothing.smooth(p, s)
    own = besancon_position.step(context, s, alpha2, b)
    held = waiting(context, s.y1, order=3) | {"x1": p.last_v}
    estimates, signals = besancon_position.published(p, alpha2)
    given = step2.from_position(p, s)
    beside = step2.observe(context, velocity, step2.known(step1_fields), given)
    return Update(
        next=rls.fit(p, s) | filters | beside | step2.when(go, own, held),
        **step2.published(p, step1_fields, estimates, given),
        signals=signals,
        first={"x0": s.y1},
    )


METHOD = Method(
    "two_step_position",
    "Approach II from position: least squares, then Besancon-Zhang-Hammouri with n = 3 on its alpha2 and b",
    "dixit2008 section III, Approach II",
    "y_theta",
    (
        step2.start_parameter("two_step_position"),
        kalman.resolution_parameter("two_step_position"),
        *rls.parameters("two_step_position"),
        smoothing.parameter("two_step_position"),
        *besancon_position.parameters("two_step_position"),
    ),
    (*rls.STATES, *(state for state in smoothing.STATES if state not in rls.STATES), *step2.STATES, *zhang.states(3)),
    _equations,
)
