"""Approach II from an encoder alone: least squares in step 1, a third-order observer in step 2."""

from __future__ import annotations

import casadi as ca

from bristle.observer import besancon_position, step2, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update
from bristle.observer.two_step import waiting

SX = ca.SX


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run both steps; step 2 starts from the last velocity of step 1.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p

    def law(_: Sample, alpha2: SX, b: SX) -> step2.Law:
        own = besancon_position.step(context, s, alpha2, b)  # which reads the position itself
        held = waiting(context, s.y1, order=3) | {"x1": p.last_v}
        return step2.Law(own, held, *besancon_position.published(p, alpha2), first={"x0": s.y1})

    return step2.from_encoder(context, s, law)


METHOD = Method(
    "two_step_position",
    "Approach II from position: least squares, then Besancon-Zhang-Hammouri with n = 3 on its"
    " alpha2 and b",
    "dixit2008 section III, Approach II",
    "y_theta",
    (
        *step2.encoder_parameters("two_step_position"),
        *besancon_position.parameters("two_step_position"),
    ),
    (*step2.ENCODER_STATES, *zhang.states(3)),
    _equations,
)
