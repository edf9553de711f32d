"""Elastic stops at the ends of the range."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence


def torque(c: Context) -> ca.SX:
    """T = -k max(theta - upper, 0) + k max(lower - theta, 0).

    Source: acary2008 (unilateral contact with a spring in place of the constraint).
    """
    return ca.SX(c.p.stiffness * (ca.fmax(c.p.lower - c.theta, 0) - ca.fmax(c.theta - c.p.upper, 0)))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return stops that are reached often, now and then, or once, on either side."""
    starts: list[dict[str, float]] = []
    for share in (0.1, 0.02, 0.004):  # of the time
        for name, side in (("upper", 1.0), ("lower", -1.0)):
            edge = float(np.quantile(side * e.theta, 1 - share))
            inside = np.maximum(side * e.theta - edge, 0.0)
            stiffness = float(e.regress(-side * inside[:, None])[0][0])
            starts.append({"stiffness": max(stiffness, 0.1 * e.level / max(float(inside.max()), 1e-9)), name: side * edge})
    return starts


EFFECT = Effect(
    "hard_stop",
    "elastic stops at the ends of the range",
    "acary2008",
    group="hard_stop",
    equation="T = -k max(theta - upper, 0) + k max(lower - theta, 0)",
    residual=("theta",),
    local=True,
    excitation="motion that reaches the stop",
    confounded=("gravity",),
    parameters=(
        Parameter("hard_stop.stiffness", "k", "N.m/rad", 0.5, 0.0, 1e9, "stiffness of the stops", "acary2008"),
        Parameter("hard_stop.upper", "upper", "rad", 1.0, -1e6, 1e6, "where the upper stop begins", "acary2008"),
        Parameter("hard_stop.lower", "lower", "rad", -1e6, -1e6, 1e6, "where the lower stop begins", "acary2008"),
    ),
    load_side=True,
    torque=torque,
    starts=starts,
)
