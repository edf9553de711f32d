"""Voltage that the turning motor takes from the drive."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence


def drive(c: Context) -> ca.SX:
    """u - K v.

    Source: spong2006 chapter 6 (back EMF of a DC motor).
    """
    return ca.SX(c.u - c.p.constant * c.v)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return no back EMF: what it does is proportional to it."""
    return [{"constant": 0.0}]


EFFECT = Effect(
    "back_emf",
    "{input} that the turning motor takes from the drive",
    "spong2006",
    title="back-EMF of the motor",
    group="back_emf",
    equation="u - K v",
    residual=("v",),
    excitation="none helps beside a free viscous term: it takes a measured current",
    confounded=("quadratic_drag",),
    parameters=(
        Parameter(
            "back_emf.constant",
            "K",
            "V.s/rad",
            0.05,
            0.0,
            1e6,
            "{input} over speed",
            "spong2006 chapter 6",
        ),
    ),
    order=1,
    drive=drive,
    without_truth=("alpha2",),
    off={"constant": 0.0},
    starts=starts,
)
