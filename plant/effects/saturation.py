"""A limit of the input below the one the drive is known to have."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence, Limits, RecordedMotion

LARGEST_SHARE_CUT = 0.8  # largest share of the samples whose input is cut (1)


def command(c: Context) -> ca.SX:
    """clip(u, -s, s).

    Source: khalil2002 section 1.2 (saturation).
    """
    return ca.fmin(ca.fmax(c.u, -c.p.limit), c.p.limit)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return limits that cut the highest inputs."""
    return [{"limit": float(np.quantile(np.abs(e.u), share))} for share in (0.995, 0.98, 0.95, 0.9)]


def limits(m: RecordedMotion) -> Limits:
    """A limit that a fifth of the input stays below: with less, only its sign is left."""
    return {"limit": (float(np.quantile(np.abs(m.u), 1 - LARGEST_SHARE_CUT)), math.inf)}


EFFECT = Effect(
    "saturation",
    "a limit of the input below the drive's known one",
    "khalil2002",
    title="saturation of the drive",
    group="saturation",
    equation="clip(u, -s, s)",
    residual=("u",),
    excitation="peaks of the input",
    confounded=("quadratic_drag", "back_emf"),
    parameters=(
        Parameter(
            "saturation.limit",
            "s",
            "V",
            4.0,
            0.0,
            1e6,
            "largest input that has an effect",
            "khalil2002 section 1.2",
        ),
    ),
    order=2,
    sparse=True,
    command=command,
    off={"limit": 1e6},
    limits=limits,
    starts=starts,
)
