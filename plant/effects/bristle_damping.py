"""Elastic motion before a set-valued law slides, with damping."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter
from bristle.plant.effect import REVERSALS, Context, Effect, Evidence
from bristle.plant.effects.presliding import displacements


def bristles(c: Context) -> tuple[ca.SX, ca.SX]:
    """Fc Sgn v becomes sigma0 z + sigma1 z', z' = v - sigma0 |v| z / Fc.

    Source: canudas1995 (LuGre with Fs = Fc).
    """
    return c.p.stiffness, c.p.damping


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return bristles as presliding has them, half damped."""
    stiffness = [e.level / reach for reach in displacements(e)]
    return [{"stiffness": k, "damping": (k * e.inertia) ** 0.5} for k in stiffness]


EFFECT = Effect(
    "bristle_damping",
    "elastic, damped motion before it slides",
    "canudas1995",
    title="damped presliding",
    group="presliding/bristle_damping",
    equation="F = sigma0 z + sigma1 z', z' = v - sigma0 |v| z / Fc",
    residual=("history", "a"),
    excitation="small fast motion; rarely identifiable",
    needs=(REVERSALS,),
    confounded=("presliding",),
    parameters=(
        Parameter(
            "bristle_damping.stiffness",
            "sigma0",
            "N.m/rad",
            0.8,
            1e-6,
            1e9,
            "stiffness of the bristles",
            "canudas1995",
        ),
        Parameter(
            "bristle_damping.damping",
            "sigma1",
            "N.m.s/rad",
            0.01,
            0.0,
            1e6,
            "damping of the bristles",
            "canudas1995",
        ),
    ),
    bristles=bristles,
    rigid_friction=True,
    starts=starts,
)
