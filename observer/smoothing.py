"""Velocity and voltage from an encoder, both behind the same low-pass filter, for observers that
read velocity.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import kalman
from bristle.observer.method import Sample, stack, unstack, vector_states

SX = ca.SX
CITATION = "dixit2008 section III, remark on position measurement"
STATES = (
    *vector_states("smooth", "1", "velocity and voltage after one section", 2),
    *vector_states("smoother", "1", "velocity and voltage after two sections", 2),
    State("smooth_runs", "1", "1 once these filters run"),
    State("u_before", "V", "input before the last one"),
)


def parameter(prefix: str) -> Parameter:
    """Declare the corner of both sections."""
    text = "corner of each of the two low-pass sections of velocity and voltage"
    return Parameter(f"{prefix}.smoothing", "a_v", "1/s", 800.0, 1e-3, 1e5, text, CITATION)


def smooth(p: Namespace, s: Sample) -> tuple[Sample, dict[str, SX]]:
    """Return velocity and voltage in place of position, and the next states.

    The difference of two positions is the velocity in the middle of a sample, so that the sample
    returned reaches from one middle to the next, with the mean of the inputs before and after the
    instant between. The filters start from the first values there are. Source: dixit2008 section
    III, the remark on position measurement at its end.
    """
    runs = p.smooth_runs > 0
    raw = ca.vertcat((s.y1 - s.y0) / s.period, (s.u + ca.if_else(runs, p.u_before, s.u)) / 2)
    once, twice = (ca.if_else(runs, stack(p, name, 2), raw) for name in ("smooth", "smoother"))
    gain = 1 - ca.exp(-p.smoothing * s.period)
    once_new = once + gain * (raw - once)
    new = twice + gain * (once_new - twice)
    states = {
        **unstack("smooth", once_new),
        **unstack("smoother", new),
        "u_before": s.u,
        "smooth_runs": SX(1),
    }
    return Sample(new[1], twice[0], new[0], s.period), states


def rounding_noise(resolution: SX, corner: SX, period: SX) -> SX:
    """Return the variance of the smoothed velocity by a position that is rounded, two sections of
    gain g = 1 - q on its difference.

    The squares of the impulse response, g^2 (1, 2 q - 1, .., q^(k-1) (q - k g), ..) / Ts, add up to
    the sum below. Source: widrow2008 chapter 1.
    """
    q = ca.exp(-corner * period)
    gain, rest = 1 - q, 1 - q**2
    squares = 1 + q**2 / rest - 2 * q * gain / rest**2 + gain**2 * (1 + q**2) / rest**3
    return SX(kalman.rounding(resolution) / period**2 * gain**4 * squares)


def lag(p: Namespace, s: Sample) -> SX:
    """Return the time over which velocity is smoothed and held."""
    return SX(s.period + 2 / p.smoothing)
