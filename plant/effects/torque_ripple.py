"""A gain that repeats along the position: torque ripple of a motor, or of a strain-wave gear."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from bristle.model.variables import declaring
from bristle.plant.effect import Array, Context, Effect, Evidence, Limits, RecordedMotion


def drive(c: Context) -> ca.SX:
    """u (1 + r sin(N theta + phi)).

    Source: tuttle1996 (a strain-wave gear: twice a turn of its wave generator); krishnan2010
    (torque ripple in proportion to the current).
    """
    return ca.SX(c.u * (1 + c.p.share * ca.sin(c.p.periods * c.theta + c.p.phase)))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return the periods that explain most of what is left, in proportion to the input."""

    def columns(periods: float) -> Array:
        angle, torque = periods * e.theta, e.gain * e.u
        return np.column_stack([torque * np.sin(angle), torque * np.cos(angle)])

    return [
        {
            "share": math.hypot(sine, cosine),
            "phase": math.atan2(cosine, sine),
            "periods": periods,
        }
        for periods, (sine, cosine) in e.best(e.waves(1, 60), columns, 2)
    ]


def limits(m: RecordedMotion) -> Limits:
    """At least one period in a turn or, on a linear axis, two in the range travelled."""
    return {"periods": (m.two_periods if m.linear else 1.0, math.inf)}


_own = declaring("torque_ripple", "tuttle1996")
EFFECT = Effect(
    "torque_ripple",
    "a gain of the drive or the gear that repeats along the position",
    "tuttle1996",
    title="{torque} ripple",
    group="torque_ripple",
    equation="u (1 + r sin(N theta + phi))",
    residual=("theta", "u"),
    excitation="varied load over several periods",
    confounded=("cogging", "position_friction", "gain_asymmetry"),
    parameters=(
        _own("share", "r", "1", (0.05, -1.0, 1.0), "largest relative change of the gain"),
        _own("phase", "phi", "rad", (0.0, -10.0, 10.0), "phase of the gain"),
        _own("periods", "N", "1", (2.0, 0.5, 1e4), "{periods}"),
    ),
    drive=drive,
    off={"share": 0.0},
    periods="periods",
    limits=limits,
    starts=starts,
)
