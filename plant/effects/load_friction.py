"""Dry friction that grows with the torque a gear transmits."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import (
    BOTH_DIRECTIONS,
    DRY_FRICTION,
    Context,
    Effect,
    Evidence,
    Limits,
    RecordedMotion,
)


def bound(c: Context) -> tuple[ca.SX, ca.SX]:
    """(mu + mu_s exp(-(v/vs)^2)) |T_motor|, against either direction.

    Source: duclusaud2024 (load-dependent friction with a Stribeck curve, here by the motor's torque
    alone and with the exponent 2).
    """
    falling = c.p.falling * ca.exp(-((c.v / c.p.speed) ** 2))
    friction = ca.SX((c.p.coefficient + falling) * ca.fabs(c.torque))
    return friction, friction


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no such friction, and that by linear regression."""
    return [
        {"coefficient": 0.0},
        {"coefficient": e.coefficient(-np.abs(e.gain * e.u) * np.sign(e.v))},
    ]


def limits(m: RecordedMotion) -> Limits:
    """What falls has fallen well within the speeds that are seen."""
    return {"speed": m.slow}


EFFECT = Effect(
    "load_friction",
    "dry friction that grows with the transmitted {torque}",
    "duclusaud2024",
    title="load-dependent dry friction",
    group="load_friction/gear_loss",
    equation="(mu + mu_s exp(-(v/vs)^2)) |T_motor| sgn v",
    residual=("u x direction",),
    excitation="varied load at equal speed",
    needs=(BOTH_DIRECTIONS,),
    confounded=("gear_loss", "gain_asymmetry", "back_emf"),
    parameters=(
        Parameter(
            "load_friction.coefficient",
            "mu",
            "1",
            0.1,
            0.0,
            0.99,
            "friction over transmitted {torque}",
            "duclusaud2024",
        ),
        Parameter(
            "load_friction.falling",
            "mu_s",
            "1",
            0.0,
            0.0,
            0.99,
            "what of it is there at low speed alone",
            "duclusaud2024",
        ),
        Parameter(
            "load_friction.speed",
            "vs",
            "rad/s",
            0.3,
            1e-6,
            1e6,
            "speed at which that falls",
            "duclusaud2024",
        ),
    ),
    shape_starts=({"falling": 0.05, "speed": 0.05}, {"falling": 0.05, "speed": 0.5}),
    bound=bound,
    without_truth=DRY_FRICTION,
    off={"coefficient": 0.0},
    limits=limits,
    starts=starts,
)
