"""A load behind a coupling with play."""

from __future__ import annotations

import math

import casadi as ca

from bristle.model.variables import Parameter
from bristle.plant.effect import OVER_INERTIA, REVERSALS, Context, Coupling, Effect, Evidence, power

# rad: deformation of the contact at which its torque does not depend on the exponent
CONTACT_DEPTH = 1e-3


def coupling(c: Context, twist: ca.SX, rate: ca.SX) -> Coupling:
    """T = k e (|e|/e0)^(n-1) (1 + lambda e'), e = twist beyond half the play; contact never pulls.

    The damping grows with the deformation, so that the torque has no jump at contact. Sides as for
    compliance; the share s of the friction acts behind the play. Source: nordin2002 (dead-zone
    model of backlash); hunt1975 (contact damping; n = 1.5 where spheres touch).
    """
    half = c.p.play / 2
    press = twist - ca.fmin(ca.fmax(twist, -half), half)
    shape = power(press / CONTACT_DEPTH, c.p.exponent - 1)
    return Coupling(
        c.p.share,
        c.p.stiffness * press * shape * ca.fmax(0, 1 + c.p.dissipation * rate * ca.sign(press)),
        c.p.friction_share,
    )


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return plays from a few steps of the sensor upwards: of a light load with a contact of 50 Hz;
    of loads that part of the friction acts on, with a softer contact, from which the harder ones
    are reached; and of some with a contact where the spectrum has its clearest peak.

    On how the friction is shared depends at which moments the load changes sides.
    """
    plays = [4 * e.resolution * 2.0**k for k in range(7)]
    light = [_start(e, 0.25, play, 50.0) for play in plays]
    loaded = [
        _start(e, share, play, 25.0) | {"friction_share": friction}
        for share in (0.25, 0.5, 0.75)
        for friction in (0.0, 0.25, 0.5, 0.75, 1.0)
        for play in plays[1::2]
    ]
    seen = [_start(e, 0.4, play, peak) for peak in e.resonances(1) for play in plays[1::2]]
    return [*light, *loaded, *seen]


def _start(e: Evidence, share: float, play: float, frequency: float) -> dict[str, float]:
    stiffness = share * (1 - share) * e.inertia * (2 * math.pi * frequency) ** 2
    return {"share": share, "play": play, "stiffness": stiffness, "dissipation": 1.5}


EFFECT = Effect(
    "backlash",
    "a load behind a coupling with play",
    "nordin2002",
    title="free play in the coupling",
    group="backlash",
    equation=(
        "T = k e (|e|/e0)^(n-1) (1 + lambda e'), e = dz(theta - theta_load, b/2), e0 = 1 mrad,"
        " J_load = r J"
    ),
    residual=("history",),
    free_play="play",
    excitation="reversals",
    needs=(REVERSALS,),
    confounded=("input_delay", "presliding", "compliance"),
    parameters=(
        Parameter(
            "backlash.share",
            "r",
            "1",
            0.5,
            1e-3,
            0.999,
            "load inertia over the whole J",
            "nordin2002",
        ),
        Parameter(
            "backlash.play", "b", "rad", 0.02, 0.0, 10.0, "free play of the coupling", "nordin2002"
        ),
        Parameter(
            "backlash.stiffness",
            "k",
            "N.m/rad",
            20.0,
            1e-6,
            1e9,
            "stiffness of the contact",
            "nordin2002",
        ),
        Parameter(
            "backlash.dissipation",
            "lambda",
            "s/rad",
            1.0,
            0.0,
            1e6,
            "damping over elastic {torque} and rate",
            "hunt1975",
        ),
        Parameter(
            "backlash.exponent",
            "n",
            "1",
            1.0,
            1.0,
            3.0,
            "of the {torque} over the deformation of the contact",
            "hunt1975",
        ),
        Parameter(
            "backlash.friction_share",
            "s",
            "1",
            0.0,
            0.0,
            1.0,
            "share of viscous and dry friction that acts behind the play",
            "nordin2002",
        ),
    ),
    shape_starts=({"exponent": 1.5},),
    coupling=coupling,
    without_truth=OVER_INERTIA,
    search_interval={"share": (0.02, 0.9), "dissipation": (1e-3, 1e3)},
    starts=starts,
)
