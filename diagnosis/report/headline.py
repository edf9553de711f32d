"""The answer of a diagnosis in one line, in words, and its colour."""

from __future__ import annotations

from collections.abc import Sequence

from bristle.diagnosis.answer import Diagnosis, Named
from bristle.diagnosis.report.figures.of_diagnosis import as_given
from bristle.diagnosis.report.text.names import listed, titles_listed
from bristle.diagnosis.report.text.statement import BETWEEN_WORDS

BADGES = {"named": "good", "tie": "open", "none": "calm", "not_identifiable": "open"}
VERDICT_WORDS = {
    "named": "named",
    "tie": "tie",
    "none": "none named",
    "not_identifiable": "not identifiable",
}
NOT_ENOUGH = "Best of what I know, not enough"


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict as a heading, after what two positions show at once."""
    said, seen = _of_the_search(diagnosis), diagnosis.between
    named = {e.name for e in diagnosis.effects}
    parts = [] if seen is None or diagnosis.proposals else [x for x in seen.parts if x not in named]
    if not parts:
        return said
    seen_there = listed([BETWEEN_WORDS[name][0] for name in parts], "and")
    return f"Between motor and load: {seen_there}; {said[0].lower()}{said[1:]}"


def _of_the_search(diagnosis: Diagnosis) -> str:
    """Return what the search found; where that is not enough, it begins with that."""
    if diagnosis.proposals:
        return "First correct the data" if as_given(diagnosis) else "First widen the bounds"
    if diagnosis.suspects:
        return f"Suspected, not shown: {_listed(diagnosis, diagnosis.suspects)}"
    if diagnosis.verdict == "none" and diagnosis.remains.disturbed:
        return "No effect of the catalogue is missing; a large disturbance acts"
    if diagnosis.verdict == "named":
        return f"{_verdict_sentence(diagnosis)}{_beside(diagnosis)}"
    if not _not_enough(diagnosis):
        return _verdict_sentence(diagnosis)
    if (
        diagnosis.verdict == "none"
        and diagnosis.agreement is not None
        and diagnosis.records_disagree
    ):
        return (
            f"{NOT_ENOUGH}:"
            f" {'halves of the record' if diagnosis.agreement.of_halves else 'the records'} do not"
            " agree"
        )
    if diagnosis.verdict == "none":
        return f"{NOT_ENOUGH}: something is missing, and no effect that was tried explains it"
    sentence = _verdict_sentence(diagnosis)
    return f"{NOT_ENOUGH}: {sentence[0].lower()}{sentence[1:]}"


def mark(diagnosis: Diagnosis) -> tuple[str, str]:
    """Return kind and text of the badge beside it: good only where named effects are enough."""
    if diagnosis.proposals:
        return "bad", "data" if as_given(diagnosis) else "bounds"
    if diagnosis.suspects:
        return "open", "suspects"
    if diagnosis.verdict == "none" and diagnosis.remains.disturbed:
        return "open", "disturbance"
    short = diagnosis.verdict != "named" and _not_enough(diagnosis)
    return "open" if short else BADGES[diagnosis.verdict], VERDICT_WORDS[diagnosis.verdict]


def _beside(diagnosis: Diagnosis) -> str:
    """Return what is to be said at once beside names."""
    if diagnosis.remains.flag:
        return "; something else stays unexplained"
    return "; the records do not agree on the parameters" if diagnosis.records_disagree else ""


def _not_enough(diagnosis: Diagnosis) -> bool:
    """Whether much is unexplained, or the records do not agree on the parameters."""
    return diagnosis.remains.flag or diagnosis.records_disagree


def _listed(diagnosis: Diagnosis, effects: Sequence[Named]) -> str:
    """Return effects, each with those it cannot be distinguished from."""
    ties = {name: tie for tie in diagnosis.ties for name in tie}
    wording = diagnosis.model.wording
    each = [titles_listed(ties.get(e.name, (e.name,)), "or", wording) for e in effects]
    return listed(each, "and")


def _verdict_sentence(diagnosis: Diagnosis) -> str:
    wording = diagnosis.model.wording
    if diagnosis.verdict == "named":
        return f"The model lacks: {_listed(diagnosis, diagnosis.effects)}"
    if diagnosis.verdict == "tie":
        sets = "; ".join(titles_listed(tie, "or", wording) for tie in diagnosis.ties)
        return f"The model lacks one of: {sets}; the records fit each equally well"
    return (
        "No effect is missing"
        if diagnosis.verdict == "none"
        else "These records cannot identify what is missing"
    )
