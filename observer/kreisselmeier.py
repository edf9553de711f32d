"""Step 1 with Kreisselmeier's adaptation, whose gradient is that of all past errors, with
exponential forgetting.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import extension, filtered, information, step1
from bristle.observer.bastin_gevers import start_parameters
from bristle.observer.companion import Row
from bristle.observer.method import EquationContext, Method, Sample, Update, stack, unstack

SX = ca.SX
CITATION = "kreisselmeier1977"
ENTRIES = step1.COMPANION.count  # alpha2, b, Fc, load and -b d, d the delay
STATES = (
    *extension.states(ENTRIES),
    *filtered.estimate_states(),
    State("theta3", "rad/s2", "estimate of the load torque over inertia"),
    State("theta4", "rad/(s.V)", "estimate of -b d, d the delay"),
)


def kept(p: Namespace, s: Sample) -> SX:
    """Return the share that a sample leaves of what was known."""
    return SX(ca.exp(-p.fading * s.period))


def adapt(p: Namespace, r: Row, left: SX, period: SX) -> dict[str, SX]:
    """Advance theta' = -g (Phi theta - Y) over a sample by an implicit step, stable at any gain.

    `left`: share of Phi and Y that counts still.

    Phi is positive semidefinite, so that 1 + Ts g Phi needs no pivoting, and none of its pivots is
    lost to rounding. Source: kreisselmeier1977.
    """
    theta = stack(p, "theta", ENTRIES)
    phi, y = extension.extend(p, r.h, r.z, period, left)
    gain = period * p.gain
    change = information.Factors(SX.eye(ENTRIES) + gain * phi).solve(gain * (y - phi @ theta))
    before = {**extension.write(*extension.read(p, ENTRIES)), **unstack("theta", theta)}
    after = {**extension.write(phi, y), **unstack("theta", theta + change)}
    return {name: ca.if_else(r.counts, after[name], before[name]) for name in after}


def estimates(p: Namespace) -> dict[str, SX]:
    """Return the estimates by name."""
    return {name: p[f"theta{i}"] for i, name in enumerate(step1.COMPANION.names)}


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare forgetting, gain and starts under a method's name."""
    return (
        extension.parameter(prefix, 0.02),
        Parameter(f"{prefix}.gain", "g", "1", 10.0, 0.0, 1e12, "adaptation gain", CITATION),
        *start_parameters(prefix, CITATION),
    )


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    sample, shared = filtered.observe(p, s, kept(p, s))
    signals = {"v": filtered.velocity(p, stack(p, "theta", 3))}
    new = shared | adapt(p, sample, step1.left(p, shared), s.period)
    return Update(new, **step1.published(p, estimates(p), s.period), signals=signals)


METHOD = Method(
    "kreisselmeier",
    "Kreisselmeier observer of alpha2, b and Fc, gated to high speed",
    CITATION,
    "y_v",
    (*filtered.parameters("kreisselmeier", 20.0), *parameters("kreisselmeier")),
    (*filtered.STATES, *STATES),
    _equations,
)
