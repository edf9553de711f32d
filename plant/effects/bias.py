"""Constant torque."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence


def torque(c: Context) -> ca.SX:
    """T = tau0.

    Source: janot2019 (offset of the drive chain).
    """
    return ca.SX(c.p.torque)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no bias, and that by linear regression."""
    return [{"torque": 0.0}, {"torque": e.coefficient(np.ones_like(e.v))}]


EFFECT = Effect(
    "bias",
    "constant {torque}",
    "janot2019",
    title="constant {torque}",
    group="bias/asymmetric_coulomb",
    equation="T = tau0",
    residual=("all",),
    excitation=(
        "any motion; only another level of friction distinguishes it from asymmetric_coulomb"
    ),
    confounded=("asymmetric_coulomb", "gravity", "disturbance_step"),
    parameters=(
        Parameter(
            "bias.torque",
            "tau0",
            "N.m",
            0.001,
            -1e6,
            1e6,
            "constant {torque}, positive forward",
            "janot2019",
        ),
    ),
    torque=torque,
    load=torque,
    off={"torque": 0.0},
    separation=(
        "run it again at another level of friction, warm instead of cold or with another preload: a"
        " constant {torque} stays what it is, an asymmetry grows with the friction (both shift the"
        " break-away alike)"
    ),
    starts=starts,
)
