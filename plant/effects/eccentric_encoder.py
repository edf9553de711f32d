"""An encoder disc that is not centred on the shaft."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect


def output(c: Context) -> tuple[ca.SX, ca.SX]:
    """y = theta + e sin(theta + phi), y' = v (1 + e cos(theta + phi)).

    Source: ellin2008 (error of a rotary encoder once in a turn).
    """
    angle = c.theta + c.p.phase
    return c.theta + c.p.amplitude * ca.sin(angle), c.v * (1 + c.p.amplitude * ca.cos(angle))


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
)
