"""Approach I, filtered, from an encoder: the same least squares on smoothed signals."""

from __future__ import annotations

from collections.abc import Iterable

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import kalman, smoothing, swapping
from bristle.observer.method import (
    EquationContext,
    Method,
    Sample,
    Update,
    stack,
    unstack,
    vector_states,
)

SX = ca.SX


def smoothed(p: Namespace, s: Sample) -> tuple[tuple[SX, SX], dict[str, SX]]:
    """Smooth the mean velocity of a sample and the input in it alike; return the signals at both
    ends, and the next states.

    The difference of two positions is the mean velocity of a sample, and the held input its own
    mean: both belong to the middle of the sample and go, as means do, linearly from one middle to
    the next. Two sections alike on both leave (15) true; only (17), at the velocity that is
    smoothed, is not exactly what the smoothing of (17) would be. Source: dixit2008 eq. (20)-(22)
    and the remark on position measurement at the end of section III.
    """
    now = ca.vertcat(s.u, (s.y1 - s.y0) / s.period)
    once, twice = stack(p, "once", 2), stack(p, "twice", 2)
    gain = 1 - ca.exp(-p.smoothing * s.period)
    once_new = once + gain * (now - once)
    twice_new = twice + gain * (once_new - twice)
    change = twice_new[0] - twice[0]
    start = swapping.signals(twice[0], p.change, twice[1], p.width)
    end = swapping.signals(twice_new[0], change, twice_new[1], p.width)
    return (start, end), unstack("once", once_new) | unstack("twice", twice_new) | {
        "change": change
    }


def update(
    context: EquationContext, s: Sample, names: Iterable[str], prior: swapping.Prior | None = None
) -> Update:
    """Smooth, then filter and fit as `swapped` does.

    Source: dixit2008 eq. (20)-(22).
    """
    p = context.p
    ends, filters = smoothed(p, s)
    noise = smoothing.rounding_noise(p.resolution, p.smoothing, s.period)
    given = swapping.Settings(p.cutoff, p.memory, noise, smoothing.lag(p, s))
    fit = swapping.observe(context, s, ends, given, swapping.OWN, prior)
    return Update(
        next=fit | filters,
        **swapping.published(p, swapping.OWN, given, names),
        signals={"v": p.twice1},
    )


def _equations(context: EquationContext, s: Sample) -> Update:
    return update(context, s, swapping.ESTIMATES)


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare the sensor's step, filters, memory and width under a method's name."""
    text = "corner of each of the two sections that smooth velocity and input alike"
    return (
        kalman.resolution_parameter(prefix),
        *swapping.parameters(prefix, 15.0),
        Parameter(
            f"{prefix}.smoothing", "a_s", "rad/s", 600.0, 1.0, 1e5, text, "ljung1999 section 14.4"
        ),
    )


STATES = (
    *swapping.FILTER_STATES,
    *swapping.OWN.states,
    *vector_states("once", "1", "input and velocity after one section", 2),
    *vector_states("twice", "1", "input and velocity after two sections", 2),
    State("change", "V", "last change of the smoothed input"),
)

METHOD = Method(
    "swapped_position",
    "filtered Approach I from position: least squares of eleven entries on smoothed differences",
    "dixit2008 eq. (20)-(22)",
    "y_theta",
    parameters("swapped_position"),
    STATES,
    _equations,
)
