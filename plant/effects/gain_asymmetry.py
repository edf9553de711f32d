"""A drive whose gain differs between the signs of its input."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import BOTH_DIRECTIONS, BOTH_SIGNS, Context, Effect, Evidence


def drive(c: Context) -> ca.SX:
    """u (1 + g sgn u) = u + g |u|.

    Source: tao1996 (piecewise linear characteristic with two slopes).
    """
    return ca.SX(c.u + c.p.share * ca.fabs(c.u))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no asymmetry, and that by linear regression."""
    return [{"share": 0.0}, {"share": e.coefficient(np.abs(e.gain * e.u))}]


EFFECT = Effect(
    "gain_asymmetry",
    "a gain that differs between the signs of the input",
    "tao1996",
    title="sign-dependent drive gain",
    group="gain_asymmetry",
    equation="u + g |u|",
    residual=("u",),
    excitation="both signs of the input at varied load",
    needs=(BOTH_DIRECTIONS, BOTH_SIGNS),
    confounded=("bias", "gravity", "asymmetric_coulomb"),
    parameters=(
        Parameter(
            "gain_asymmetry.share",
            "g",
            "1",
            0.1,
            -1.0,
            1.0,
            "excess gain for u > 0, lack for u < 0",
            "tao1996",
        ),
    ),
    drive=drive,
    without_truth=("b",),
    off={"share": 0.0},
    starts=starts,
    hardware={"share": (-0.2, 0.2)},
)
