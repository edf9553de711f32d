"""Friction that falls with the temperature, which a column of the records gives."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Variable, declaring
from bristle.plant.effect import DRY_FRICTION, Context, Effect, Evidence

ROOM = 293.15  # K: at which a2 and Fc hold


def warmth(c: Context) -> ca.SX:
    """Return the temperature above that of a room [K]."""
    return ca.SX(c.p.temperature - ROOM)


def torque(c: Context) -> ca.SX:
    """a2 v becomes a2 exp(-c_v (vartheta - 20 degC)) v.

    Source: bittencourt2012 (viscous friction that falls exponentially with temperature).
    """
    return ca.SX(c.p.a2 * (1 - ca.exp(-c.p.viscous_fall * warmth(c))) * c.v)


def factor(c: Context) -> tuple[ca.SX, ca.SX]:
    """Fc exp(-c_d (vartheta - 20 degC)).

    Source: bittencourt2012 (dry friction that varies with temperature, here by the same law).
    """
    value = ca.exp(-c.p.dry_fall * warmth(c))
    return value, value


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return viscous friction that varies, and both."""
    return [{"viscous_fall": 0.0}, {"viscous_fall": 0.0, "dry_fall": 0.0}]


_own = declaring("temperature_friction", "bittencourt2012")
EFFECT = Effect(
    "temperature_friction",
    "friction that falls with the temperature",
    "bittencourt2012",
    title="friction by temperature",
    group="temperature_friction",
    equation="a2 exp(-c_v (vartheta - 20 degC)) v + Fc exp(-c_d (vartheta - 20 degC)) sgn v",
    residual=("v", "t x direction"),
    excitation="a change of some kelvin at equal speeds",
    timing="course",
    confounded=("friction_drift",),
    parameters=(
        _own("viscous_fall", "c_v", "1/K", (0.02, -1.0, 1.0), "relative fall of viscous friction"),
        _own("dry_fall", "c_d", "1/K", (0.0, -1.0, 1.0), "relative fall of dry friction"),
    ),
    second_term=("dry_fall",),
    inputs=(
        Variable("temperature", "K", "temperature of what rubs", ROOM, minimum=0.0, maximum=2000.0),
    ),
    torque=torque,
    factor=factor,
    without_truth=("alpha2", "load", *DRY_FRICTION),
    off={"viscous_fall": 0.0, "dry_fall": 0.0},
    starts=starts,
)
