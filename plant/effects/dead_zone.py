"""A drive that does not answer to small inputs."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect


def command(c: Context) -> ca.SX:
    """u - clip(u, -d, d).

    Source: tao1996 (dead-zone with slope one).
    """
    return c.u - ca.fmin(ca.fmax(c.u, -c.p.width), c.p.width)


EFFECT = Effect(
    "dead_zone",
    "a drive that does not answer to small inputs",
    "tao1996",
    group="dead_zone",
    equation="u - clip(u, -d, d)",
    residual=("u",),
    excitation="reversals with a small input",
    confounded=("stribeck", "asymmetric_coulomb"),
    parameters=(
        Parameter("dead_zone.width", "d", "V", 0.3, 0.0, 1e6, "input on either side that does nothing", "tao1996"),
    ),
    rank=1,
    command=command,
)
