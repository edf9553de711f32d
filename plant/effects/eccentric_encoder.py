"""An encoder disc that is not centred on the shaft."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from bristle.model.variables import declaring
from bristle.plant.effect import Context, Effect, Evidence


def output(c: Context) -> tuple[ca.SX, ca.SX]:
    """y = theta + e (sin(theta + phi) + s2 sin(2 theta) + c2 cos(2 theta)), y' = v dy/dtheta.

    Source: ellin2008 (error of a rotary encoder once in a turn by eccentricity, twice by an oval
    disc).
    """
    angle, twice = c.theta + c.p.phase, 2 * c.theta
    wave = ca.sin(angle) + c.p.sine2 * ca.sin(twice) + c.p.cosine2 * ca.cos(twice)
    slope = ca.cos(angle) + 2 * (c.p.sine2 * ca.cos(twice) - c.p.cosine2 * ca.sin(twice))
    return c.theta + c.p.amplitude * wave, c.v * (1 + c.p.amplitude * slope)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return amplitude and phase from the torque that the apparent acceleration needs."""
    sine = np.cos(e.theta) * e.a - np.sin(e.theta) * e.v**2
    cosine = -np.sin(e.theta) * e.a - np.cos(e.theta) * e.v**2
    s, c = e.regress(e.inertia * np.column_stack([sine, cosine]))[0]
    return [{"amplitude": min(math.hypot(s, c), 0.3), "phase": math.atan2(c, s)}]


_own = declaring("eccentric_encoder", "ellin2008")
EFFECT = Effect(
    "eccentric_encoder",
    "an encoder disc that is not centred on the shaft",
    "ellin2008",
    title="eccentric encoder disc",
    group="eccentric_encoder",
    equation="y = theta + e (sin(theta + phi) + s2 sin(2 theta) + c2 cos(2 theta))",
    residual=("theta", "v"),
    excitation="fast turns: its acceleration grows with the square of the speed",
    confounded=("gravity", "cogging"),
    parameters=(
        _own("amplitude", "e", "rad", (0.02, -0.9, 0.9), "largest error of the angle"),
        _own("phase", "phi", "rad", (0.0, -10.0, 10.0), "angle of the disc at theta = 0"),
        _own("sine2", "s2", "1", (0.0, -0.35, 0.35), "share twice in a turn, sine"),
        _own("cosine2", "c2", "1", (0.0, -0.35, 0.35), "share twice in a turn, cosine"),
    ),
    shape_starts=({"sine2": 0.0, "cosine2": 0.0},),
    output=output,
    off={"amplitude": 0.0},
    once_per_turn=True,
    starts=starts,
)
