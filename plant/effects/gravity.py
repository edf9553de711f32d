"""A mass out of balance."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence


def torque(c: Context) -> ca.SX:
    """T = -A sin(theta + phi).

    Source: spong2006 chapter 7 (single link in the field of gravity).
    """
    return ca.SX(-c.p.amplitude * ca.sin(c.theta + c.p.phase))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return amplitude and phase by linear regression."""
    sine, cosine = -e.regress(np.column_stack([np.sin(e.theta), np.cos(e.theta)]))[0]
    return [{"amplitude": math.hypot(sine, cosine), "phase": math.atan2(cosine, sine)}]


EFFECT = Effect(
    "gravity",
    "a mass out of balance",
    "spong2006",
    group="gravity",
    equation="T = -A sin(theta + phi)",
    residual=("theta",),
    excitation="more than half a turn",
    confounded=("hard_stop", "bias", "eccentric_encoder", "cogging"),
    parameters=(
        Parameter("gravity.amplitude", "A", "N.m", 0.005, -1e6, 1e6, "weight times arm", "spong2006 chapter 7"),
        Parameter("gravity.phase", "phi", "rad", 0.0, -10.0, 10.0, "angle to the lowest point at theta = 0", "spong2006 chapter 7"),
    ),
    load_side=True,
    torque=torque,
    starts=starts,
)
