"""A spring that pulls back to a position."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence, Limits, RecordedMotion


def torque(c: Context) -> ca.SX:
    """T = -k (theta - theta0).

    Source: spong2006 chapter 6 (torque of a linear spring).
    """
    return ca.SX(-c.p.stiffness * (c.theta - c.p.rest))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return stiffness and rest position by linear regression."""
    slope, constant = e.regress(np.column_stack([-e.theta, np.ones_like(e.theta)]))[0]
    stiffness = max(float(slope), 0.01 * e.level / max(float(np.ptp(e.theta)), 1e-9))
    return [{"stiffness": stiffness, "rest": float(constant) / stiffness}]


def limits(m: RecordedMotion) -> Limits:
    """Rest at most as far outside the motion as its range: from farther away a spring pulls like a
    bias.
    """
    low, high = float(np.min(m.theta)), float(np.max(m.theta))
    return {"rest": (2 * low - high, 2 * high - low)}


EFFECT = Effect(
    "return_spring",
    "a spring that pulls back to a position",
    "spong2006",
    title="return spring",
    group="gravity/return_spring",
    equation="T = -k (theta - theta0)",
    residual=("theta",),
    excitation="motion over the whole range, in which a spring and gravity differ",
    confounded=("gravity", "hard_stop", "bias"),
    parameters=(
        Parameter(
            "return_spring.stiffness",
            "k",
            "N.m/rad",
            0.02,
            0.0,
            1e9,
            "stiffness",
            "spong2006 chapter 6",
        ),
        Parameter(
            "return_spring.rest",
            "theta0",
            "rad",
            0.0,
            -1e6,
            1e6,
            "position at which it does not pull",
            "spong2006 chapter 6",
        ),
    ),
    load_side=True,
    torque=torque,
    without_truth=("load",),
    off={"stiffness": 0.0},
    separation=(
        "move it by more than half a turn: a spring pulls the harder the farther it is moved, a"
        " weight most where its arm is level"
    ),
    limits=limits,
    starts=starts,
)
