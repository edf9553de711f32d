"""Step 1 of Approach II from an encoder: recursive least squares with forgetting on filtered signals."""

from __future__ import annotations

import math

import casadi as ca

from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer.method import Method, Sample, Update, Workshop, stack, unstack, vector_states

SX = ca.SX
EQUATION = "ljung1999 section 11.2; dixit2008 eq. (23)"
NAMES = units("alpha2", "b", "Fc")


def fit(p: Namespace, s: Sample) -> dict[str, SX]:
    """Fit L v' = -alpha2 L v + b L u - Fc L sgn v while |L v| > vc, L = two equal low-pass sections.

    Velocity is the difference of two positions, so that it belongs to the middle of a sample; its own difference and
    mean then belong to the sampling instant between, and u enters as the mean of the inputs before and after it. The
    same L on every signal leaves the equation exact. After a passage through low speed the fit waits until the filters
    have forgotten it.

    Source: ljung1999 section 11.2, with exponential forgetting; dixit2008 eq. (23).
    """
    v = (s.y1 - s.y0) / s.period
    raw = ca.vertcat((v - p.last_v) / s.period, -(v + p.last_v) / 2, (s.u + p.u_before) / 2)
    gain = 1 - ca.exp(-p.cutoff * s.period)
    one = stack(p, "once", 3)
    two = stack(p, "twice", 3)
    one_new = one + gain * (raw - one)
    two_new = two + gain * (one_new - two)
    speed = -two_new[1]
    clear = ca.if_else(ca.fabs(speed) > p.vc, p.clear + s.period, 0)
    fits = ca.logic_and(clear > p.hold_off, p.seen >= 1)
    theta, covariance = stack(p, "theta", 3), stack(p, "p", 3, 3)
    h = ca.vertcat(two_new[1], two_new[2], -ca.sign(speed))
    gained = covariance @ h
    denominator = p.forgetting + ca.dot(h, gained)
    theta_new = theta + gained * ((two_new[0] - ca.dot(h, theta)) / denominator)
    covariance_new = (covariance - gained @ gained.T / denominator) / p.forgetting
    covariance_new = (covariance_new + covariance_new.T) / 2
    ready = p.seen >= 1  # the first difference of velocities needs three positions
    return {
        **unstack("once", ca.if_else(ready, one_new, one)),
        **unstack("twice", ca.if_else(ready, two_new, two)),
        **unstack("theta", ca.if_else(fits, theta_new, theta)),
        **unstack("p", ca.if_else(fits, covariance_new, covariance)),
        "last_v": v,
        "u_before": s.u,
        "clear": ca.if_else(ready, clear, 0),
        "seen": p.seen + 1,
    }


def estimates(p: Namespace) -> dict[str, SX]:
    """Return the estimates by name."""
    return {name: p[f"theta{i}"] for i, name in enumerate(NAMES)}


def _equations(shop: Workshop, s: Sample) -> Update:
    p = shop.p
    return Update(fit(p, s), estimates(p), {"v": p.last_v})


def _covariance(row: int, column: int) -> State:
    start = (lambda p: p.p_start) if row == column else 0.0
    return State(f"p{3 * row + column}", "1", "covariance of the estimates", initial=start)


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare gate, filter and forgetting under a method's name."""
    return (
        Parameter(f"{prefix}.vc", "vc", "rad/s", 85.0 * math.pi / 180.0, 0.0, 1e3, "speed above which the fit runs", EQUATION),
        Parameter(f"{prefix}.cutoff", "a", "rad/s", 150.0, 1e-3, 1e5, "corner of each of the two low-pass sections", EQUATION),
        Parameter(f"{prefix}.hold_off", "t_h", "s", 0.027, 0.0, 10.0, "wait after low speed (the filters forget it)", EQUATION),
        Parameter(f"{prefix}.forgetting", "mu", "1", 0.99999, 0.5, 1.0, "forgetting factor a sample", EQUATION),
        Parameter(f"{prefix}.p_start", "P0", "1", 1e4, 1e-9, 1e12, "start of the covariance (of each estimate)", EQUATION),
    )


STATES = (
    *vector_states("once", "1", "signals after one section", 3),
    *vector_states("twice", "1", "signals after two sections", 3),
    *(State(f"theta{i}", unit, f"estimate of {name}") for i, (name, unit) in enumerate(NAMES.items())),
    *(_covariance(row, column) for row in range(3) for column in range(3)),
    State("last_v", "rad/s", "velocity between the last two samples"),
    State("u_before", "V", "input before the last one"),
    State("clear", "s", "time since the speed last was low"),
    State("seen", "1", "steps done"),
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
