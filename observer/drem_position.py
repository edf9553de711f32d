"""DREM for step 2 from position alone; alpha2 and b known."""

from __future__ import annotations

from bristle.observer import drem, kalman, smoothing, step2, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update

DREM_BANDWIDTH = 15.0


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    velocity, states = smoothing.smooth(p, s)
    estimates, signals = drem.published(p, p.smoother0, p.alpha2)
    beside, fields = step2.alone(context, velocity, estimates, step2.from_position(p, s))
    return Update(
        states | drem.step(p, velocity, p.alpha2, p.b) | beside, **fields, signals=signals
    )


METHOD = Method(
    "drem_position",
    "dynamic regressor extension and mixing for step 2 from position; alpha2 and b known",
    drem.CITATION,
    "y_theta",
    (
        *zhang.known_parameters("drem_position"),
        kalman.resolution_parameter("drem_position"),
        smoothing.parameter("drem_position"),
        *drem.parameters("drem_position", DREM_BANDWIDTH),
    ),
    (*smoothing.STATES, *drem.STATES, *step2.COMPANION_STATES),
    _equations,
)
