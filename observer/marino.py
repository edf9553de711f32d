"""Step 1 from position: Marino's observer with a filtered transformation, for order n; here 2.

Output y = x1 of a chain of integrators, x' = A x + Psi(y, u) theta. With the filtered regressors M,
whose first row is zero, s = x - M theta obeys s' = A s + b beta' theta, where b = [1, b2, .., bn]
is Hurwitz and beta' = M2 + Psi1, and
    s^' = A s^ + b beta' theta^ + (A + lambda) b (y - s1^),
    theta^' = Gamma beta (y - s1^),   x^ = s^ + M theta^,
in which y - s1^ answers to beta' (theta - theta^) through 1/(s + lambda).

Bastin and Gevers' observer (3) of the same plant, put into their form (2) by z = x - b y, takes the
same y^ and theta^ with V = M and c1 = lambda, for every n; only their x^ puts the measured y where
this one has its estimate. Source: marino1990; bastin1988 eq. (3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from bristle.model.linear import Elimination
from bristle.model.variables import Parameter, State
from bristle.observer import filtered, kalman, rls, step1
from bristle.observer.bastin_gevers import gamma_parameters, start_parameters
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
CITATION = "marino1990"
Memory = tuple[SX, SX, SX]  # x^, M, theta^


@dataclass(frozen=True)
class Chain:
    """A sampled chain of n integrators: x_k = phi x_(k-1) + .., and the gains b and k at the
    sampling instants.

    An innovation with the gain k puts the poles of the error to those of 1/(s + lambda) and of b; b
    itself is the gain that puts the first of them to zero, so that y - y^ then answers to beta'
    (theta - theta^) through lambda's pole alone.
    """

    phi: SX
    b: SX
    k: SX


def integrators(n: int, period: SX) -> SX:
    """Return exp(A Ts) of a chain of n integrators."""
    rows = [
        [period ** (j - i) / math.factorial(j - i) if j >= i else SX(0) for j in range(n)]
        for i in range(n)
    ]
    return ca.vertcat(*(ca.horzcat(*row) for row in rows))


def innovation_gain(poles: list[SX], period: SX) -> SX:
    """Return K such that the error e_k = (1 - K C) phi e_(k-1) of a chain has the given poles
    (Ackermann's formula).

    Source: astrom1997 chapter 4.
    """
    n = len(poles)
    phi = integrators(n, period)
    polynomial, row, rows = SX.eye(n), phi[0, :], []
    for pole in poles:
        polynomial = polynomial @ (phi - pole * SX.eye(n))
        rows.append(row)
        row = row @ phi
    return polynomial @ Elimination(ca.vertcat(*rows)).solve(SX.eye(n)[:, n - 1])


def chain(n: int, lam: SX, zeros: SX, period: SX) -> Chain:
    """Sample the observer: lambda, and all n - 1 zeros of b at -`zeros`."""
    others = [ca.exp(-zeros * period)] * (n - 1)
    k = innovation_gain([ca.exp(-lam * period), *others], period)
    return Chain(integrators(n, period), innovation_gain([SX(0), *others], period), k)


def advance(c: Chain, memory: Memory, psi: SX, y: SX, gamma: SX) -> Memory:
    """Return x^, M and theta^ a sample later; `psi` is what Psi adds to x over the sample, n x q.

    The gradient is taken at the error that the new theta^ leaves, and x^ goes its way with the new
    theta^. Of the true parameters' distance from theta^ the answer of that error is passive, so
    that no gain is too large. Source: marino1990, in discrete time.
    """
    x, m, theta = memory
    ahead = c.phi @ m + psi
    beta = ahead[0, :].T  # times Ts
    predicted = c.phi @ x + psi @ theta
    error = (y - predicted[0]) / (1 + ca.dot(beta, gamma * beta))
    change = gamma * beta * error
    return predicted + ahead @ change + c.k * error, ahead - c.b @ beta.T, theta + change


def driven(middle: SX, u: SX, sign: SX, h: SX) -> SX:
    """Return what Psi = [[-q, 0, 0], [0, u, -sgn v]] adds to x1 = q, x2 = v + alpha2 q over a
    sample with mean position `middle`.

    Source: marino1990; dixit2008 eq. (23) with q' = v before it.
    """
    return ca.vertcat(
        ca.horzcat(-h * middle, h**2 / 2 * u, -(h**2) / 2 * sign), ca.horzcat(0, h * u, -h * sign)
    )


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run the observer while |v| > vc, with q counted from the gate's opening.

    Speed for the gate and its sign come from position through two low-pass sections. At the gate's
    opening x2 is not known better than that; nothing adapts until the observer has forgotten it.
    Source: marino1990; dixit2008 eq. (23) and the remark on position measurement at the end of
    section III.
    """
    p, h = context.p, s.period
    sample, shared = rls.observe(p, s, step1.kept(s))
    speed, clear = -sample.h[0], shared["clear"]
    runs = clear > 0
    psi = driven((s.y0 + s.y1) / 2 - p.origin, s.u, ca.sign(speed), h)
    c = chain(2, p.lam, p.zero, h)
    c = Chain(c.phi, context.constant("b", c.b), context.constant("k", c.k))
    gamma = ca.if_else(clear > p.hold_off, ca.vertcat(p.gamma1, p.gamma2, p.gamma3), 0)
    theta = stack(p, "theta", 3)
    m = ca.vertcat(SX(1, 3), stack(p, "m", 1, 3))
    x, m, theta_new = advance(c, (stack(p, "x", 2), m, theta), psi, s.y1 - p.origin, gamma)
    return Update(
        next={
            **shared,
            "origin": ca.if_else(runs, p.origin, s.y1),
            **unstack("x", ca.if_else(runs, x, ca.vertcat(0, speed))),
            **unstack("m", ca.if_else(runs, m[1, :], 0)),
            **unstack("theta", ca.if_else(runs, theta_new, theta)),
        },
        **step1.published(p, filtered.estimates(p), h),
        signals={"theta": p.origin + p.x0, "v": p.x1 - p.theta0 * p.x0},
        first={"origin": s.y1},
    )


METHOD = Method(
    "marino",
    "Marino observer of alpha2, b and Fc from position, n = 2, gated to high speed",
    CITATION,
    "y_theta",
    (
        kalman.resolution_parameter("marino"),
        step1.gate_parameter("marino"),
        *rls.filter_parameters("marino", hold_off=0.07),
        Parameter(
            "marino.lam",
            "lambda",
            "1/s",
            100.0,
            1e-3,
            1e4,
            "rate at which the output error decays",
            CITATION,
        ),
        Parameter(
            "marino.zero",
            "b2",
            "1/s",
            200.0,
            1e-3,
            1e4,
            "rate of the filtered transformation",
            CITATION,
        ),
        *gamma_parameters("marino", (4e6, 4e6, 8e6), CITATION),
        *start_parameters("marino", CITATION),
    ),
    (
        *vector_states("x", "1", "state estimate", 2),
        *vector_states("m", "1", "filtered regressor", 3),
        *rls.STATES,
        *filtered.estimate_states(),
        State("origin", "rad", "position from which q counts"),
    ),
    _equations,
)
