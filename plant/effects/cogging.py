"""Torque that repeats from pole to pole."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from bristle.model.variables import declaring
from bristle.plant.effect import Array, Context, Effect, Evidence, Limits, RecordedMotion


def torque(c: Context) -> ca.SX:
    """T = A1 (sin(N theta + phi1) + s3 sin(3 N theta) + c3 cos(3 N theta) + s4 ... + c4 ...) + A2
    sin(2 N theta + phi2).

    Source: krishnan2010 (cogging torque, first four terms of its Fourier series).
    """
    angle = c.p.periods * c.theta
    wave = ca.sin(angle + c.p.phase)
    for n, (sine, cosine) in {3: (c.p.sine3, c.p.cosine3), 4: (c.p.sine4, c.p.cosine4)}.items():
        wave += sine * ca.sin(n * angle) + cosine * ca.cos(n * angle)
    return ca.SX(c.p.amplitude * wave + c.p.amplitude2 * ca.sin(2 * angle + c.p.phase2))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return the periods that explain most of what is left, with one and with two terms."""

    def columns(periods: float) -> Array:
        return np.column_stack([np.sin(periods * e.theta), np.cos(periods * e.theta)])

    starts: list[dict[str, float]] = []
    for periods, (sine, cosine) in e.best(e.waves(2, 60), columns, 2):
        one = {
            "amplitude": math.hypot(sine, cosine),
            "phase": math.atan2(cosine, sine),
            "periods": periods,
        }
        sine, cosine = e.regress(columns(2 * periods))[0]
        starts += [
            one,
            one | {"amplitude2": math.hypot(sine, cosine), "phase2": math.atan2(cosine, sine)},
        ]
    return starts


def limits(m: RecordedMotion) -> Limits:
    """At least two periods in a turn or, on a linear axis, in the range travelled: fewer are a slow
    change, no ripple.
    """
    return {"periods": (m.two_periods, math.inf)}


_own = declaring("cogging", "krishnan2010")
EFFECT = Effect(
    "cogging",
    "{torque} that repeats from pole to pole",
    "krishnan2010",
    title="cogging {torque}",
    group="cogging",
    equation="T = A1 (sin(N theta + phi1) + ... + c4 cos(4 N theta)) + A2 sin(2 N theta + phi2)",
    residual=("theta",),
    excitation="a slow pass over many periods",
    confounded=("position_friction", "gravity", "eccentric_encoder"),
    parameters=(
        _own("amplitude", "A1", "N.m", (0.001, -1e6, 1e6), "amplitude of the first term"),
        _own("phase", "phi1", "rad", (0.0, -10.0, 10.0), "phase of the first term"),
        _own("periods", "N", "1", (7.0, 1.0, 1e4), "{periods}"),
        _own("amplitude2", "A2", "N.m", (0.0, -1e6, 1e6), "amplitude of the second term"),
        _own("phase2", "phi2", "rad", (0.0, -10.0, 10.0), "phase of the second term"),
        _own("sine3", "s3", "1", (0.0, -2.0, 2.0), "share of the third term, sine"),
        _own("cosine3", "c3", "1", (0.0, -2.0, 2.0), "share of the third term, cosine"),
        _own("sine4", "s4", "1", (0.0, -2.0, 2.0), "share of the fourth term, sine"),
        _own("cosine4", "c4", "1", (0.0, -2.0, 2.0), "share of the fourth term, cosine"),
    ),
    second_term=("amplitude2", "phase2"),
    shape_starts=({"sine3": 0.0, "cosine3": 0.0, "sine4": 0.0, "cosine4": 0.0},),
    torque=torque,
    without_truth=("load",),
    off={"amplitude": 0.0},
    periods="periods",
    limits=limits,
    starts=starts,
)
