"""Dry friction that depends on the position."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from bristle.model.variables import declaring
from bristle.plant.effect import (
    BOTH_DIRECTIONS,
    DRY_FRICTION,
    Array,
    Context,
    Effect,
    Evidence,
    Limits,
    RecordedMotion,
)


def factor(c: Context) -> tuple[ca.SX, ca.SX]:
    """Fc max(1 + A (sin(N theta + phi) + s2 sin(2 N theta) + c2 cos(2 N theta)), 0): friction never
    drives.

    Source: armstrong1994 (position-dependent friction; first two terms of its Fourier series).
    """
    angle = c.p.periods * c.theta
    twice = c.p.sine2 * ca.sin(2 * angle) + c.p.cosine2 * ca.cos(2 * angle)
    value = ca.fmax(1 + c.p.amplitude * (ca.sin(angle + c.p.phase) + twice), 0)
    return value, value


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return the periods that explain most of what is left."""

    def columns(periods: float) -> Array:
        against = -e.level * np.sign(e.v)
        return np.column_stack(
            [against * np.sin(periods * e.theta), against * np.cos(periods * e.theta)]
        )

    return [
        {"amplitude": min(math.hypot(s, c), 0.9), "phase": math.atan2(c, s), "periods": periods}
        for periods, (s, c) in e.best(e.waves(1, 60), columns, 2)
    ]


def limits(m: RecordedMotion) -> Limits:
    """On a linear axis at least two periods in the range travelled; once in a turn has a cause in a
    shaft.
    """
    return {"periods": (m.two_periods, math.inf)} if m.linear else {}


_own = declaring("position_friction", "armstrong1994")
EFFECT = Effect(
    "position_friction",
    "dry friction that depends on the position",
    "armstrong1994",
    title="position-dependent dry friction",
    group="position_friction",
    equation="Fc max(1 + A (sin(N theta + phi) + s2 sin(2 N theta) + c2 cos(2 N theta)), 0) sgn v",
    residual=("theta x direction",),
    excitation="many turns in both directions",
    needs=(BOTH_DIRECTIONS,),
    confounded=("cogging", "load_friction", "friction_drift"),
    parameters=(
        _own("amplitude", "A", "1", (0.4, -1.0, 1.0), "share of the friction that varies"),
        _own("periods", "N", "1", (1.0, 1.0, 1e4), "{periods}"),
        _own("phase", "phi", "rad", (0.0, -10.0, 10.0), "phase"),
        _own("sine2", "s2", "1", (0.0, -0.35, 0.35), "share of a second term, sine"),
        _own("cosine2", "c2", "1", (0.0, -0.35, 0.35), "share of a second term, cosine"),
    ),
    shape_starts=({"sine2": 0.0, "cosine2": 0.0},),
    factor=factor,
    without_truth=DRY_FRICTION,
    off={"amplitude": 0.0},
    periods="periods",
    limits=limits,
    starts=starts,
)
