"""An encoder disc that is not centred on the shaft."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence


def output(c: Context) -> tuple[ca.SX, ca.SX]:
    """y = theta + e sin(theta + phi), y' = v (1 + e cos(theta + phi)).

    Source: ellin2008 (error of a rotary encoder once in a turn).
    """
    angle = c.theta + c.p.phase
    return c.theta + c.p.amplitude * ca.sin(angle), c.v * (1 + c.p.amplitude * ca.cos(angle))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return amplitude and phase from the torque that the apparent acceleration needs."""
    sine = np.cos(e.theta) * e.a - np.sin(e.theta) * e.v**2
    cosine = -np.sin(e.theta) * e.a - np.cos(e.theta) * e.v**2
    s, c = e.regress(e.inertia * np.column_stack([sine, cosine]))[0]
    return [{"amplitude": min(math.hypot(s, c), 0.3), "phase": math.atan2(c, s)}]


EFFECT = Effect(
    "eccentric_encoder",
    "an encoder disc that is not centred on the shaft",
    "ellin2008",
    group="eccentric_encoder",
    equation="y = theta + e sin(theta + phi)",
    residual=("theta", "v"),
    excitation="fast turns: its acceleration grows with the square of the speed",
    confounded=("gravity", "cogging"),
    parameters=(
        Parameter("eccentric_encoder.amplitude", "e", "rad", 0.02, -0.9, 0.9, "largest error of the angle", "ellin2008"),
        Parameter("eccentric_encoder.phase", "phi", "rad", 0.0, -10.0, 10.0, "angle of the disc at theta = 0", "ellin2008"),
    ),
    output=output,
    starts=starts,
)
