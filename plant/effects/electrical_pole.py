"""Torque that follows the input with the time constant of the winding."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter, State
from bristle.plant.effect import Context, Effect, Evidence, Limits, RecordedMotion

LONGEST_TIME_CONSTANT = 0.25  # longest time constant over the length of a segment (1)


def drive(c: Context) -> ca.SX:
    """The input as the current follows it."""
    return ca.SX(c.p.lagged)


def rates(c: Context) -> dict[str, ca.SX]:
    """T x' = u - x with T = L/R.

    Source: spong2006 chapter 6 (armature circuit of a DC motor).
    """
    return {"lagged": (c.u - c.p.lagged) / c.p.time_constant}


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return time constants from half a sampling period to sixteen."""
    return [{"time_constant": e.h * periods} for periods in (0.5, 2.0, 6.0, 16.0)]


def limits(m: RecordedMotion) -> Limits:
    """A time constant several times shorter than a segment: a longer one is an integrator."""
    return {"time_constant": (0.0, LONGEST_TIME_CONSTANT * m.segment)}


EFFECT = Effect(
    "electrical_pole",
    "{torque} that follows the input with the winding's time constant",
    "spong2006",
    title="electrical lag of the winding",
    group="input_delay/electrical_pole",
    equation="T x' = u - x",
    residual=("du",),
    excitation="a bandwidth of the input above 1/(2 pi T)",
    confounded=("input_delay",),
    parameters=(
        Parameter(
            "electrical_pole.time_constant",
            "T",
            "s",
            0.003,
            1e-6,
            10.0,
            "inductance over resistance",
            "spong2006",
        ),
    ),
    order=2,
    states=(State("lagged", "V", "input as the current follows it"),),
    rates=rates,
    drive=drive,
    without_truth=("delay",),
    limits=limits,
    starts=starts,
)
