"""Approach I, filtered: recursive least squares of all parameters at once from the velocity, without a start."""

from __future__ import annotations

from bristle.observer import swapping
from bristle.observer.method import EquationContext, Method, Sample, Update


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run the filters on the velocity, linear between samples, and on the held input.

    Source: dixit2008 eq. (20)-(22).
    """
    start, end = swapping.signals(s.u, s.y0, context.p.width), swapping.signals(s.u, s.y1, context.p.width)
    return Update(
        next=swapping.step(context, s, start, end),
        estimates=swapping.estimates(context.p),
        valid=swapping.valid(context.p),
    )


METHOD = Method(
    "swapped",
    "filtered Approach I: least squares of eight entries, six of them free, without differentiation",
    "dixit2008 eq. (20)-(22)",
    "y_v",
    swapping.parameters("swapped", 20.0),
    swapping.states(),
    _equations,
)
