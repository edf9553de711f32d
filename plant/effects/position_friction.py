"""Dry friction that depends on the position."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect


def factor(c: Context) -> tuple[ca.SX, ca.SX]:
    """Fc (1 + A sin(N theta + phi)).

    Source: armstrong1994 (position-dependent friction).
    """
    value = 1 + c.p.amplitude * ca.sin(c.p.periods * c.theta + c.p.phase)
    return value, value


EFFECT = Effect(
    "position_friction",
    "dry friction that depends on the position",
    "armstrong1994",
    group="position_friction",
    equation="Fc (1 + A sin(N theta + phi)) sgn v",
    residual=("theta x direction",),
    excitation="many turns in both directions",
    confounded=("cogging", "load_friction", "friction_drift"),
    parameters=(
        Parameter("position_friction.amplitude", "A", "1", 0.4, -1.0, 1.0, "share of the friction that varies", "armstrong1994"),
        Parameter("position_friction.periods", "N", "1", 1.0, 1.0, 1e4, "periods in a turn", "armstrong1994"),
        Parameter("position_friction.phase", "phi", "rad", 0.0, -10.0, 10.0, "phase", "armstrong1994"),
    ),
    factor=factor,
)
