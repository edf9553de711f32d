"""Step 1 of Approach II from an encoder: recursive least squares on filtered signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import excitation, kalman, step1
from bristle.observer.companion import Rest, Row
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
CITATION = "ljung1999 section 11.2; dixit2008 eq. (23)"
ESTIMATES = units("alpha2", "b", "Fc")


@dataclass(frozen=True)
class RegressionSample:
    """A sample of z = h' theta, whether it counts, and the next states of the filters behind it."""

    z: SX
    h: SX
    counts: SX
    next: dict[str, SX]


def regression(p: Namespace, s: Sample, gate: SX) -> RegressionSample:
    """Filter L v' = -alpha2 L v + b L u - Fc L sgn v from position, L = two equal low-pass
    sections; counts at |L v| > gate.

    Velocity is the difference of two positions, so that it belongs to the middle of a sample; its
    own difference and mean then belong to the sampling instant between, and u enters as the mean of
    the inputs before and after it. The same L on every signal leaves the equation exact. After a
    passage through low speed nothing counts until the filters have forgotten it.

    Source: ljung1999 section 11.2; dixit2008 eq. (23).
    """
    v = (s.y1 - s.y0) / s.period
    raw = ca.vertcat((v - p.last_v) / s.period, -(v + p.last_v) / 2, (s.u + p.u_before) / 2)
    gain = 1 - ca.exp(-p.cutoff * s.period)
    one = stack(p, "once", 3)
    two = stack(p, "twice", 3)
    one_new = one + gain * (raw - one)
    two_new = two + gain * (one_new - two)
    speed = -two_new[1]
    clear = ca.if_else(ca.fabs(speed) > gate, p.clear + s.period, 0)
    ready = p.seen >= 1  # the first difference of velocities needs three positions
    filters = {
        **unstack("once", ca.if_else(ready, one_new, one)),
        **unstack("twice", ca.if_else(ready, two_new, two)),
        "last_v": v,
        "u_before": s.u,
        "clear": ca.if_else(ready, clear, 0),
        "seen": p.seen + 1,
    }
    h = ca.vertcat(two_new[1], two_new[2], -ca.sign(speed))
    return RegressionSample(two_new[0], h, ca.logic_and(clear > p.hold_off, ready), filters)


def least_squares(
    covariance: SX, h: SX, error: SX, noise: SX, forgetting: SX, largest: SX
) -> tuple[SX, SX]:
    """Return (change of theta, covariance) after a sample of error = h' (true theta - theta) +
    noise of that variance.

    Nothing is forgotten where that would lift the covariance above `largest`: what a record never
    excites would grow without end. Where rounding has cost the covariance its sign (a jump of the
    signals by many orders), it starts again. Source: ljung1999 section 11.2, with exponential
    forgetting.
    """
    gained = covariance @ h
    excited = ca.dot(h, gained)
    lost = excited < 0
    denominator = forgetting * noise + excited
    kept = ca.if_else(
        lost, largest / h.numel() * SX.eye(h.numel()), covariance - gained @ gained.T / denominator
    )
    new = kept / ca.if_else(ca.sumsqr(kept) > largest**2, 1, forgetting)
    return ca.if_else(lost, 0, gained * (error / denominator)), (new + new.T) / 2


def rounding_noise(resolution: SX, cutoff: SX, period: SX) -> SX:
    """Return the variance of L v' by a position that is rounded, L = two sections of gain g, v' its
    second difference.

    With g = 1 - q the impulse response of L on the second difference is g^2 (1, -2 g, .., g q^(k-2)
    (k g - 1 - q), ..) / Ts^2, whose squares add up to g^4 / Ts^4 (1 + g (5 + 4 q + q^2) / (1 +
    q)^3). Source: widrow2008 chapter 1.
    """
    q = ca.exp(-cutoff * period)
    gain = 1 - q
    squares = 1 + gain * (5 + 4 * q + q**2) / (1 + q) ** 3
    return SX(kalman.rounding(resolution) * (gain / period) ** 4 * squares)


def row(p: Namespace, s: Sample, gate: SX) -> tuple[Row, dict[str, SX]]:
    """Return (sample for a companion of step 1, next states of the filters); between two sections
    is the input's derivative.
    """
    r = regression(p, s, gate)
    # one sample back exactly, or shares of one
    input_rate = (r.next["twice2"] - p.twice2) / s.period
    noise = rounding_noise(p.resolution, p.cutoff, s.period)
    h = ca.vertcat(r.h, 1, input_rate)
    rest = Rest(ca.fabs(r.h[0]) > excitation.noise_speed(p), step1.LOAD_ENTRY)
    return Row(
        r.z,
        h,
        r.h[2] * step1.falling(r.h[0], gate),
        r.counts,
        noise,
        2 / (p.cutoff * s.period),
        rest,
    ), r.next


def observe(p: Namespace, s: Sample, kept: SX) -> tuple[Row, dict[str, SX]]:
    """Return (sample, next states of what all methods of step 1 from position share); `kept`: share
    that a sample leaves.
    """
    gate = step1.speed_gate(p, excitation.noise_speed(p))
    sample, filters = row(p, s, gate)
    excited = excitation.advance(p, -sample.h[0], s.period)
    return sample, filters | excited.next | step1.fit(p, sample, gate, kept, s.period)


def fit(p: Namespace, s: Sample) -> dict[str, SX]:
    """Fit the filtered regression by least squares with forgetting."""
    return observe(p, s, ca.exp(-s.period / p.memory))[1]


def estimates(p: Namespace) -> dict[str, SX]:
    """Return alpha2, b and Fc by name."""
    found = step1.COMPANION.narrow(p)
    return {name: found[name] for name in ESTIMATES}


def published(p: Namespace, period: SX) -> dict[str, Any]:
    """Return the fields of an `Update`."""
    return step1.published(p, {}, period)


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    return Update(fit(p, s), **published(p, s.period), signals={"v": p.last_v})


def filter_parameters(
    prefix: str, cutoff: float = 150.0, hold_off: float = 0.027
) -> tuple[Parameter, ...]:
    """Declare the filter under a method's name."""
    return (
        Parameter(
            f"{prefix}.cutoff",
            "a",
            "rad/s",
            cutoff,
            1e-3,
            1e5,
            "corner of each of the two low-pass sections",
            CITATION,
        ),
        Parameter(
            f"{prefix}.hold_off",
            "t_h",
            "s",
            hold_off,
            0.0,
            10.0,
            "wait after low speed (the filters forget it)",
            CITATION,
        ),
    )


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare gate, filter and forgetting under a method's name."""
    return (
        step1.gate_parameter(prefix),
        *filter_parameters(prefix),
        Parameter(
            f"{prefix}.memory",
            "T",
            "s",
            100.0,
            1e-3,
            1e9,
            "time in the fit after which a sample is forgotten",
            CITATION,
        ),
    )


FILTER_STATES = (
    *vector_states("once", "1", "signals after one section", 3),
    *vector_states("twice", "1", "signals after two sections", 3),
    State("last_v", "rad/s", "velocity between the last two samples"),
    State("u_before", "V", "input before the last one"),
    State("clear", "s", "time since the speed last was low"),
    State("seen", "1", "steps done"),
)
STATES = (*FILTER_STATES, *step1.STATES)

METHOD = Method(
    "rls",
    "recursive least squares of alpha2, b, Fc, load and delay from position, gated to high speed",
    "ljung1999 section 11.2",
    "y_theta",
    (kalman.resolution_parameter("rls"), *parameters("rls")),
    STATES,
    _equations,
)
