"""Step 1 of Approach II from an encoder: recursive least squares with forgetting on filtered signals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer.method import EquationContext, Method, Sample, Update, stack, unstack, vector_states

SX = ca.SX
CITATION = "ljung1999 section 11.2; dixit2008 eq. (23)"
ESTIMATES = units("alpha2", "b", "Fc")
MIN_SPEED = math.radians(85.0)


@dataclass(frozen=True)
class Regression:
    """A sample of z = h' theta, whether it counts, and the next states of the filters behind it."""

    z: SX
    h: SX
    counts: SX
    next: dict[str, SX]


def regression(p: Namespace, s: Sample, gate: SX) -> Regression:
    """Filter L v' = -alpha2 L v + b L u - Fc L sgn v from position, L = two equal low-pass sections; counts at |L v| > gate.

    Velocity is the difference of two positions, so that it belongs to the middle of a sample; its own difference and
    mean then belong to the sampling instant between, and u enters as the mean of the inputs before and after it. The
    same L on every signal leaves the equation exact. After a passage through low speed nothing counts until the filters
    have forgotten it.

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
    return Regression(two_new[0], h, ca.logic_and(clear > p.hold_off, ready), filters)


def least_squares(covariance: SX, h: SX, error: SX, noise: SX, forgetting: SX, largest: SX) -> tuple[SX, SX]:
    """Return (change of theta, covariance) after a sample of error = h' (true theta - theta) + noise of that variance.

    Nothing is forgotten where that would lift the covariance above `largest`: what a record never excites would grow without
    end. Where rounding has cost the covariance its sign (a jump of the signals by many orders), it starts again.
    Source: ljung1999 section 11.2, with exponential forgetting.
    """
    gained = covariance @ h
    excited = ca.dot(h, gained)
    lost = excited < 0
    denominator = forgetting * noise + excited
    kept = ca.if_else(lost, largest / h.numel() * SX.eye(h.numel()), covariance - gained @ gained.T / denominator)
    new = kept / ca.if_else(ca.sumsqr(kept) > largest**2, 1, forgetting)
    return ca.if_else(lost, 0, gained * (error / denominator)), (new + new.T) / 2


def fit(p: Namespace, s: Sample) -> dict[str, SX]:
    """Fit the filtered regression by recursive least squares."""
    r = regression(p, s, p.vc)
    theta, covariance = stack(p, "theta", 3), stack(p, "p", 3, 3)
    change, covariance_new = least_squares(covariance, r.h, r.z - ca.dot(r.h, theta), SX(1), p.forgetting, 3 * p.p_start)
    return {
        **r.next,
        **unstack("theta", ca.if_else(r.counts, theta + change, theta)),
        **unstack("p", ca.if_else(r.counts, covariance_new, covariance)),
    }


def estimates(p: Namespace) -> dict[str, SX]:
    """Return the estimates by name."""
    return {name: p[f"theta{i}"] for i, name in enumerate(ESTIMATES)}


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    return Update(fit(p, s), estimates(p), {"v": p.last_v})


def _covariance(row: int, column: int) -> State:
    start = (lambda p: p.p_start) if row == column else 0.0
    return State(f"p{3 * row + column}", "1", "covariance of the estimates", initial=start)


def gate_parameter(prefix: str) -> Parameter:
    """Declare the gate under a method's name."""
    return Parameter(f"{prefix}.vc", "vc", "rad/s", MIN_SPEED, 0.0, 1e3, "speed above which the fit runs", CITATION)


def filter_parameters(prefix: str, cutoff: float = 150.0, hold_off: float = 0.027) -> tuple[Parameter, ...]:
    """Declare the filter under a method's name."""
    return (
        Parameter(f"{prefix}.cutoff", "a", "rad/s", cutoff, 1e-3, 1e5, "corner of each of the two low-pass sections", CITATION),
        Parameter(f"{prefix}.hold_off", "t_h", "s", hold_off, 0.0, 10.0, "wait after low speed (the filters forget it)", CITATION),
    )


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare gate, filter and forgetting under a method's name."""
    return (
        gate_parameter(prefix),
        *filter_parameters(prefix),
        Parameter(f"{prefix}.forgetting", "mu", "1", 0.99999, 0.5, 1.0, "forgetting factor a sample", CITATION),
        Parameter(f"{prefix}.p_start", "P0", "1", 1e4, 1e-9, 1e12, "start of the covariance (of each estimate)", CITATION),
    )


FILTER_STATES = (
    *vector_states("once", "1", "signals after one section", 3),
    *vector_states("twice", "1", "signals after two sections", 3),
    State("last_v", "rad/s", "velocity between the last two samples"),
    State("u_before", "V", "input before the last one"),
    State("clear", "s", "time since the speed last was low"),
    State("seen", "1", "steps done"),
)
STATES = (
    *FILTER_STATES,
    *(State(f"theta{i}", unit, f"estimate of {name}") for i, (name, unit) in enumerate(ESTIMATES.items())),
    *(_covariance(row, column) for row in range(3) for column in range(3)),
)

METHOD = Method(
    "rls",
    "recursive least squares of alpha2, b and Fc from position, gated to high speed",
    "ljung1999 section 11.2",
    "y_theta",
    parameters("rls"),
    STATES,
    _equations,
)
