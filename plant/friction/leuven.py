"""The Leuven law, modified: a deflection that relaxes, and hysteresis by Maxwell-slip elements."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter
from bristle.plant.law import (
    BRISTLE_DAMPING,
    Friction,
    FrictionLaw,
    stribeck_curve,
    stribeck_parameters,
)
from bristle.plant.maxwell import MAXWELL_ELEMENTS, MAXWELL_SHARES, element, memory, stiffnesses

PLACES = range(1, MAXWELL_ELEMENTS + 1)
# N.m, sum of the friction levels of all elements; larger than Fs, else all slip before the servo
# slides
_LEVEL = 0.008


def equations(p: Namespace, v: ca.SX) -> Friction:
    """F = Fh(z) + sigma1 z' + a2 v, z' = v [1 - sgn(Fh/s(v)) |Fh/s(v)|^n], s(v) = sgn(v) [Fc + (Fs
    - Fc) exp(-(v/vs)^2)].

    Fh(z) is the hysteresis of Maxwell-slip elements, F_i' = k_i z' up to |F_i| = W_i, in place of a
    stack of reversals. Source: swevers2000 (structure), lampaert2002 (Fh itself in the rate of z,
    and Maxwell-slip elements for Fh).
    """
    level = sum((p[f"F{i}"] for i in PLACES), ca.SX(0))
    # never 0, where the power has no derivative by n
    ratio = ca.fmax(ca.fabs(level) / stribeck_curve(p, v), 1e-12)
    dz = v - ca.fabs(v) * ca.sign(level) * ratio**p.n
    found = {}
    for i in PLACES:
        rates = p[f"k{i}"] * dz, ca.SX(0)
        found[i] = element(p[f"F{i}"], p[f"slip{i}"], dz, p[f"W{i}"], rates, (p.Fc, p.vs))
    return Friction(
        force=level + p.sigma1 * dz,
        rates={f"F{i}": each.rate for i, each in found.items()},
        true={"Fc": ca.fmin(p.Fc, sum(p[f"W{i}"] for i in PLACES)) / p.J},
        switches={f"slip{i}": each.switch for i, each in found.items()},
    )


_FORCES, _SLIPS = memory()
_SOURCE = "lampaert2002"
LAW = FrictionLaw(
    "leuven",
    f"modified Leuven friction, {MAXWELL_ELEMENTS} Maxwell-slip elements",
    "swevers2000, lampaert2002",
    equations,
    parameters=(
        *stribeck_parameters("leuven", _SOURCE),
        Parameter(
            "leuven.n", "n", "1", 2.0, 1.0, 20.0, "exponent of the transition to sliding", _SOURCE
        ),
        Parameter(
            "leuven.sigma1", "sigma1", "N.m.s/rad", 0.002, 0.0, 1e6, BRISTLE_DAMPING, _SOURCE
        ),
        *stiffnesses("leuven", _SOURCE),
        *(
            Parameter(
                f"leuven.W{i}",
                f"W{i}",
                "N.m",
                share * _LEVEL,
                0.0,
                1e6,
                f"force at which element {i} slips",
                _SOURCE,
            )
            for i, share in zip(PLACES, MAXWELL_SHARES, strict=True)
        ),
    ),
    states=tuple(_FORCES),
    modes=tuple(_SLIPS),
)
