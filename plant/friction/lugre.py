"""The original LuGre law with bristle damping."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State, declaring
from bristle.plant.law import BRISTLE_DAMPING, Friction, FrictionLaw, stribeck_curve, stribeck_truth


def bristles(p: Namespace, v: ca.SX, sigma1: ca.SX) -> Friction:
    """F = sigma0 z + sigma1 z' + a2 v, z' = v - |v| z / s(v), s = [Fc + (Fs - Fc) exp(-(v/vs)^2)] /
    sigma0.

    With Fc = sigma0 a0 and Fs = sigma0 (a0 + a1) this is the paper's s(v).
    Source: dixit2008 eq. (8)-(10).
    """
    s = stribeck_curve(p, v) / p.sigma0
    dz = v - ca.fabs(v) * p.z / s
    return Friction(
        force=p.sigma0 * p.z + sigma1 * dz, rates={"z": dz}, true=stribeck_truth(p, p.sigma0)
    )


def equations(p: Namespace, v: ca.SX) -> Friction:
    """The bristles with a constant sigma1.

    Source: dixit2008 eq. (8)-(10).
    """
    return bristles(p, v, p.sigma1)


_own = declaring("lugre", "dixit2008 eq. (10)")
LAW = FrictionLaw(
    "lugre",
    "LuGre friction with bristle damping",
    "dixit2008 eq. (7)-(12)",
    equations,
    parameters=(
        Parameter(
            "lugre.sigma0",
            "sigma0",
            "N.m/rad",
            0.8,
            1e-6,
            1e9,
            "bristle stiffness",
            "dixit2008 eq. (8)",
        ),
        Parameter(
            "lugre.sigma1",
            "sigma1",
            "N.m.s/rad",
            0.0,
            0.0,
            1e6,
            BRISTLE_DAMPING,
            "dixit2008 eq. (8)",
        ),
        _own("Fc", "sigma0 a0", "N.m", (0.004, 1e-9, 1e6), "Coulomb friction"),
        _own("Fs", "sigma0 (a0 + a1)", "N.m", (0.0072, 1e-9, 1e6), "static friction"),
        _own("vs", "v0", "rad/s", (0.4363323129985824, 1e-6, 1e3), "Stribeck velocity"),
    ),
    states=(State("z", "rad", "bristle deflection", scale=lambda p: p.Fc / p.sigma0),),
)
