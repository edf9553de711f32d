"""Luders and Narendra's law of step 1 on the regression from an encoder."""

from __future__ import annotations

from bristle.observer import filtered, kalman, luders_narendra, rls, step1
from bristle.observer.method import EquationContext, Method, Sample, Update


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    sample, shared = rls.observe(p, s, step1.kept(s))
    new = shared | luders_narendra.adapt(p, sample, s.period)
    return Update(
        new, **step1.published(p, filtered.estimates(p), s.period), signals={"v": p.last_v}
    )


METHOD = Method(
    "luders_narendra_position",
    "Luders-Narendra observer of alpha2, b and Fc from position, normalised, gated to high speed",
    luders_narendra.CITATION,
    "y_theta",
    (
        kalman.resolution_parameter("luders_narendra_position"),
        step1.gate_parameter("luders_narendra_position"),
        *rls.filter_parameters("luders_narendra_position", cutoff=50.0, hold_off=0.08),
        *luders_narendra.parameters("luders_narendra_position", (4.0, 4.0, 8.0)),
    ),
    (*rls.STATES, *filtered.estimate_states()),
    _equations,
)
