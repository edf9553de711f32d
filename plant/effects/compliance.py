"""A load behind a spring."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Coupling, Effect


def coupling(c: Context, twist: ca.SX, rate: ca.SX) -> Coupling:
    """T = k (theta - theta_load) + d (v - v_load); the load has the share r of J, the motor the rest.

    Friction and the sensor are on the motor side; external torque, gravity, a stop and a disturbance act on the load.
    Source: spong2006 chapter 6 (drive train with an elastic shaft).
    """
    return Coupling(c.p.share, c.p.stiffness * twist + c.p.damping * rate)


EFFECT = Effect(
    "compliance",
    "a load behind a spring",
    "spong2006",
    group="compliance",
    equation="T = k (theta - theta_load) + d (v - v_load), J_load = r J",
    residual=("frequency",),
    excitation="a chirp over the resonance, typically 10 to 60 Hz",
    confounded=("input_delay", "electrical_pole", "presliding", "backlash"),
    parameters=(
        Parameter("compliance.share", "r", "1", 0.5, 1e-3, 0.999, "load inertia over the whole J", "spong2006 chapter 6"),
        Parameter("compliance.stiffness", "k", "N.m/rad", 10.0, 1e-6, 1e9, "stiffness of the shaft", "spong2006 chapter 6"),
        Parameter("compliance.damping", "d", "N.m.s/rad", 0.005, 0.0, 1e6, "damping of the shaft", "spong2006 chapter 6"),
    ),
    coupling=coupling,
)
