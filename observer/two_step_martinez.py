"""Approach II from an encoder alone: least squares in step 1, a switching observer in step 2."""

from __future__ import annotations

import casadi as ca

from bristle.observer import martinez_poznyak, step2
from bristle.observer.martinez_poznyak_position import EQUIVALENT_NOISE, MARTINEZ_BANDWIDTH
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run both steps; step 2 starts from the present velocity.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p

    def law(velocity: Sample, alpha2: SX, b: SX) -> step2.Law:
        own = martinez_poznyak.step(p, velocity, alpha2, b)
        waiting = {name: p[name] for name in own} | {"x0": velocity.y1}
        return step2.Law(own, waiting, *martinez_poznyak.published(p, alpha2))

    return step2.from_encoder(context, s, law)


METHOD = Method(
    "two_step_martinez",
    "Approach II from position: least squares, then the switching observer with least squares on"
    " its alpha2 and b",
    "dixit2008 section III, Approach II; martinez2001",
    "y_theta",
    (
        *step2.encoder_parameters("two_step_martinez"),
        *martinez_poznyak.parameters("two_step_martinez", MARTINEZ_BANDWIDTH, EQUIVALENT_NOISE),
    ),
    (*step2.ENCODER_STATES, *martinez_poznyak.STATES),
    _equations,
)
