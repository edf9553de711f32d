"""Approach I, filtered, with alpha2 and b known: recursive least squares of what is left, from
velocity.
"""

from __future__ import annotations

from bristle.observer import swapped, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update
from bristle.observer.swapping import Prior


def _equations(context: EquationContext, s: Sample) -> Update:
    """Fit as `swapped` does, with alpha2 and b held.

    Source: dixit2008 eq. (20)-(22) with the parameters of step 1 known, as section III, Approach II
    allows.
    """
    return swapped.update(context, s, zhang.ESTIMATES, Prior(context.p.alpha2, context.p.b))


METHOD = Method(
    "swapped_known",
    "filtered Approach I with alpha2 and b known: least squares without differentiation",
    "dixit2008 eq. (20)-(22)",
    "y_v",
    (*zhang.known_parameters("swapped_known"), *swapped.parameters("swapped_known")),
    swapped.STATES,
    _equations,
)
