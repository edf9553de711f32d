"""Drag that grows with the square of the speed."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence


def torque(c: Context) -> ca.SX:
    """T = -c v |v|.

    Source: white2011 (drag of a body in turbulent flow).
    """
    return ca.SX(-c.p.coefficient * c.v * ca.fabs(c.v))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no drag, and that by linear regression."""
    return [{"coefficient": 0.0}, {"coefficient": e.coefficient(-e.v * np.abs(e.v))}]


EFFECT = Effect(
    "quadratic_drag",
    "drag that grows with the square of the speed",
    "white2011",
    title="quadratic drag",
    group="quadratic_drag",
    equation="T = -c v |v|",
    residual=("v",),
    excitation="a wide range of speeds",
    confounded=("stribeck", "back_emf"),
    parameters=(
        Parameter(
            "quadratic_drag.coefficient",
            "c",
            "N.m.s2/rad2",
            2e-4,
            0.0,
            1e6,
            "{torque} over speed squared",
            "white2011",
        ),
    ),
    torque=torque,
    off={"coefficient": 0.0},
    starts=starts,
)
