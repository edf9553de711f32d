"""LuGre whose bristles are damped less the faster it slides."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.plant.friction.lugre import bristles
from bristle.plant.law import BRISTLE_DAMPING, Friction, FrictionLaw, stribeck_parameters


def equations(p: Namespace, v: ca.SX) -> Friction:
    """F = sigma0 z + sigma1(v) z' + a2 v, sigma1(v) = sigma1 exp(-(v/vd)^2).

    With a constant sigma1 the law is passive only if a2 >= sigma1 (Fs - Fc)/Fc; this one is
    whatever a2, if sigma1(v) |v| <= 4 [Fc + (Fs - Fc) exp(-(v/vs)^2)] at all speeds, for which
    sigma1 vd <= 4 sqrt(2 e) min(Fc, Fs) suffices. Source: canudas1995, olsson1996
    (velocity-dependent damping); barabanov2000 (the condition for a constant sigma1).
    """
    return bristles(p, v, p.sigma1 * ca.exp(-((v / p.vd) ** 2)))


_NAME, _SOURCE = "lugre_velocity_damping", "olsson1996"
LAW = FrictionLaw(
    _NAME,
    "LuGre friction with velocity-dependent bristle damping",
    "canudas1995, olsson1996",
    equations,
    parameters=(
        Parameter(
            f"{_NAME}.sigma0", "sigma0", "N.m/rad", 0.8, 1e-6, 1e9, "bristle stiffness", _SOURCE
        ),
        Parameter(
            f"{_NAME}.sigma1",
            "sigma1",
            "N.m.s/rad",
            0.02,
            0.0,
            1e6,
            f"at rest, {BRISTLE_DAMPING}",
            _SOURCE,
        ),
        Parameter(
            f"{_NAME}.vd",
            "vd",
            "rad/s",
            0.5,
            1e-6,
            1e3,
            "velocity over which the damping fades",
            _SOURCE,
        ),
        *stribeck_parameters(_NAME, _SOURCE),
    ),
    states=(State("z", "rad", "bristle deflection", scale=lambda p: p.Fc / p.sigma0),),
)
