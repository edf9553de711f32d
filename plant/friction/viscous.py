"""Viscous friction alone: the linear baseline."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace
from bristle.plant.law import Friction, FrictionLaw


def equations(p: Namespace, v: ca.SX) -> Friction:
    """F = a2 v, which the servo itself adds.

    Source: dixit2008 eq. (8) with sigma0 = sigma1 = 0.
    """
    return Friction(force=ca.SX(0))


LAW = FrictionLaw("viscous", "viscous friction only", "dixit2008 eq. (8)", equations)
