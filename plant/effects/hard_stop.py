"""Elastic stops at the ends of the range."""

from __future__ import annotations

import math
from functools import partial

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter, declaring
from bristle.plant.effect import Context, Effect, Evidence, Limits, RecordedMotion, power

STOP_DEPTH = 0.1  # rad: where the torque does not depend on the exponent


def torque(c: Context) -> ca.SX:
    """T = k e (e/e0)^(n-1) below the lower stop, minus that above the upper one; e how deep.

    Source: acary2008 (unilateral contact with a spring in place of the constraint), hunt1975 (a
    power of the depth).
    """
    press = ca.fmax(c.p.lower - c.theta, 0) - ca.fmax(c.theta - c.p.upper, 0)
    return ca.SX(c.p.stiffness * press * power(press / STOP_DEPTH, c.p.exponent - 1))


SHARES = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)  # of the time that a stop may be reached


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return stops on either side that explain most of what is left, and one each that is reached
    often, and hardly ever.
    """
    starts: list[dict[str, float]] = []
    for name, side in (("upper", 1.0), ("lower", -1.0)):
        edges = [float(np.quantile(side * e.theta, 1 - share)) for share in SHARES]
        found = e.best(edges, partial(_press, e, side), len(edges))
        for edge, (stiffness,) in (
            each for i, each in enumerate(found) if i < 2 or each[0] in (edges[0], edges[-2])
        ):
            depth = max(float(np.max(side * e.theta)) - edge, 1e-9)
            starts.append(
                {"stiffness": max(float(stiffness), 0.1 * e.level / depth), name: side * edge}
            )
    return starts


def _press(e: Evidence, side: float, edge: float) -> np.ndarray:
    """Return the torque (n, 1) of a stop of stiffness 1 on one side."""
    return -side * np.maximum(side * e.theta - edge, 0.0)[:, None]


def limits(m: RecordedMotion) -> Limits:
    """Stops touched less than half of the time: others are a spring or a bias."""
    middle = float(np.median(m.theta))
    return {"upper": (middle, math.inf), "lower": (-math.inf, middle)}


_own = declaring("hard_stop", "acary2008")
EFFECT = Effect(
    "hard_stop",
    "elastic stops at the ends of the range",
    "acary2008",
    title="hard stop of the range",
    group="hard_stop",
    equation=(
        "T = k e (|e|/e0)^(n-1), e = max(lower - theta, 0) - max(theta - upper, 0), e0 = 0.1 rad"
    ),
    residual=("theta",),
    sparse=True,
    excitation="motion that reaches the stop",
    confounded=("gravity", "return_spring"),
    parameters=(
        _own("stiffness", "k", "N.m/rad", (0.5, 0.0, 1e9), "stiffness of the stops"),
        _own("upper", "upper", "rad", (1.0, -1e6, 1e6), "where the upper stop begins"),
        _own("lower", "lower", "rad", (-1e6, -1e6, 1e6), "where the lower stop begins"),
        Parameter(
            "hard_stop.exponent",
            "n",
            "1",
            1.0,
            1.0,
            4.0,
            "of the {torque} over the depth",
            "hunt1975",
        ),
    ),
    shape_starts=({"exponent": 1.0}, {"exponent": 2.0}),
    load_side=True,
    torque=torque,
    without_truth=("load",),
    off={"stiffness": 0.0},
    unused={"upper": 1e6, "lower": -1e6},
    limits=limits,
    starts=starts,
)
