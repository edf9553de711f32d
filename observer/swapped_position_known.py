"""Approach I, filtered, from an encoder, with alpha2 and b known."""

from __future__ import annotations

from bristle.observer import swapped_position, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update
from bristle.observer.swapping import Prior


def _equations(context: EquationContext, s: Sample) -> Update:
    """Fit as `swapped_position` does, with alpha2 and b held.

    Source: dixit2008 eq. (20)-(22) with the parameters of step 1 known, and the remark on position
    measurement.
    """
    return swapped_position.update(
        context, s, zhang.ESTIMATES, Prior(context.p.alpha2, context.p.b)
    )


METHOD = Method(
    "swapped_position_known",
    "filtered Approach I from position with alpha2 and b known: least squares on smoothed"
    " differences",
    "dixit2008 eq. (20)-(22)",
    "y_theta",
    (
        *zhang.known_parameters("swapped_position_known"),
        *swapped_position.parameters("swapped_position_known"),
    ),
    swapped_position.STATES,
    _equations,
)
