"""A load behind a spring."""

from __future__ import annotations

import math

import casadi as ca

from bristle.model.variables import Parameter, declaring
from bristle.plant.effect import OVER_INERTIA, Context, Coupling, Effect, Evidence


def coupling(c: Context, twist: ca.SX, rate: ca.SX) -> Coupling:
    """T = k e (1 + h e^2) + d e', e = theta - theta_load; the load has the share r of J, the motor
    the rest.

    Friction and the sensor are on the motor side; external torque, gravity, a stop and a
    disturbance act on the load. Source: spong2006 chapter 6 (drive train with an elastic shaft),
    tuttle1996 (cubic term of its stiffness).
    """
    return Coupling(
        c.p.share, c.p.stiffness * twist * (1 + c.p.hardening * twist * twist) + c.p.damping * rate
    )


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return resonances of the whole where the spectrum has peaks and from 8 to 80 Hz, lightly
    damped, with a third of the inertia behind the spring."""
    share, starts = 0.3, []
    for frequency in (*e.resonances(2), 8.0, 14.0, 25.0, 45.0, 80.0):
        stiffness = share * (1 - share) * e.inertia * (2 * math.pi * frequency) ** 2
        damping = 0.1 * (stiffness * share * e.inertia) ** 0.5
        starts.append({"share": share, "stiffness": stiffness, "damping": damping})
    return starts


_own = declaring("compliance", "spong2006 chapter 6")
EFFECT = Effect(
    "compliance",
    "a load behind a spring",
    "spong2006",
    title="elastic coupling to the load",
    group="compliance",
    equation="T = k e (1 + h e^2) + d e', e = theta - theta_load, J_load = r J",
    residual=("frequency",),
    excitation="a chirp over the resonance, typically 10 to 60 Hz",
    confounded=("input_delay", "electrical_pole", "presliding", "backlash"),
    parameters=(
        _own("share", "r", "1", (0.5, 1e-3, 0.999), "load inertia over the whole J"),
        _own("stiffness", "k", "N.m/rad", (10.0, 1e-6, 1e9), "stiffness of the shaft"),
        _own("damping", "d", "N.m.s/rad", (0.005, 0.0, 1e6), "damping of the shaft"),
        Parameter(
            "compliance.hardening",
            "h",
            "1/rad2",
            0.0,
            0.0,
            1e8,
            "cubic term of the stiffness, over k",
            "tuttle1996",
        ),
    ),
    shape_starts=({"hardening": 0.0},),
    coupling=coupling,
    without_truth=OVER_INERTIA,
    search_interval={"share": (0.02, 0.9)},
    starts=starts,
)
