"""Kreisselmeier's law of step 1 on the regression from an encoder."""

from __future__ import annotations

from bristle.observer import kalman, kreisselmeier, rls, step1
from bristle.observer.method import EquationContext, Method, Sample, Update


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    sample, shared = rls.observe(p, s, kreisselmeier.kept(p, s))
    new = shared | kreisselmeier.adapt(p, sample, step1.left(p, shared), s.period)
    return Update(
        new, **step1.published(p, kreisselmeier.estimates(p), s.period), signals={"v": p.last_v}
    )


METHOD = Method(
    "kreisselmeier_position",
    "Kreisselmeier observer of alpha2, b and Fc from position, gated to high speed",
    kreisselmeier.CITATION,
    "y_theta",
    (
        kalman.resolution_parameter("kreisselmeier_position"),
        step1.gate_parameter("kreisselmeier_position"),
        *rls.filter_parameters("kreisselmeier_position"),
        *kreisselmeier.parameters("kreisselmeier_position"),
    ),
    (*rls.STATES, *kreisselmeier.STATES),
    _equations,
)
