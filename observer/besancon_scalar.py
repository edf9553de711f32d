"""Step 2 of Approach II with the printed scalar gain, computed in degrees as the paper plots."""

from __future__ import annotations

import math

import casadi as ca

from bristle.observer import besancon, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX
UNIT = math.pi / 180.0  # the velocity is measured in deg/s, so that b u is in deg/s2 and c in 1/deg
K0 = (100.0, 1000.0)
LAM = 50.0


def step(context: EquationContext, s: Sample, alpha2: SX, b: SX) -> dict[str, SX]:
    """Return the next states, x^ in deg/s and deg/s2; theta^' = lam^n G' C0' (y - C0 x^), no projection.

    Source: dixit2008 eq. (6), with S = lam^(2n) I in the coordinates of zhang.py.
    """
    p = context.p
    x, ups, theta, mean = zhang.read(p, 2)
    degrees = Sample(s.u, s.y0 / UNIT, s.y1 / UNIT, s.period)
    x, ups = besancon.predict(besancon.filter_of(context, s), x, ups, theta, degrees, alpha2, b / UNIT, UNIT)
    new = zhang.gradient(ups, theta, degrees.y1 - x[0], p.lam**4 * SX.ones(4), s.period, low=False)
    return zhang.write(x + ups @ (new - theta), ups, new, mean, SX(1))


def published(context: EquationContext, alpha2: SX) -> tuple[dict[str, SX], dict[str, SX]]:
    """Return (estimates, signals) in SI."""
    p = context.p
    estimates = {name: p[f"raw_{name}"] / (UNIT if name == "c" else 1.0) for name in zhang.ESTIMATES}
    v, w = p.x0 * UNIT, -p.x1 * UNIT
    return estimates, {"v": v, "w": w, "F": w + alpha2 * v}


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    estimates, signals = published(context, p.alpha2)
    return Update(step(context, s, p.alpha2, p.b), estimates, signals, first={"x0": s.y1 / UNIT})


METHOD = Method(
    "besancon_scalar",
    "Besancon-Zhang-Hammouri observer with the printed scalar gain; alpha2 and b known",
    "dixit2008 eq. (6) and section IV-E",
    "y_v",
    (
        *zhang.known_parameters("besancon_scalar"),
        *zhang.gain_parameters("besancon_scalar", K0, LAM, (0.0, 0.0, 0.0, 0.0)),
    ),
    zhang.states(2),
    _equations,
)
