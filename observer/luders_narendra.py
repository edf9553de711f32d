"""Step 1 with filtered signals and a normalised gradient, after Luders and Narendra."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter
from bristle.observer import filtered, rls
from bristle.observer.bastin_gevers import gamma_parameters, start_parameters
from bristle.observer.method import EquationContext, Method, Sample, Update, stack, unstack
from bristle.observer.rls import Regression

SX = ca.SX
CITATION = "luders1973"


def adapt(p: Namespace, r: Regression, period: SX) -> dict[str, SX]:
    """Advance theta' = Gamma F (z - F' theta) over a sample by an implicit step, stable at any gain.

    As printed (a plant in the form of Bastin and Gevers, whose regressor is filtered by the other n - 1 states), the
    observer is Bastin and Gevers' for n = 1, where nothing is left to filter; here the whole equation is filtered.
    Source: luders1973.
    """
    theta = stack(p, "theta", 3)
    step = period * ca.vertcat(p.gamma1, p.gamma2, p.gamma3) * r.h
    new = theta + step * ((r.z - ca.dot(r.h, theta)) / (1 + ca.dot(r.h, step)))
    return {**r.next, **unstack("theta", ca.if_else(r.counts, new, theta))}


def parameters(prefix: str, gains: tuple[float, float, float]) -> tuple[Parameter, ...]:
    """Declare gains and starts under a method's name."""
    return (*gamma_parameters(prefix, gains, CITATION), *start_parameters(prefix, CITATION))


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    new = adapt(p, filtered.regression(p, s), s.period)
    return Update(new, rls.estimates(p), {"v": filtered.velocity(p, stack(p, "theta", 3))})


METHOD = Method(
    "luders_narendra",
    "Luders-Narendra observer of alpha2, b and Fc on filtered signals, normalised, gated to high speed",
    CITATION,
    "y_v",
    (*filtered.parameters("luders_narendra", 50.0), *parameters("luders_narendra", (100.0, 100.0, 200.0))),
    (*filtered.STATES, *filtered.estimate_states()),
    _equations,
)
