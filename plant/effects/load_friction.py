"""Dry friction that grows with the torque a gear transmits."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import BOTH_DIRECTIONS, DRY_FRICTION, Context, Effect, Evidence


def bound(c: Context) -> tuple[ca.SX, ca.SX]:
    """mu |T_motor|, against either direction.

    Source: duclusaud2024 (load-dependent friction, here by the motor's torque alone).
    """
    friction = ca.SX(c.p.coefficient * ca.fabs(c.torque))
    return friction, friction


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no such friction, and that by linear regression."""
    return [
        {"coefficient": 0.0},
        {"coefficient": e.coefficient(-np.abs(e.gain * e.u) * np.sign(e.v))},
    ]


EFFECT = Effect(
    "load_friction",
    "dry friction that grows with the transmitted {torque}",
    "duclusaud2024",
    title="load-dependent dry friction",
    group="load_friction/gear_loss",
    equation="mu |T_motor| sgn v",
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
    ),
    bound=bound,
    without_truth=DRY_FRICTION,
    off={"coefficient": 0.0},
    starts=starts,
)
