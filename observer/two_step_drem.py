"""Approach II from an encoder alone: least squares for step 1, DREM for step 2."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from bristle.model.variables import Namespace
from bristle.observer import drem, kalman, rls, smoothing, step2
from bristle.observer.drem_position import DREM_BANDWIDTH
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX


def equations(
    context: EquationContext, s: Sample, step: Callable[[Namespace, Sample, SX, SX], dict[str, SX]] = drem.step
) -> Update:
    """Run both steps, the second by this law; it begins with empty filters.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p
    step1_fields = rls.published(p, s.period)
    alpha2, b = (step1_fields["estimates"][name] for name in ("alpha2", "b"))
    velocity, filters = smoothing.smooth(p, s)
    own = step(p, velocity, alpha2, b)
    estimates, signals = drem.published(p, p.smoother0, alpha2)
    go = step2.begun(p, s, step1_fields)
    given = step2.from_position(p, s)
    beside = step2.observe(context, velocity, step2.known(step1_fields), given)
    return Update(
        next=rls.fit(p, s) | filters | beside | step2.when(go, own, {name: p[name] for name in own}),
        **step2.published(p, step1_fields, estimates, given),
        signals=signals,
    )


METHOD = Method(
    "two_step_drem",
    "Approach II from position: least squares, then dynamic regressor extension and mixing on its alpha2 and b",
    "dixit2008 section III, Approach II; aranovskiy2017",
    "y_theta",
    (
        step2.start_parameter("two_step_drem"),
        kalman.resolution_parameter("two_step_drem"),
        *rls.parameters("two_step_drem"),
        smoothing.parameter("two_step_drem"),
        *drem.parameters("two_step_drem", DREM_BANDWIDTH),
    ),
    (*rls.STATES, *(state for state in smoothing.STATES if state not in rls.STATES), *step2.STATES, *drem.STATES),
    equations,
)
