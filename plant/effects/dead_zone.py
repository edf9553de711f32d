"""A drive that does not answer to small inputs."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence


def command(c: Context) -> ca.SX:
    """u - clip(u, -d, d).

    Source: tao1996 (dead-zone with slope one).
    """
    return c.u - ca.fmin(ca.fmax(c.u, -c.p.width), c.p.width)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return widths below the friction, and such that some of the inputs lie inside."""
    widths = [e.level / abs(e.gain) * share for share in (0.05, 0.2, 0.5)]
    return [{"width": width} for width in (*widths, float(np.quantile(np.abs(e.u), 0.3)))]


EFFECT = Effect(
    "dead_zone",
    "a drive that does not answer to small inputs",
    "tao1996",
    title="dead zone of the drive",
    group="dead_zone",
    equation="u - clip(u, -d, d)",
    residual=("u",),
    rugged=True,
    excitation="reversals with a small input",
    confounded=("stribeck", "asymmetric_coulomb"),
    parameters=(Parameter("dead_zone.width", "d", "V", 0.3, 0.0, 1e6, "input on either side that does nothing", "tao1996"),),
    rank=1,
    command=command,
    starts=starts,
)
