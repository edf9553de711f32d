"""Approach II from an encoder alone: least squares for step 1, DREM for step 2."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from bristle.model.variables import Namespace
from bristle.observer import drem, step2
from bristle.observer.drem_position import DREM_BANDWIDTH
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX


def equations(
    context: EquationContext,
    s: Sample,
    step: Callable[[Namespace, Sample, SX, SX], dict[str, SX]] = drem.step,
) -> Update:
    """Run both steps, the second by this law; it begins with empty filters.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p

    def law(velocity: Sample, alpha2: SX, b: SX) -> step2.Law:
        own = step(p, velocity, alpha2, b)
        return step2.Law(
            own, {name: p[name] for name in own}, *drem.published(p, p.smoother0, alpha2)
        )

    return step2.from_encoder(context, s, law)


METHOD = Method(
    "two_step_drem",
    "Approach II from position: least squares, then dynamic regressor extension and mixing on its"
    " alpha2 and b",
    "dixit2008 section III, Approach II; aranovskiy2017",
    "y_theta",
    (*step2.encoder_parameters("two_step_drem"), *drem.parameters("two_step_drem", DREM_BANDWIDTH)),
    (*step2.ENCODER_STATES, *drem.STATES),
    equations,
)
