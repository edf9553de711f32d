"""Step 2 of Approach II with the printed scalar gain, computed in degrees as the paper plots."""

from __future__ import annotations

import math

import casadi as ca

from bristle.model.basis import gaussian
from bristle.model.variables import Namespace, Parameter
from bristle.observer import besancon, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update, never_valid

SX = ca.SX
UNIT = math.pi / 180.0  # the velocity is measured in deg/s, so that b u is in deg/s2 and c in 1/deg
K0 = (100.0, 1000.0)
LAM = 50.0
# deg/s, deg/s2 or the unit of a parameter; where the explicit step diverges, it ends there
LARGEST_STATE = 1e12


def step(context: EquationContext, s: Sample, alpha2: SX, b: SX) -> dict[str, SX]:
    """Return the next states, x^ in deg/s and deg/s2; theta^' = lam^n G' C0' (y - C0 x^), no
    projection.

    The step is implicit, which no gain makes unstable, or that of Euler's rule, which diverges
    where one sample adapts too much. Source: dixit2008 eq. (6), with S = lam^(2n) I in the
    coordinates of zhang.py.
    """
    p = context.p
    x, ups, theta, mean = zhang.read(p, 2, zhang.ESTIMATES)
    degrees = Sample(s.u, s.y0 / UNIT, s.y1 / UNIT, s.period)
    f, gain = besancon.filter_of(context, s), p.lam**4 * SX.ones(4)
    x, ups = besancon.predict(f, (x, ups, theta), degrees, alpha2, b / UNIT, _basis(p))
    error = degrees.y1 - x[0]
    implicit = zhang.gradient(ups, theta, error, gain, s.period, low=False)
    new = ca.if_else(p.implicit > 0, implicit, theta + s.period * gain * ups[0, :].T * error)
    x, new = (
        ca.fmin(ca.fmax(each, -LARGEST_STATE), LARGEST_STATE)
        for each in (x + ups @ (new - theta), new)
    )
    return zhang.write(x, ups, new, mean, SX(1))


def _basis(p: Namespace) -> zhang.Basis:
    """Return the basis functions of a velocity in deg/s, with |v| or with v as printed."""
    return lambda v: gaussian(v * UNIT / p.width, even=p.even)


def printed_parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare what may be as printed or repaired."""
    even = "1: |v| in the basis functions; 0: v as printed, which is not even"
    implicit = "1: implicit step of the gradient; 0: that of Euler's rule, which diverges"
    return (
        Parameter(f"{prefix}.even", "|v|", "1", 1.0, 0.0, 1.0, even, "dixit2008 eq. (24)"),
        Parameter(f"{prefix}.implicit", "i", "1", 1.0, 0.0, 1.0, implicit, "dixit2008 eq. (6)"),
    )


def published(context: EquationContext, alpha2: SX) -> tuple[dict[str, SX], dict[str, SX]]:
    """Return (estimates, signals) in SI."""
    p = context.p
    estimates = {
        name: p[f"raw_{name}"] / (UNIT if name == "c" else 1.0) for name in zhang.ESTIMATES
    }
    v, w = p.x0 * UNIT, -p.x1 * UNIT
    return estimates, {"v": v, "w": w, "F": w + alpha2 * v}


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    estimates, signals = published(context, p.alpha2)
    return Update(
        step(context, s, p.alpha2, p.b),
        estimates,
        signals,
        first={"x0": s.y1 / UNIT},
        **never_valid(estimates),
    )


METHOD = Method(
    "besancon_scalar",
    "Besancon-Zhang-Hammouri observer with the printed scalar gain; alpha2 and b known",
    "dixit2008 eq. (6) and section IV-E",
    "y_v",
    (
        *zhang.known_parameters("besancon_scalar"),
        *zhang.gain_parameters("besancon_scalar", K0, LAM, (0.0, 0.0, 0.0, 0.0)),
        *printed_parameters("besancon_scalar"),
    ),
    zhang.states(2, zhang.ESTIMATES),
    _equations,
)
