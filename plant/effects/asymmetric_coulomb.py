"""Dry friction that differs between the directions."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import BOTH_DIRECTIONS, DRY_FRICTION, Context, Effect, Evidence


def factor(c: Context) -> tuple[ca.SX, ca.SX]:
    """Fc (1 + alpha sgn v).

    Source: armstrong1994 (friction that depends on the direction).
    """
    return 1 + c.p.share, 1 - c.p.share


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no asymmetry, and that by linear regression."""
    return [{"share": 0.0}, {"share": e.coefficient(-e.level * np.abs(np.sign(e.v)))}]


EFFECT = Effect(
    "asymmetric_coulomb",
    "dry friction that differs between the directions",
    "armstrong1994",
    title="direction-dependent dry friction",
    group="bias/asymmetric_coulomb",
    equation="Fc (1 + alpha sgn v)",
    residual=("direction",),
    excitation="both directions, at two levels of friction: at one of them it equals a bias",
    needs=(BOTH_DIRECTIONS,),
    confounded=("bias",),
    parameters=(
        Parameter(
            "asymmetric_coulomb.share",
            "alpha",
            "1",
            0.2,
            -1.0,
            1.0,
            "excess forward, lack backward",
            "armstrong1994",
        ),
    ),
    factor=factor,
    without_truth=(*DRY_FRICTION, "load"),
    off={"share": 0.0},
    starts=starts,
)
