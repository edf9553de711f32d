"""Approach I for an input that is piecewise linear: its derivative is exact, and v the only output
that is measured.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter, State
from bristle.observer import besancon, information, zhang
from bristle.observer.approach_one import ALL, Entries, adapt, gain_parameters, regressor
from bristle.observer.method import (
    EquationContext,
    Method,
    Sample,
    Update,
    never_valid,
    stack,
    unstack,
    vector_states,
)

SX = ca.SX
MAX_REGRESSOR_ACCELERATION = 1e3  # rad/s2; larger estimates of v' are not used in the regressor


def update(context: EquationContext, s: Sample, entries: Entries) -> Update:
    """Run the observer (6) with n = 2 on x1 = v, x2 = v' over the sample before the last.

    Of that one both ends of u are known, and with them u' by linear interpolation. The terms of G
    in x2 at its end are solved for, as in the observer of step 2. Source: dixit2008 eq. (6) and
    (19)-(22), the second option of Approach I; besancon2004.
    """
    p = context.p
    f = besancon.filter_of(context, s)
    du = (s.u - p.u_before) / s.period
    x, upsilon = stack(p, "x", 2), stack(p, "upsilon", 2, len(entries.names))
    theta = entries.read(p)

    def row(v: SX, dv: SX, u: SX) -> tuple[SX, SX]:
        return entries.split(p, regressor(v, dv, u, du, p.width))

    g0, push0 = row(p.y_before, _limited(x[1]), p.u_before)
    g1, push1 = row(s.y0, SX(0), s.u)
    alpha2 = p.alpha2 if entries.known else theta[0]
    rate = ca.fmax(alpha2 + ca.fabs(s.y0) * theta[-1], 0)  # whose step never divides by zero
    start = ca.vertcat(0, g0 @ theta + push0) + f.k * p.y_before
    end = ca.vertcat(0, g1 @ theta + push1) + f.k * s.y0
    x = zhang.ahead(f, x, start, end, rate)
    upsilon = f.phi @ upsilon + f.m0[:, 1] @ g0 + f.m1[:, 1] @ row(s.y0, _limited(x[1]), s.u)[0]
    theta_new, r = adapt(p, entries, upsilon[0, :].T, s.y0 - x[0], s.period)
    ready = p.seen > 0  # the first sample has none before it
    moved = {
        **unstack("x", x + upsilon @ (theta_new - theta)),
        **unstack("upsilon", upsilon),
        **information.write(r),
        **entries.write(theta_new),
    }
    return Update(
        next={name: ca.if_else(ready, value, p[name]) for name, value in moved.items()}
        | {
            "x0": ca.if_else(ready, moved["x0"], s.y0),
            "y_before": s.y0,
            "u_before": s.u,
            "seen": SX(1),
        },
        estimates=entries.estimates(p),
        **never_valid(entries.published),  # what it needs of the input is not seen in its signals
        signals={"v": p.x0},
    )


def _equations(context: EquationContext, s: Sample) -> Update:
    return update(context, s, ALL)


def _limited(dv: SX) -> SX:
    return ca.fmin(ca.fmax(dv, -MAX_REGRESSOR_ACCELERATION), MAX_REGRESSOR_ACCELERATION)


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare filter and gain under a method's name."""
    return (
        *(
            Parameter(
                f"{prefix}.k{i}", f"K0[{i}]", "1", k, 0.0, 1e6, f"filter gain {i}", zhang.CITATION
            )
            for i, k in enumerate(besancon.K0, start=1)
        ),
        Parameter(
            f"{prefix}.lam", "lambda", "1/s", 100.0, 1e-3, 1e4, "filter bandwidth", zhang.CITATION
        ),
        *gain_parameters(prefix, 1.0),
    )


def states(entries: Entries) -> tuple[State, ...]:
    """Declare filter, entries and the sample before the last."""
    return (
        *vector_states("x", "1", "state estimate", 2),
        *vector_states("upsilon", "1", "filtered regressor", 2 * len(entries.names)),
        *entries.states(),
        State("u_before", "V", "input before the last one"),
        State("y_before", "rad/s", "velocity before the last one"),
        State("seen", "1", "1 after the first step"),
    )


METHOD = Method(
    "approach_one_smooth",
    "Approach I for a piecewise linear input: Besancon-Zhang-Hammouri observer of all eight"
    " entries",
    "dixit2008 eq. (6) and (19)-(22)",
    "y_v",
    parameters("approach_one_smooth"),
    states(ALL),
    _equations,
)
