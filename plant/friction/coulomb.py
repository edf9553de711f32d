"""Coulomb friction as a set-valued law, with exact sticking."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter
from bristle.plant.law import Friction, FrictionLaw


def equations(p: Namespace, v: ca.SX) -> Friction:
    """F = a2 v + f with f in Fc Sgn(v).

    Source: dixit2008 eq. (23), with the set-valued sign in place of sgn.
    """
    return Friction(force=ca.SX(0), bound=p.Fc, true={"Fc": p.Fc / p.J})


LAW = FrictionLaw(
    "coulomb",
    "set-valued Coulomb and viscous friction",
    "dixit2008 eq. (23)",
    equations,
    parameters=(
        Parameter(
            "coulomb.Fc", "Fc", "N.m", 0.004, 0.0, 1e6, "Coulomb friction", "dixit2008 eq. (23)"
        ),
    ),
)
