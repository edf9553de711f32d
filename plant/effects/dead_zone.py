"""A drive that does not answer to small inputs."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence, Limits, RecordedMotion

LARGEST_SHARE_INSIDE = 0.8  # largest share of the samples whose input lies inside the dead zone (1)
# share of the samples inside beyond which a stronger likelihood gain is required (1)
CREDIBLE_SHARE_INSIDE = 0.5


def command(c: Context) -> ca.SX:
    """u - clip(u, -d, d).

    Source: tao1996 (dead-zone with slope one).
    """
    return c.u - ca.fmin(ca.fmax(c.u, -c.p.width), c.p.width)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return widths below the friction, and such that some of the inputs lie inside."""
    widths = [e.level / abs(e.gain) * share for share in (0.05, 0.2, 0.5)]
    return [{"width": width} for width in (*widths, float(np.quantile(np.abs(e.u), 0.3)))]


def limits(m: RecordedMotion) -> Limits:
    """A width that leaves a fifth of the input: with less, the input explains nothing."""
    return {"width": (0.0, float(np.quantile(np.abs(m.u), LARGEST_SHARE_INSIDE)))}


def credible(m: RecordedMotion) -> Limits:
    """A width that leaves half of the input: with less, the input explains hardly anything."""
    return {"width": (0.0, float(np.quantile(np.abs(m.u), CREDIBLE_SHARE_INSIDE)))}


EFFECT = Effect(
    "dead_zone",
    "a drive that does not answer to small inputs",
    "tao1996",
    title="dead zone of the drive",
    group="dead_zone",
    equation="u - clip(u, -d, d)",
    residual=("u",),
    nonsmooth=True,
    excitation="reversals with a small input",
    confounded=("stribeck", "asymmetric_coulomb"),
    parameters=(
        Parameter(
            "dead_zone.width",
            "d",
            "V",
            0.3,
            0.0,
            1e6,
            "input on either side that does nothing",
            "tao1996",
        ),
    ),
    order=1,
    command=command,
    off={"width": 0.0},
    limits=limits,
    credible=credible,
    starts=starts,
)
