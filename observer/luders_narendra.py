"""Step 1 with filtered signals and a normalised gradient, after Luders and Narendra."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter
from bristle.observer import filtered, step1
from bristle.observer.bastin_gevers import gamma_parameters, start_parameters
from bristle.observer.companion import Row
from bristle.observer.method import EquationContext, Method, Sample, Update, stack, unstack

SX = ca.SX
CITATION = "luders1973"


def adapt(p: Namespace, r: Row, period: SX) -> dict[str, SX]:
    """Advance theta' = Gamma F (z - F' theta) over a sample by an implicit step, stable at any
    gain.

    As printed (a plant in the form of Bastin and Gevers, whose regressor is filtered by the other n
    - 1 states), the observer is Bastin and Gevers' for n = 1, where nothing is left to filter; here
    the whole equation is filtered. Source: luders1973.
    """
    theta = stack(p, "theta", 3)
    h = r.h[:3]
    step = period * ca.vertcat(p.gamma1, p.gamma2, p.gamma3) * h
    new = theta + step * ((r.z - ca.dot(h, theta)) / (1 + ca.dot(h, step)))
    return unstack("theta", ca.if_else(r.counts, new, theta))


def parameters(prefix: str, gains: tuple[float, float, float]) -> tuple[Parameter, ...]:
    """Declare gains and starts under a method's name."""
    return (*gamma_parameters(prefix, gains, CITATION), *start_parameters(prefix, CITATION))


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    sample, shared = filtered.observe(p, s, step1.kept(s))
    signals = {"v": filtered.velocity(p, stack(p, "theta", 3))}
    return Update(
        shared | adapt(p, sample, s.period),
        **step1.published(p, filtered.estimates(p), s.period),
        signals=signals,
    )


METHOD = Method(
    "luders_narendra",
    "Luders-Narendra observer of alpha2, b and Fc on filtered signals, normalised, gated to high"
    " speed",
    CITATION,
    "y_v",
    (
        *filtered.parameters("luders_narendra", 50.0),
        *parameters("luders_narendra", (100.0, 100.0, 200.0)),
    ),
    (*filtered.STATES, *filtered.estimate_states()),
    _equations,
)
