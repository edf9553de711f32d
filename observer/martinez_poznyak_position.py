"""The switching observer with least squares for step 2 from position alone; alpha2 and b known."""

from __future__ import annotations

from bristle.observer import kalman, martinez_poznyak, smoothing, step2, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update

MARTINEZ_BANDWIDTH = 10.0  # 1/s, of the average of nu, which contains the encoder counts
EQUIVALENT_NOISE = 2.0  # rad/s2, of the acceleration


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    velocity, states = smoothing.smooth(p, s)
    step = martinez_poznyak.step(p, velocity, p.alpha2, p.b)
    estimates, signals = martinez_poznyak.published(p, p.alpha2)
    beside, fields = step2.alone(context, velocity, estimates, step2.from_position(p, s))
    return Update(states | step | beside, **fields, signals=signals)


METHOD = Method(
    "martinez_poznyak_position",
    "switching observer with least squares for step 2 from position, after Martinez and Poznyak;"
    " alpha2 and b known",
    martinez_poznyak.CITATION,
    "y_theta",
    (
        *zhang.known_parameters("martinez_poznyak_position"),
        kalman.resolution_parameter("martinez_poznyak_position"),
        smoothing.parameter("martinez_poznyak_position"),
        *martinez_poznyak.parameters(
            "martinez_poznyak_position", MARTINEZ_BANDWIDTH, EQUIVALENT_NOISE
        ),
    ),
    (*smoothing.STATES, *martinez_poznyak.STATES, *step2.COMPANION_STATES),
    _equations,
)
