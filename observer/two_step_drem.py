"""Approach II from an encoder alone: least squares for step 1, DREM for step 2."""

from __future__ import annotations

from bristle.observer import drem, kalman, rls, smoothing, zhang
from bristle.observer.drem_position import DREM_BANDWIDTH
from bristle.observer.method import EquationContext, Method, Sample, Update
from bristle.observer.two_step import begun, start_parameter, when


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run both steps; step 2 begins with empty filters.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p
    step1 = rls.estimates(p)
    velocity, filters = smoothing.smooth(p, s)
    step2 = drem.step(p, velocity, step1["alpha2"], step1["b"])
    estimates, signals = drem.published(p, p.smoother0, step1["alpha2"])
    return Update(
        next=rls.fit(p, s) | filters | when(begun(context, s), step2, {name: p[name] for name in step2}),
        estimates=step1 | estimates,
        signals=signals,
        valid={name: begun(context, s) for name in zhang.ESTIMATES},
    )


METHOD = Method(
    "two_step_drem",
    "Approach II from position: least squares, then dynamic regressor extension and mixing on its alpha2 and b",
    "dixit2008 section III, Approach II; aranovskiy2017",
    "y_theta",
    (
        start_parameter("two_step_drem", 20.0),
        kalman.resolution_parameter("two_step_drem"),
        *rls.parameters("two_step_drem"),
        smoothing.parameter("two_step_drem"),
        *drem.parameters("two_step_drem", DREM_BANDWIDTH),
    ),
    (*rls.STATES, *(state for state in smoothing.STATES if state not in rls.STATES), *drem.STATES),
    _equations,
)
