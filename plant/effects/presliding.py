"""Elastic motion before a set-valued law slides."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.errors import BristleError
from bristle.model.variables import Namespace, Parameter, State
from bristle.plant.effect import Effect, Evidence
from bristle.plant.law import Friction, FrictionLaw

SX = ca.SX


def bristles(law: FrictionLaw, effect: str, stiffness: str, damping: str | None = None) -> FrictionLaw:
    """Return a set-valued law as LuGre with Fs = Fc; `stiffness` and `damping` are names of parameters."""
    if law.states:
        raise BristleError(f"effect '{effect}' cannot join law '{law.name}', which has bristles of its own; set its parameters")

    def level(p: Namespace, v: SX) -> SX:
        bound = law.equations(p, v).bound
        if bound is None:
            raise BristleError(f"effect '{effect}' needs dry friction, which law '{law.name}' does not have; choose another law")
        return ca.fmax(bound, 1e-12)  # without friction the bristles hold nothing, and nothing is divided by zero

    def equations(p: Namespace, v: SX) -> Friction:
        """F = sigma0 z + sigma1 z', z' = v - sigma0 |v| z / Fc.

        Source: canudas1995 (LuGre with Fs = Fc).
        """
        dz = v - p[stiffness] * ca.fabs(v) * p.z / level(p, v)
        before = law.equations(p, v)
        force = before.force + p[stiffness] * p.z + (p[damping] * dz if damping else 0)
        return Friction(force=force, rates={"z": dz}, true=before.true)

    state = State("z", "rad", "bristle deflection", scale=lambda p: level(p, SX(0)) / p[stiffness])
    return FrictionLaw(law.name, law.description, law.source, equations, law.parameters, (state,))


def replacement(law: FrictionLaw) -> FrictionLaw:
    """Fc Sgn v becomes sigma0 z, z' = v - sigma0 |v| z / Fc.

    Source: canudas1995 (LuGre with Fs = Fc, without bristle damping).
    """
    return bristles(law, "presliding", "presliding.stiffness")


def displacements(e: Evidence) -> list[float]:
    """Return displacements [rad] at which bristles may slide: from a few steps of the sensor to a tenth of the range."""
    widest = max(0.1 * float(np.ptp(e.theta)), 20 * e.resolution)
    return [float(x) for x in np.geomspace(3 * e.resolution, widest, 5)]


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return bristles that slide after a few steps of the sensor, up to a good part of the range."""
    return [{"stiffness": e.level / reach} for reach in displacements(e)]


EFFECT = Effect(
    "presliding",
    "elastic motion before it slides",
    "canudas1995",
    group="presliding/bristle_damping",
    equation="F = sigma0 z, z' = v - sigma0 |v| z / Fc",
    residual=("history",),
    excitation="reversals, with motion smaller than Fc/sigma0",
    confounded=("bristle_damping", "stribeck", "backlash", "compliance"),
    parameters=(
        Parameter("presliding.stiffness", "sigma0", "N.m/rad", 0.8, 1e-6, 1e9, "stiffness of the bristles", "canudas1995"),
    ),
    law=replacement,
    starts=starts,
)
