"""The generalised Maxwell-slip law: elements that are springs while they stick, each with its own
slip mode.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter
from bristle.plant.law import (
    Friction,
    FrictionLaw,
    stribeck_curve,
    stribeck_parameters,
    stribeck_truth,
)
from bristle.plant.maxwell import MAXWELL_ELEMENTS, MAXWELL_SHARES, element, memory, stiffnesses

PLACES = range(1, MAXWELL_ELEMENTS + 1)


def equations(p: Namespace, v: ca.SX) -> Friction:
    """F = sum F_i + a2 v. Sticking F_i' = k_i v, until F_i = alpha_i s(v); slipping F_i' = C
    (alpha_i sgn v - F_i / |s(v)|).

    s(v) = sgn(v) [Fc + (Fs - Fc) exp(-(v/vs)^2)]; what slips sticks again when the motion reverses.
    Source: albender2005 (element equations and their switching rule).
    """
    s, sizes = stribeck_curve(p, v), (p.Fc, p.vs)
    found = {}
    for i in PLACES:
        force, slip = p[f"F{i}"], p[f"slip{i}"]
        rates = p[f"k{i}"] * v, p.C * (p[f"alpha{i}"] * slip - force / s)
        found[i] = element(force, slip, v, p[f"alpha{i}"] * s, rates, sizes)
    return Friction(
        force=sum((p[f"F{i}"] for i in PLACES), ca.SX(0)),
        rates={f"F{i}": each.rate for i, each in found.items()},
        true=stribeck_truth(p) | {"Fc": sum(p[f"alpha{i}"] for i in PLACES) * p.Fc / p.J},
        switches={f"slip{i}": each.switch for i, each in found.items()},
    )


_FORCES, _SLIPS = memory()
_SOURCE = "albender2005"
LAW = FrictionLaw(
    "gms",
    f"generalised Maxwell-slip friction, {MAXWELL_ELEMENTS} elements",
    _SOURCE,
    equations,
    parameters=(
        *stribeck_parameters("gms", _SOURCE),
        Parameter(
            "gms.C",
            "C",
            "N.m/s",
            0.2,
            0.0,
            1e9,
            "attraction to the friction level while slipping",
            _SOURCE,
        ),
        *stiffnesses("gms", _SOURCE),
        *(
            Parameter(
                f"gms.alpha{i}",
                f"alpha{i}",
                "1",
                share,
                0.0,
                1.0,
                f"share of element {i} in the friction level",
                _SOURCE,
            )
            for i, share in zip(PLACES, MAXWELL_SHARES, strict=True)
        ),
    ),
    states=tuple(_FORCES),
    modes=tuple(_SLIPS),
)
