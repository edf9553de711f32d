"""Loss of a gear in proportion to its torque, which differs between driving and being driven."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import BOTH_DIRECTIONS, DRY_FRICTION, Context, Effect, Evidence


def bound(c: Context) -> tuple[ca.SX, ca.SX]:
    """mu_d |T_motor| where the motor drives (T_motor v > 0), mu_b |T_motor| where it is driven.

    Source: duclusaud2024 (load-dependent friction with a direction, here by the motor's torque
    alone).
    """
    size, ahead = ca.fabs(c.torque), c.torque > 0
    driving, driven = c.p.driving * size, c.p.driven * size
    return ca.if_else(ahead, driving, driven), ca.if_else(ahead, driven, driving)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no such friction, and both coefficients by linear regression."""
    torque = e.gain * e.u
    drives = torque * e.v > 0
    friction = -np.abs(torque) * np.sign(e.v)
    driving, driven = e.regress(np.column_stack([friction * drives, friction * ~drives]))[0]
    return [{"driving": 0.0, "driven": 0.0}, {"driving": driving, "driven": driven}]


EFFECT = Effect(
    "gear_loss",
    "dry friction over the transmitted {torque} that differs between driving and being driven",
    "duclusaud2024",
    title="gear loss by power flow",
    group="load_friction/gear_loss",
    equation="mu |T_motor| sgn v, mu = mu_d where T_motor v > 0, else mu_b",
    residual=("u x direction",),
    excitation="varied load, driving and braking",
    needs=(BOTH_DIRECTIONS,),
    confounded=("load_friction", "gain_asymmetry"),
    parameters=(
        Parameter(
            "gear_loss.driving",
            "mu_d",
            "1",
            0.1,
            0.0,
            0.99,
            "friction over transmitted {torque}, driving",
            "duclusaud2024",
        ),
        Parameter(
            "gear_loss.driven",
            "mu_b",
            "1",
            0.05,
            0.0,
            0.99,
            "friction over transmitted {torque}, driven",
            "duclusaud2024",
        ),
    ),
    bound=bound,
    without_truth=DRY_FRICTION,
    separation=(
        "give J a narrow interval, from a drawing or a swing test: where it is free, a loss in one"
        " direction of the power equals one in both, with all other parameters scaled"
    ),
    off={"driving": 0.0, "driven": 0.0},
    starts=starts,
)
