"""Set-valued friction that falls with the speed: exact sticking, and a break-away torque above that
of sliding.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace
from bristle.plant.law import (
    Friction,
    FrictionLaw,
    stribeck_curve,
    stribeck_parameters,
    stribeck_truth,
)


def equations(p: Namespace, v: ca.SX) -> Friction:
    """F = a2 v + f with f in [Fc + (Fs - Fc) exp(-(v/vs)^2)] Sgn(v).

    Source: armstrong1994 (static friction with Stribeck effect), with the set-valued sign in place
    of a separate stiction.
    """
    return Friction(force=ca.SX(0), bound=stribeck_curve(p, v), true=stribeck_truth(p))


LAW = FrictionLaw(
    "stribeck_static",
    "set-valued friction with Stribeck effect",
    "armstrong1994 (Gaussian form)",
    equations,
    parameters=stribeck_parameters("stribeck_static", "armstrong1994"),
)
