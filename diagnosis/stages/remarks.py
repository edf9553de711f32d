"""What is to be said of records and model beside the verdict."""

from __future__ import annotations

from dataclasses import replace

from bristle.diagnosis.answer import NOTHING_LEFT, Diagnosis, Finding, Reason, finding
from bristle.diagnosis.stages.bounds import bound_notes
from bristle.diagnosis.stages.case import Budget, SearchedCase
from bristle.diagnosis.stages.conclusion import is_unaligned
from bristle.plant.effects import effect as find_effect
from bristle.plant.known import KNOWN


def remarks(case: SearchedCase, answer: Diagnosis, _: Budget) -> Diagnosis:
    """Return an answer with notes on its parameters, and on what depends on position or time."""
    own = (
        *bound_notes(case.model, answer.base, answer.fitted),
        *_position_notes(case, answer),
        *_clock_notes(case, answer),
        *_scale_notes(answer),
    )
    # what is left is not known before the wider bounds are tried
    remains = NOTHING_LEFT if answer.corrections else answer.remains
    answer = replace(answer, remains=remains, notes=(*case.notes, *own, *case.later))
    return answer if case.remark is None else case.remark(answer)


def _position_notes(case: SearchedCase, answer: Diagnosis) -> list[Finding]:
    """Return a note where an answer depends on where several records of velocities begin."""
    names = (*(e.name for e in answer.effects), *answer.rounds[-1].undecided)
    depends = answer.remains.flag or any(find_effect(name).position_dependent for name in names)
    return [finding(Reason.UNKNOWN_POSITIONS)] if is_unaligned(case) and depends else []


def _scale_notes(answer: Diagnosis) -> list[Finding]:
    """Return a note where a known torque is too large or too small."""
    scale = answer.fitted.get(f"{KNOWN.name}.scale")
    if scale is None or scale.ci95 is None or scale.ci95[0] <= 1.0 <= scale.ci95[1]:
        return []
    return [finding(Reason.KNOWN_TORQUE_OFF, scale=scale.value, ci95=scale.ci95)]


def _clock_notes(case: SearchedCase, answer: Diagnosis) -> list[Finding]:
    """Return a note on each named effect that depends on time, where each record has a clock of its
    own: what its time means.
    """
    given, fitted = case.dataset.segments, case.final.fit.simulator.segments
    if not given.own_clocks:
        return []
    names, notes = tuple(piece.name for piece in given.pieces), []
    for name in (effect.name for effect in answer.effects):
        timing = find_effect(name).timing
        if timing == "course" and fitted.times == given.times:
            notes.append(finding(Reason.BEGINS_ANEW, effect=name))
        elif timing == "course":
            notes.append(finding(Reason.GOES_ON, effect=name, records=names))
        elif timing == "event":
            # the record within which the event falls, and its time by the clock of that
            order = sorted(range(len(names)), key=lambda i: fitted.times[i])
            onset = case.final.fit.values[f"{name}.onset"]
            [*_, inside] = [i for i in order if fitted.times[i] <= onset] or order[:1]
            notes.append(
                finding(
                    Reason.SETS_IN,
                    effect=name,
                    seconds=given.times[inside] + onset - fitted.times[inside],
                    record=names[inside],
                    records=tuple(names[i] for i in order),
                )
            )
    return notes
