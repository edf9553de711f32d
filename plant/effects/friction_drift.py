"""Dry friction that changes with time: wear, warming."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import BOTH_DIRECTIONS, DRY_FRICTION, Context, Effect, Evidence

SMALL = 1e-4  # of the settling: where three terms of its series are exact


def factor(c: Context) -> tuple[ca.SX, ca.SX]:
    """Fc max(1 + r (1 - exp(-s t))/s, 0), with t the simulation time; a straight line for s = 0.

    Source: armstrong1994 (friction varies with time and temperature; a first-order lag of what it
    settles to).
    """
    x = c.p.settling * c.time
    straight = ca.fabs(x) < SMALL
    lag = ca.if_else(straight, 1 - x / 2 + x * x / 6, (1 - ca.exp(-x)) / ca.if_else(straight, 1, x))
    value = ca.fmax(1 + c.p.rate * c.time * lag, 0)
    return value, value


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no drift, and that by linear regression."""
    return [{"rate": 0.0}, {"rate": e.coefficient(-e.level * np.sign(e.v) * e.time)}]


EFFECT = Effect(
    "friction_drift",
    "dry friction that changes with time",
    "armstrong1994",
    title="drift of the friction",
    group="friction_drift",
    equation="Fc max(1 + r (1 - exp(-s t))/s, 0) sgn v",
    residual=("t x direction",),
    excitation="a long record",
    needs=(BOTH_DIRECTIONS,),
    timing="course",
    confounded=("disturbance_step", "position_friction"),
    parameters=(
        Parameter(
            "friction_drift.rate",
            "r",
            "1/s",
            0.02,
            -1e3,
            1e3,
            "relative change in a second, at first",
            "armstrong1994",
        ),
        Parameter(
            "friction_drift.settling",
            "s",
            "1/s",
            0.0,
            0.0,
            10.0,
            "how fast the change comes to its end",
            "armstrong1994",
        ),
    ),
    shape_starts=({"settling": 0.0},),
    factor=factor,
    without_truth=DRY_FRICTION,
    off={"rate": 0.0},
    starts=starts,
)
