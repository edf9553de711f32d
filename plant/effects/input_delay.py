"""A drive that acts on an older input."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter, State
from bristle.plant.effect import Context, Effect, Evidence

DELAY_SAMPLES = 40  # samples kept; a longer delay acts as one of DELAY_SAMPLES sampling periods


def command(c: Context) -> ca.SX:
    """u(t - T), linearly interpolated between the samples on either side.

    The line holds inputs alone, and T enters where they are read: the derivative by T is that of
    the interpolation. Source: laakso1996 (fractional delay of order one).
    """
    periods = ca.fmin(c.p.delay / c.p.sample_time, DELAY_SAMPLES)
    return ca.SX(
        sum(ca.fmax(0, 1 - ca.fabs(periods - i)) * c.p[f"u{i}"] for i in range(DELAY_SAMPLES + 1))
    )


def updates(c: Context) -> dict[str, ca.SX]:
    """Shift the line by one sample and put the present input in front."""
    return {f"u{i}": c.u if i == 0 else c.p[f"u{i - 1}"] for i in range(DELAY_SAMPLES + 1)}


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return delays from half a sampling period to sixteen."""
    return [{"delay": e.h * periods} for periods in (0.5, 2.0, 6.0, 16.0)]


EFFECT = Effect(
    "input_delay",
    f"a drive that acts on an older input (at most {DELAY_SAMPLES} sampling periods)",
    "laakso1996",
    title="dead time of the input",
    group="input_delay/electrical_pole",
    equation="u(t - T), linear between samples",
    residual=("du",),
    excitation="a bandwidth of the input above 1/(2 pi T)",
    confounded=("electrical_pole",),
    parameters=(
        Parameter(
            "input_delay.delay", "T", "s", 0.0035, 0.0, 10.0, "dead time of the input", "laakso1996"
        ),
    ),
    sampled=tuple(
        State(f"u{i}", "V", f"input of {i} samples before") for i in range(DELAY_SAMPLES + 1)
    ),
    updates=updates,
    command=command,
    without_truth=("delay",),
    off={"delay": 0.0},
    separation=(
        "drive it with a sweep to ever higher frequencies: the phase lag of a dead time grows"
        " without limit, that of the winding ends at a quarter period"
    ),
    starts=starts,
)
