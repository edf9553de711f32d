"""Approach I, filtered, from an encoder, with alpha2 and b known."""

from __future__ import annotations

from bristle.observer import swapped_position, swapping, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update


def _equations(context: EquationContext, s: Sample) -> Update:
    """Smooth as `swapped_position` does, then fit as `swapped_known` does.

    Source: dixit2008 eq. (20)-(22) with the parameters of step 1 known, and the remark on position measurement.
    """
    p = context.p
    start, end, filters = swapped_position.smoothed(p, s)
    return Update(
        next=swapping.step(context, s, start, end, swapping.Known(p.alpha2, p.b)) | filters,
        estimates=swapping.estimates(p, zhang.ESTIMATES),
        signals={"v": p.twice1},
        valid=swapping.valid(p, zhang.ESTIMATES),
    )


METHOD = Method(
    "swapped_position_known",
    "filtered Approach I from position with alpha2 and b known: least squares of four entries on smoothed differences",
    "dixit2008 eq. (20)-(22)",
    "y_theta",
    (*zhang.known_parameters("swapped_position_known"), *swapped_position.parameters("swapped_position_known")),
    (*swapping.states(zhang.ESTIMATES, swapping.KNOWN_ROW), *swapped_position.FILTER_STATES),
    _equations,
)
