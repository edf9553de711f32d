"""Step 2 of Approach II: Besancon-Zhang-Hammouri's observer on velocity with a matrix gain."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace
from bristle.observer import step2, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX
K0 = (2.0, 1.0)
LAM = 50.0
START_VALUES = (300.0, 300.0, 300.0, 100.0)  # round numbers, not taken from a plant


def filter_of(context: EquationContext, s: Sample) -> zhang.Filter:
    """Compute the exact second-order filter from the gains k1, k2 and lam."""
    p = context.p
    return zhang.make_filter(context, ca.vertcat(p.k1, p.k2), p.lam, s.period)


def predict(
    f: zhang.Filter, memory: zhang.Memory, s: Sample, alpha2: SX, b: SX, phi: zhang.Basis
) -> tuple[SX, SX]:
    """Advance x^ = (v^, -w^) and Ups a sample for x1' = x2 - alpha2 v + b u, x2' = psi theta.

    v is the measured velocity, linear between samples, u is held. The term c |v| x2 of psi at the
    end of the sample holds the unknown x2; being linear in it, it is solved for.

    Source: dixit2008 section IV-E; zhang.py for the filter.
    """
    x, ups, theta = memory
    entries = slice(theta.numel())
    psi0 = zhang.regressor(s.y0, x[1], phi)[:, entries]
    psi1 = zhang.regressor(s.y1, SX(0), phi)[:, entries]
    f0 = ca.vertcat(-alpha2 * s.y0 + b * s.u, psi0 @ theta) + f.k * s.y0
    f1 = ca.vertcat(-alpha2 * s.y1 + b * s.u, psi1 @ theta) + f.k * s.y1
    x_new = zhang.ahead(f, x, f0, f1, ca.fabs(s.y1) * theta[3])
    psi1 = zhang.regressor(s.y1, x_new[1], phi)[:, entries]
    return x_new, f.phi @ ups + f.m0[:, 1] @ psi0 + f.m1[:, 1] @ psi1


def step(context: EquationContext, s: Sample, f: zhang.Filter, alpha2: SX, b: SX) -> dict[str, SX]:
    """Return the next states of the matrix-gain observer with the given alpha2 and b."""
    p = context.p
    x, ups, theta, mean = zhang.read(p, 2)
    x, ups = predict(f, (x, ups, theta), s, alpha2, b, zhang.basis(p))
    new = zhang.gradient(ups, theta, s.y1 - x[0], zhang.matrix_gain(p), s.period, low=True)
    return zhang.write(x + ups @ (new - theta), ups, new, mean, zhang.averaging_weight(p, s.period))


def published(p: Namespace, alpha2: SX) -> tuple[dict[str, SX], dict[str, SX]]:
    """Return (estimates, signals): the averaged parameters, and the present state estimates."""
    return zhang.estimates(p, "mean"), {"v": p.x0, "w": -p.x1, "F": -p.x1 + alpha2 * p.x0}


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    estimates, signals = published(p, p.alpha2)
    beside, fields = step2.alone(context, s, estimates, step2.from_velocity(s))
    return Update(
        step(context, s, filter_of(context, s), p.alpha2, p.b) | beside,
        **fields,
        signals=signals,
        first={"x0": s.y1},
    )


METHOD = Method(
    "besancon",
    "Besancon-Zhang-Hammouri observer with a matrix gain; alpha2 and b known",
    "besancon2004 eq. (6) with the gain of zhang2002",
    "y_v",
    (
        *zhang.known_parameters("besancon"),
        *zhang.gain_parameters("besancon", K0, LAM, START_VALUES),
        *zhang.matrix_parameters("besancon"),
    ),
    (*zhang.states(2), *step2.COMPANION_STATES),
    _equations,
)
