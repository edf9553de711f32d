"""A limit of the input below the one the drive is known to have."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence


def command(c: Context) -> ca.SX:
    """clip(u, -s, s).

    Source: khalil2002 section 1.2 (saturation).
    """
    return ca.fmin(ca.fmax(c.u, -c.p.limit), c.p.limit)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return limits that cut the highest inputs."""
    return [{"limit": float(np.quantile(np.abs(e.u), share))} for share in (0.995, 0.98, 0.95, 0.9)]


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
        Parameter("saturation.limit", "s", "V", 4.0, 0.0, 1e6, "largest input that has an effect", "khalil2002 section 1.2"),
    ),
    rank=2,
    local=True,
    command=command,
    starts=starts,
)
