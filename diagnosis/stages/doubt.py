"""Whether what was found is in doubt: it is suspected then, and not named."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from bristle.diagnosis.answer import LEAST_FALL, Diagnosis, Finding, Reason, finding
from bristle.diagnosis.stages.case import Budget, SearchedCase
from bristle.plant.effects import effect as find_effect

# share of the residual in a view, unexplained, from which on what was found may stand in for it
LARGE_REST = 0.3


def suspected(case: SearchedCase, answer: Diagnosis, _: Budget) -> Diagnosis:
    """Return an answer whose effects are suspects if there is a doubt about them."""
    doubts = tuple(_doubts(answer)) if answer.effects and not answer.corrections else ()
    if not doubts:
        return answer
    names = tuple(e.name for e in answer.effects)
    return replace(
        answer,
        verdict="not_identifiable",
        effects=(),
        suspects=answer.effects,
        doubts=doubts,
        hindrance=finding(Reason.SUSPECTED, effects=names, doubts=doubts),
    )


def _doubts(answer: Diagnosis) -> Iterator[Finding]:
    """Give the reasons to doubt the effects of an answer."""
    if unknown := tuple(e.name for e in answer.effects if not e.known):
        yield finding(Reason.DOUBT_STRENGTH, effects=unknown)
    # friction of which the records show none may end at 0
    if stuck := tuple(k for k, e in answer.parameters.items() if e.at_bound and e.value):
        yield finding(Reason.DOUBT_BOUND, parameters=stuck)
    if LEAST_FALL * answer.gap.after > answer.gap.before and _acts_throughout(answer):
        yield finding(Reason.DOUBT_ERROR)
    if answer.whole is not None and answer.whole.worse_throughout:
        yield finding(Reason.DOUBT_WHOLE)
    if answer.remains.flag and answer.remains.share >= LARGE_REST:
        yield finding(Reason.DOUBT_REST, share=answer.remains.share)


def _acts_throughout(answer: Diagnosis) -> bool:
    """Return whether all effects of an answer act in every segment, and lead to no impacts."""
    effects = [find_effect(e.name) for e in answer.effects]
    return not any(e.sparse or e.free_play for e in effects)
