"""A mass out of balance."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from bristle.model.variables import declaring
from bristle.plant.effect import Context, Effect, Evidence


def torque(c: Context) -> ca.SX:
    """T = -A (sin(theta + phi) + s2 sin(2 theta) + c2 cos(2 theta)).

    Source: spong2006 chapter 7 (single link in the field of gravity; behind a linkage the torque
    has further terms).
    """
    twice = 2 * c.theta
    wave = ca.sin(c.theta + c.p.phase) + c.p.sine2 * ca.sin(twice) + c.p.cosine2 * ca.cos(twice)
    return ca.SX(-c.p.amplitude * wave)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return amplitude and phase by linear regression."""
    sine, cosine = -e.regress(np.column_stack([np.sin(e.theta), np.cos(e.theta)]))[0]
    return [{"amplitude": math.hypot(sine, cosine), "phase": math.atan2(cosine, sine)}]


_own = declaring("gravity", "spong2006 chapter 7")
EFFECT = Effect(
    "gravity",
    "a mass out of balance",
    "spong2006",
    title="gravity on an unbalanced mass",
    group="gravity/return_spring",
    equation="T = -A (sin(theta + phi) + s2 sin(2 theta) + c2 cos(2 theta))",
    residual=("theta",),
    excitation="more than half a turn",
    confounded=("return_spring", "hard_stop", "bias", "eccentric_encoder", "cogging"),
    parameters=(
        _own("amplitude", "A", "N.m", (0.005, -1e6, 1e6), "weight times arm"),
        _own("phase", "phi", "rad", (0.0, -10.0, 10.0), "angle to the lowest point at theta = 0"),
        _own("sine2", "s2", "1", (0.0, -0.35, 0.35), "share twice in a turn, sine"),
        _own("cosine2", "c2", "1", (0.0, -0.35, 0.35), "share twice in a turn, cosine"),
    ),
    shape_starts=({"sine2": 0.0, "cosine2": 0.0},),
    load_side=True,
    torque=torque,
    without_truth=("load",),
    off={"amplitude": 0.0},
    once_per_turn=True,
    starts=starts,
)
