"""The paper's heuristic for the gate of step 1: the lowest speed at which steps of the input end in
uniform motion.

It proposes vc, and estimates nothing else.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import State, declaring
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX
CITATION = "dixit2008 section IV-B"


def _equations(context: EquationContext, s: Sample) -> Update:
    """Evaluate a step of the input when it ends: it counts if it is long enough, moving, and of
    nearly constant velocity.

    Mean and mean square of the velocity are first-order averages, so that they belong to the end of
    the step; they end with the velocity at which the input was left. Source: dixit2008 section
    IV-B.
    """
    p = context.p
    weight = 1 - ca.exp(-s.period / p.window)
    left = s.u != p.held_input
    spread = ca.sqrt(ca.fmax(p.square - p.mean**2, 0))
    speed = ca.fabs(p.mean)
    uniform = ca.logic_and(speed > p.least_speed, spread < p.tolerance * speed)
    judged = ca.logic_and(ca.logic_and(left, uniform), p.held >= p.patience)
    lower = ca.logic_or(p.found == 0, speed < p.found)
    return Update(
        next={
            "held_input": s.u,
            "held": ca.if_else(left, 0, p.held + s.period),
            "mean": ca.if_else(left, s.y0, p.mean + weight * (s.y0 - p.mean)),
            "square": ca.if_else(left, s.y0**2, p.square + weight * (s.y0**2 - p.square)),
            "found": ca.if_else(ca.logic_and(judged, lower), speed, p.found),
        },
        estimates={"vc": p.found},
        signals={"v": p.mean},
        valid={"vc": SX(p.found > 0)},
        adapted=SX(p.found > 0),
    )


_own = declaring("uniform_motion", CITATION)
METHOD = Method(
    "uniform_motion",
    "proposes the gate vc: the lowest speed at which steps of the input end in uniform motion",
    CITATION,
    "y_v",
    (
        _own("window", "T_w", "s", (0.3, 1e-3, 1e3), "over which the velocity is averaged"),
        _own("patience", "T_s", "s", (3.0, 0.0, 1e6), "shortest step of the input that counts"),
        _own("tolerance", "epsilon", "1", (0.05, 0.0, 1.0), "spread over mean of uniform motion"),
        _own("least_speed", "v_0", "rad/s", (0.05, 0.0, 1e3), "speed below which it rests"),
    ),
    (
        State("held_input", "V", "input of the step"),
        State("held", "s", "how long it has been held"),
        State("mean", "rad/s", "average velocity"),
        State("square", "rad2/s2", "average of its square"),
        State("found", "rad/s", "lowest speed of uniform motion so far, 0: none"),
    ),
    _equations,
)
