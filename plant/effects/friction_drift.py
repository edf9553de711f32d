"""Dry friction that changes with time: wear, warming."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence


def factor(c: Context) -> tuple[ca.SX, ca.SX]:
    """Fc max(1 + r t, 0), with t the simulation time.

    Source: armstrong1994 (friction varies with time and temperature; the straight line is its first-order term).
    """
    value = ca.fmax(1 + c.p.rate * c.time, 0)
    return value, value


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no drift: what it does is proportional to it."""
    return [{"rate": 0.0}]


EFFECT = Effect(
    "friction_drift",
    "dry friction that changes with time",
    "armstrong1994",
    group="friction_drift",
    equation="Fc max(1 + r t, 0) sgn v",
    residual=("t x direction",),
    excitation="a long record",
    confounded=("disturbance_step", "position_friction"),
    parameters=(
        Parameter("friction_drift.rate", "r", "1/s", 0.02, -1e3, 1e3, "relative change in a second", "armstrong1994"),
    ),
    factor=factor,
    starts=starts,
)
