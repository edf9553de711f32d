"""The elastoplastic law: LuGre that is elastic up to a break-away deflection, so that it does not
creep there.
"""

from __future__ import annotations

import math

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.plant.law import (
    BRISTLE_DAMPING,
    Friction,
    FrictionLaw,
    stribeck_curve,
    stribeck_parameters,
    stribeck_truth,
)


def plasticity(z: ca.SX, v: ca.SX, elastic: ca.SX, plastic: ca.SX) -> ca.SX:
    """Return alpha(z, v): 0 up to the deflection z_ba (`elastic`) and on the way back, 1 from z_max
    (`plastic`) on.

    In between half a period of a sine; with the way from z_ba to z_max as the unit it is (1 -
    cos(pi x)) / 2.

    Source: dupont2002 (piecewise definition of alpha).
    """
    share = ca.fmin(ca.fmax((ca.fabs(z) - elastic) / (plastic - elastic), 0), 1)
    return ca.if_else(z * v > 0, (1 - ca.cos(math.pi * share)) / 2, 0)


def equations(p: Namespace, v: ca.SX) -> Friction:
    """F = sigma0 z + sigma1 z' + a2 v, z' = v - alpha(z, v) |v| z / s(v), s = [Fc + (Fs - Fc)
    exp(-(v/vs)^2)] / sigma0.

    z_max is s(v), as in the paper; z_ba is a share of its least value, so that it stays below z_max
    at every speed. Source: dupont2002 (single-state elastoplastic model).
    """
    s = stribeck_curve(p, v) / p.sigma0
    alpha = plasticity(p.z, v, p.share * ca.fmin(p.Fc, p.Fs) / p.sigma0, s)
    dz = v - alpha * ca.fabs(v) * p.z / s
    return Friction(
        force=p.sigma0 * p.z + p.sigma1 * dz, rates={"z": dz}, true=stribeck_truth(p, p.sigma0)
    )


_SOURCE = "dupont2002"
LAW = FrictionLaw(
    "elastoplastic",
    "elastoplastic friction",
    _SOURCE,
    equations,
    parameters=(
        Parameter(
            "elastoplastic.sigma0",
            "sigma0",
            "N.m/rad",
            0.8,
            1e-6,
            1e9,
            "bristle stiffness",
            _SOURCE,
        ),
        Parameter(
            "elastoplastic.sigma1", "sigma1", "N.m.s/rad", 0.002, 0.0, 1e6, BRISTLE_DAMPING, _SOURCE
        ),
        Parameter(
            "elastoplastic.share",
            "z_ba/z_ss",
            "1",
            0.7,
            0.0,
            0.999,
            "break-away over least steady deflection",
            _SOURCE,
        ),
        *stribeck_parameters("elastoplastic", _SOURCE),
    ),
    states=(State("z", "rad", "bristle deflection", scale=lambda p: p.Fc / p.sigma0),),
)
