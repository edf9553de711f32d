"""Whether what was found is in doubt: it is suspected then, and not named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from bristle.common.table import Array
from bristle.diagnosis.answer import LEAST_FALL, Diagnosis, Finding, Reason, finding
from bristle.diagnosis.estimation.fitted_model import sliding_fit
from bristle.diagnosis.sliding.screen import GROSS_GAIN
from bristle.diagnosis.sliding.torque import DRIVE, FAINT, is_faint, sliding_torques
from bristle.diagnosis.stages.case import Budget, SearchedCase
from bristle.plant.effects import effect as find_effect

DOUBTED_SHARE = 0.75  # within which a strength must be known: a factor of 4
# of two torques, each rms: what is left of them together where one undoes the other
CANCELLED = 0.2


def suspected(case: SearchedCase, answer: Diagnosis, _: Budget) -> Diagnosis:
    """Return an answer whose effects are suspects if there is a doubt about them."""
    doubts = tuple(_doubts(case, answer)) if answer.effects and not answer.corrections else ()
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


def _doubts(case: SearchedCase, answer: Diagnosis) -> Iterator[Finding]:
    """Give the reasons to doubt the effects of an answer."""
    yield from _doubts_of_sizes(answer)
    effects = [find_effect(e.name) for e in answer.effects]
    # impacts within a play come at other times in any longer simulation
    impacts, sparse = (any(e.free_play for e in effects), any(e.sparse for e in effects))
    if LEAST_FALL * answer.gap.after > answer.gap.before and not (impacts or sparse):
        yield finding(Reason.DOUBT_ERROR, factor=LEAST_FALL)
    worse = answer.whole is not None and answer.whole.worse_throughout
    if worse and not (impacts or _shown_sliding(case)):
        yield finding(Reason.DOUBT_WHOLE)
    if answer.remains.doubtful:
        yield finding(Reason.DOUBT_REST, share=answer.remains.share)
    yield from _doubts_of_torques(case, answer)


def _shown_sliding(case: SearchedCase) -> bool:
    """Return whether the sliding motion shows the effects; in a loop, an open simulation of whole
    records drifts by the disturbance that the loop has answered, with any model.
    """
    models = (each.servo for each in (case.base, case.final))
    base, final = (sliding_fit(case.dataset, each, case.final.fit.values) for each in models)
    return base is not None and final is not None and final.worth > base.worth + GROSS_GAIN


def _doubts_of_torques(case: SearchedCase, answer: Diagnosis) -> Iterator[Finding]:
    """Give the reasons that lie in the torques of the effects where the records slide."""
    servo, over = case.final.servo, case.dataset.stretches
    values = {**servo.fixed, **case.final.fit.values}
    values |= {name: e.value for name, e in answer.fitted.items()}
    torques = sliding_torques(servo.law, servo.effects, values, over)
    if opposed := _cancelling({name: each[over.counted] for name, each in torques.items()}):
        yield finding(Reason.DOUBT_CANCELLING, effects=opposed)
    if faint := tuple(e.name for e in answer.effects if is_faint(torques, servo.law, e.name)):
        yield finding(Reason.DOUBT_FAINT, effects=faint, share=FAINT)


def _doubts_of_sizes(answer: Diagnosis) -> Iterator[Finding]:
    """Give the reasons that lie in the values of parameters."""
    if unknown := tuple(e.name for e in answer.effects if not e.known_within(DOUBTED_SHARE)):
        yield finding(Reason.DOUBT_STRENGTH, effects=unknown, factor=1 / (1 - DOUBTED_SHARE))
    # friction of which the records show none may end at 0
    if stuck := tuple(k for k, e in answer.parameters.items() if e.at_bound and e.value):
        yield finding(Reason.DOUBT_BOUND, parameters=stuck)
    if strange := tuple(_incredible(answer)):
        yield finding(Reason.DOUBT_SIZE, parameters=strange)


def _incredible(answer: Diagnosis) -> Iterator[str]:
    """Give the parameters of the effects that have a value which no hardware has."""
    for effect in answer.effects:
        for key, (low, high) in find_effect(effect.name).hardware.items():
            if not low <= effect.parameters[key].value <= high:
                yield f"{effect.name}.{key}"


def _cancelling(torques: Mapping[str, Array]) -> tuple[str, ...]:
    """Return two torques that cancel each other wherever the records slide; none if there are
    none.
    """
    for one, other in combinations(sorted(set(torques) - {DRIVE}), 2):
        size = np.linalg.norm(torques[one]) + np.linalg.norm(torques[other])
        if size > 0 and np.linalg.norm(torques[one] + torques[other]) < CANCELLED * size:
            return one, other
    return ()
