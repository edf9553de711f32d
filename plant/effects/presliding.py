"""Elastic motion before a set-valued law slides."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import REVERSALS, Context, Effect, Evidence


def bristles(c: Context) -> tuple[ca.SX, ca.SX]:
    """Fc Sgn v becomes sigma0 z, z' = v - sigma0 |v| z / Fc.

    Source: canudas1995 (LuGre with Fs = Fc, without bristle damping).
    """
    return c.p.stiffness, ca.SX(0)


def displacements(e: Evidence) -> list[float]:
    """Return displacements [rad] at which bristles may slide: from half a step of the sensor to a
    tenth of the range.
    """
    widest = max(0.1 * float(np.ptp(e.theta)), 20 * e.resolution)
    return [float(x) for x in np.geomspace(0.5 * e.resolution, widest, 5)]


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return bristles that slide after a few steps of the sensor up to a good part of the range."""
    return [{"stiffness": e.level / reach} for reach in displacements(e)]


EFFECT = Effect(
    "presliding",
    "elastic motion before it slides",
    "canudas1995",
    title="elastic presliding",
    group="presliding/bristle_damping",
    equation="F = sigma0 z, z' = v - sigma0 |v| z / Fc",
    residual=("history",),
    excitation="reversals, with motion smaller than Fc/sigma0",
    needs=(REVERSALS,),
    confounded=("bristle_damping", "stribeck", "backlash", "compliance"),
    parameters=(
        Parameter(
            "presliding.stiffness",
            "sigma0",
            "N.m/rad",
            0.8,
            1e-6,
            1e9,
            "stiffness of the bristles",
            "canudas1995",
        ),
    ),
    bristles=bristles,
    separation="add small, fast motion that never breaks away: only damping makes it lose energy",
    starts=starts,
)
