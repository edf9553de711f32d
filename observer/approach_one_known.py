"""Approach I as printed with alpha2 and b known; it fails for the same reason as `approach_one`."""

from __future__ import annotations

from bristle.observer import approach_one, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update


def _equations(context: EquationContext, s: Sample) -> Update:
    return approach_one.update(context, s, approach_one.FOUR)


METHOD = Method(
    "approach_one_known",
    "Approach I with Levant's differentiators and Zhang's observer, alpha2 and b known (fails as"
    " approach_one does)",
    "dixit2008 eq. (19)-(22) and section III, Approach II",
    "y_v",
    (*zhang.known_parameters("approach_one_known"), *approach_one.parameters("approach_one_known")),
    approach_one.states(approach_one.FOUR),
    _equations,
)
