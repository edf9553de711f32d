"""Kreisselmeier's law of step 1 on the regression from an encoder."""

from __future__ import annotations

from bristle.observer import extension, filtered, kreisselmeier, rls
from bristle.observer.method import EquationContext, Method, Sample, Update


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    new = kreisselmeier.adapt(p, rls.regression(p, s, p.vc), s.period)
    return Update(new, rls.estimates(p), {"v": p.last_v})


METHOD = Method(
    "kreisselmeier_position",
    "Kreisselmeier observer of alpha2, b and Fc from position, gated to high speed",
    kreisselmeier.CITATION,
    "y_theta",
    (
        rls.gate_parameter("kreisselmeier_position"),
        *rls.filter_parameters("kreisselmeier_position"),
        *kreisselmeier.parameters("kreisselmeier_position"),
    ),
    (*rls.FILTER_STATES, *extension.states(3), *filtered.estimate_states()),
    _equations,
)
