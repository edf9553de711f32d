"""Viscous friction that differs between the directions."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import BOTH_DIRECTIONS, Context, Effect, Evidence


def torque(c: Context) -> ca.SX:
    """T = -k |v|: the viscous coefficient is a2 + k forward and a2 - k backward.

    Source: armstrong1994 (friction that depends on the direction).
    """
    return ca.SX(-c.p.coefficient * ca.fabs(c.v))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no asymmetry, and that by linear regression."""
    return [{"coefficient": 0.0}, {"coefficient": e.coefficient(-np.abs(e.v))}]


EFFECT = Effect(
    "asymmetric_viscous",
    "viscous friction that differs between the directions",
    "armstrong1994",
    title="direction-dependent viscous friction",
    group="asymmetric_viscous",
    equation="k |v|",
    residual=("v", "direction"),
    excitation="both directions at varied speed",
    needs=(BOTH_DIRECTIONS,),
    confounded=("asymmetric_coulomb", "gain_asymmetry"),
    parameters=(
        Parameter(
            "asymmetric_viscous.coefficient",
            "k",
            "N.m.s/rad",
            0.0005,
            -1e6,
            1e6,
            "viscous friction beyond a2 forward, lacking backward",
            "armstrong1994",
        ),
    ),
    torque=torque,
    without_truth=("alpha2", "load"),
    off={"coefficient": 0.0},
    starts=starts,
)
