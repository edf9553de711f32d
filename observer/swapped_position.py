"""Approach I, filtered, from an encoder: the same least squares on velocity and input smoothed alike."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter
from bristle.observer import swapping
from bristle.observer.method import EquationContext, Method, Sample, Update, stack, unstack, vector_states

SX = ca.SX


def smoothed(p: Namespace, s: Sample) -> tuple[SX, SX, dict[str, SX]]:
    """Smooth the mean velocity of a sample and the input in it alike; return the signals at both ends, and the next states.

    The difference of two positions is the mean velocity of a sample, and the held input its own mean: both belong to the
    middle of the sample and go, as means do, linearly from one middle to the next. Two sections alike on both leave (15)
    true; only (17), at the velocity that is smoothed, is not exactly what the smoothing of (17) would be.
    Source: dixit2008 eq. (20)-(22) and the remark on position measurement at the end of section III.
    """
    now = ca.vertcat(s.u, (s.y1 - s.y0) / s.period)
    once, twice = stack(p, "once", 2), stack(p, "twice", 2)
    gain = 1 - ca.exp(-p.smoothing * s.period)
    once_new = once + gain * (now - once)
    twice_new = twice + gain * (once_new - twice)
    start, end = (swapping.signals(pair[0], pair[1], p.width) for pair in (twice, twice_new))
    return start, end, unstack("once", once_new) | unstack("twice", twice_new)


def _equations(context: EquationContext, s: Sample) -> Update:
    """Smooth, then filter and fit as `swapped` does.

    Source: dixit2008 eq. (20)-(22).
    """
    p = context.p
    start, end, filters = smoothed(p, s)
    return Update(
        next=swapping.step(context, s, start, end) | filters,
        estimates=swapping.estimates(p),
        signals={"v": p.twice1},
        valid=swapping.valid(p),
    )


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare filters, memory and the precision asked for under a method's name."""
    text = "corner of each of the two sections that smooth velocity and input alike"
    return (
        *swapping.parameters(prefix, 15.0),
        Parameter(f"{prefix}.smoothing", "a_s", "rad/s", 600.0, 1.0, 1e5, text, "ljung1999 section 14.4"),
    )


FILTER_STATES = (
    *vector_states("once", "1", "input and velocity after one section", 2),
    *vector_states("twice", "1", "input and velocity after two sections", 2),
)

METHOD = Method(
    "swapped_position",
    "filtered Approach I from position: least squares of eight entries on smoothed differences",
    "dixit2008 eq. (20)-(22)",
    "y_theta",
    parameters("swapped_position"),
    (*swapping.states(), *FILTER_STATES),
    _equations,
)
