"""Approach I, filtered, with alpha2 and b known: recursive least squares of the four entries that are left, from velocity."""

from __future__ import annotations

from bristle.observer import swapping, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run the filters on the velocity, linear between samples, and on the held input.

    Source: dixit2008 eq. (20)-(22) with the parameters of step 1 known, as section III, Approach II allows.
    """
    p = context.p
    start, end = swapping.signals(s.u, s.y0, p.width), swapping.signals(s.u, s.y1, p.width)
    return Update(
        next=swapping.step(context, s, start, end, swapping.Known(p.alpha2, p.b)),
        estimates=swapping.estimates(p, zhang.ESTIMATES),
        valid=swapping.valid(p, zhang.ESTIMATES),
    )


METHOD = Method(
    "swapped_known",
    "filtered Approach I with alpha2 and b known: least squares of four entries without differentiation",
    "dixit2008 eq. (20)-(22)",
    "y_v",
    (*zhang.known_parameters("swapped_known"), *swapping.parameters("swapped_known", 20.0)),
    swapping.states(zhang.ESTIMATES, swapping.KNOWN_ROW),
    _equations,
)
