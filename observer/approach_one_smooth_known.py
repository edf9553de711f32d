"""Approach I for an input that is piecewise linear, with alpha2 and b known."""

from __future__ import annotations

from bristle.observer import approach_one_smooth, zhang
from bristle.observer.approach_one import FOUR
from bristle.observer.method import EquationContext, Method, Sample, Update


def _equations(context: EquationContext, s: Sample) -> Update:
    return approach_one_smooth.update(context, s, FOUR)


METHOD = Method(
    "approach_one_smooth_known",
    "Approach I for a piecewise linear input with alpha2 and b known: Besancon-Zhang-Hammouri"
    " observer of four entries",
    "dixit2008 eq. (6), (19)-(22) and section III, Approach II",
    "y_v",
    (
        *zhang.known_parameters("approach_one_smooth_known"),
        *approach_one_smooth.parameters("approach_one_smooth_known"),
    ),
    approach_one_smooth.states(FOUR),
    _equations,
)
