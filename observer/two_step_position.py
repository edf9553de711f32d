"""Approach II from an encoder alone: least squares for step 1, the third-order observer for step 2."""

from __future__ import annotations

from bristle.observer import besancon_position, kalman, rls, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update
from bristle.observer.two_step import begun, start_parameter, waiting, when


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run both steps; step 2 starts from the last velocity of step 1.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p
    go = begun(context, s)
    step1 = rls.estimates(p)
    step2 = besancon_position.step(context, s, step1["alpha2"], step1["b"])
    held = waiting(context, s.y1, order=3) | {"x1": p.last_v}
    estimates, signals = besancon_position.published(p, step1["alpha2"])
    return Update(
        next=rls.fit(p, s) | when(go, step2, held),
        estimates=step1 | estimates,
        signals=signals,
        first={"x0": s.y1},
        valid={name: begun(context, s) for name in zhang.ESTIMATES},
    )


METHOD = Method(
    "two_step_position",
    "Approach II from position: least squares, then Besancon-Zhang-Hammouri with n = 3 on its alpha2 and b",
    "dixit2008 section III, Approach II",
    "y_theta",
    (
        start_parameter("two_step_position", 20.0),
        kalman.resolution_parameter("two_step_position"),
        *rls.parameters("two_step_position"),
        *besancon_position.parameters("two_step_position"),
    ),
    (*rls.STATES, *zhang.states(3)),
    _equations,
)
