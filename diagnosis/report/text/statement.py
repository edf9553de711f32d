"""The sentences of a diagnosis: what is missing, how much, how surely, what to measure next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from bristle.diagnosis.answer import (
    OUTLIERS,
    BetweenSensors,
    Diagnosis,
    Estimate,
    Line,
    Named,
    Reason,
    RecordAgreement,
    SeenController,
    Undetected,
    Unexplained,
    UnnamedTorque,
    WholeRecords,
)
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report.text.designed import designed_line
from bristle.diagnosis.report.text.names import (
    FAR_OFF,
    NATS,
    OUTLIER_NOTE,
    effect_name,
    effects_listed,
    listed,
    reported_parameters,
    value,
    view_name,
)
from bristle.diagnosis.report.text.said import said
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects
from bristle.plant.effects import separation
from bristle.plant.wording import Wording

REPEAT_ADVICE = {  # view -> what to record where no other motion would show more of the residual
    "tone": (
        "Record with the input at zero and the drive on, then with nearby machines switched off, to"
        " find what oscillates."
    ),
    "history": (
        "Record motion to and fro, with small steps and with large ones, to find what is"
        " unexplained after a reversal."
    ),
    "t": "Record the same motion again, over a longer time, to find what changes with it.",
}
TIGHT_BOUNDS = "Effects explain these records, but they only make up for bounds that are too tight."


# -- the answer ------------------------------------------------------------------------------------
def statement(d: Diagnosis) -> tuple[str, ...]:
    """Return the result, one sentence or two a line."""
    leads = [said(line) for line in d.leads]
    if d.agreement is not None and not d.agreement.holds:
        leads.insert(0, disagreement_line(d.agreement))
    # nothing was searched, or bounds are to be widened first
    if not d.rounds:
        return tuple(leads)
    if d.corrections:
        return (*leads, f"{TIGHT_BOUNDS} Proposed: {'; '.join(map(said, d.corrections))}.")
    whole = (
        []
        if d.whole is None
        else [open_loop_line(d.whole, d.whole.horizons[0].seconds, d.model.controller is not None)]
    )
    # parts that both positions show at once come first
    between = [] if d.between is None else [between_line(d.between)]
    first, last = (between, []) if d.between and d.between.parts else ([], between)
    seen = () if d.seen_controller is None else (controller_line(d.seen_controller),)
    return (*first, *leads, *answer_lines(d), *whole, *last, *seen)


BETWEEN_WORDS = {  # what each part is, and how large
    "backlash": ("a play", " of {play}"),
    "compliance": ("a compliance", ", on which the load swings at {frequency} with a held motor"),
    "eccentric_encoder": ("an eccentric encoder or wheel", ", amplitude {amplitude}"),
    "transmission_error": (
        "a wave of the transmission",
        ", {periods} in a turn, amplitude {amplitude}",
    ),
}


def between_line(between: BetweenSensors) -> str:
    """Return what lies between the positions of motor and load."""
    parts = [
        "".join(BETWEEN_WORDS[name]).format(
            **{key: value(e) if e.ci95 else f"{e.value:g}" for key, e in own.items()}
        )
        for name, own in between.parts.items()
    ]
    if not parts:
        return (
            "Between the positions of motor and load nothing is seen: no play, no compliance, no"
            " wave."
        )
    return (
        f"Between the positions of motor and load: {listed(parts, 'and')}. That leaves"
        f" {between.after:.3g} of {between.before:.3g} {between.unit} of their difference, rms."
    )


LEAST_LAW = 0.9  # of the input: what the law of a controller explains, else it is another


def controller_line(seen: SeenController) -> str:
    """Return what made the input of the goal."""
    if seen.share < LEAST_LAW:
        return (
            f"The law of a PID explains {seen.share:.0%} of the input by the goal of the {seen.of}:"
            " another made it, or the goal is not the one that it followed."
        )
    gains = [
        f"{name} = {value(e) if e.ci95 else f'{e.value:.4g} {e.unit}'}"
        for name, e in seen.gains.items()
    ]
    return (
        f"Between goal and input: a controller of the {seen.of} with {listed(gains, 'and')}. Its"
        f" law explains {seen.share:.1%} of the input."
    )


def answer_lines(d: Diagnosis) -> tuple[str, ...]:
    """Return what is missing, as the segments show it."""
    left, wording = d.remains, d.model.wording
    open_tie = bool(d.ties and not d.found)
    return (
        *(_missing(effect, wording) for effect in d.effects),
        *(_suspected(effect, wording) for effect in d.suspects),
        *(_tie(tie, d) for tie in d.ties),
        *_without_name(d),
        _error(d),
        *([unexplained_line(left, wording, open_tie)] if left.flag else ()),
        *([disturbance_line(left, wording)] if left.disturbed else ()),
        *_at_bounds(d.fitted),
    )


def findings(d: Diagnosis) -> tuple[str, ...]:
    """Return lines about records and model."""
    unnamed = [] if d.unnamed is None else [unnamed_line(d.unnamed, d.model.wording)]
    return (*map(said, d.notes), *unnamed)


def experiment(d: Diagnosis) -> str:
    """Return what to measure next, or an empty text."""
    advice = disagreement_advice(d.agreement) if d.agreement and not d.agreement.holds else ""
    searched = bool(d.rounds) and not d.corrections
    parts = advice, what_to_measure(d) if searched else "", designed_line(d.designed, d.model)
    return " ".join(filter(None, parts))


def _missing(e: Named, wording: Wording) -> str:
    certain = f"Probability that chance improves the fit as much: p ≤ {e.p:.2g}"
    return (
        f"Missing: {_described(e, wording)}. Estimated, with 95 % intervals: {_estimated(e)}."
        f" {certain}."
    )


def _suspected(e: Named, wording: Wording) -> str:
    return f"Suspected: {_described(e, wording)}. As fitted, if it is that: {_estimated(e)}."


def _described(e: Named, wording: Wording) -> str:
    effect = find_effect(e.name, wording)
    about = "" if effect.description == effect.title else f", {effect.description}"
    return f"{effect_name(e.name, wording)}{about}"


def _estimated(e: Named) -> str:
    return ", ".join(
        f"{name} {value(estimate)}" for name, estimate in reported_parameters(e).items()
    )


def _tie(tie: Sequence[str], d: Diagnosis) -> str:
    named = [effect.name for effect in d.effects if effect.name in tie]
    if not named:
        return f"These records cannot distinguish {effects_listed(tie, 'from', d.model.wording)}."
    others = effects_listed([name for name in tie if name not in named], "or", d.model.wording)
    return (
        f"These records cannot distinguish {effects_listed(named, 'and', d.model.wording)} from"
        f" {others}, which fits equally well."
    )


def _without_name(d: Diagnosis) -> Iterator[str]:
    if d.verdict == "none":
        yield (
            "No effect of the catalogue improves the fit by more than chance does, and by enough to"
            " matter."
        )
    if d.unidentified:
        unknown = (
            f"these records do not determine {listed(d.unidentified, 'or')}, and so cannot show"
            " what is missing"
        )
        check = "Check the columns in [input] and [output], or give records with more motion"
        yield f"The output hardly follows the input: {unknown}. {check}."
    elif d.verdict == "not_identifiable":
        why = (
            "too many effects explain it equally well"
            if d.ties
            else "the motion in the records is too uniform"
        )
        why = said(d.hindrance) if d.hindrance else why
        yield f"Something is missing, but these records cannot identify it: {why}."


def _error(d: Diagnosis) -> str:
    """Return the line on the error of the output."""
    gap = d.gap
    squares = gap.before, gap.after, gap.noise_floor
    before, after, floor = (math.sqrt(x) if x is not None and x >= 0 else math.nan for x in squares)
    # what is predicted is partly taken for noise
    most = "at most " if d.remains.predictable else ""
    alone = f"disturbance and sensor noise alone account for {most}{floor:.3g} {gap.output_unit}"
    if gap.noise_floor is None:
        alone = "disturbance and sensor noise alone account for less; how much less is not known"
    elif floor >= after:
        alone = f"disturbance and sensor noise alone account for {most}as much"
    if not d.found:
        return (
            f"The rms error of the output on held-out segments is {before:.3g} {gap.output_unit}"
            f" after a refit; {alone}."
        )
    changes = f"falls from {before:.3g} to {after:.3g} {gap.output_unit}; {alone}"
    if after >= before:
        changes = (
            f"does not fall ({before:.3g} {gap.output_unit} before, {after:.3g} {gap.output_unit}"
            f" after): {OUTLIER_NOTE}"
        )
    return f"The rms error of the output on held-out segments {changes}."


def open_loop_line(whole: WholeRecords, segment: float, follows: bool = False) -> str:
    """Return the line on whole records; `segment` is the length of a segment [s]; `follows`: a
    controller in the model follows a setpoint.
    """
    unit, last = whole.records[0].unit, whole.horizons[-1]
    how = "with its controller" if follows else "in open loop"
    if not math.isfinite(last.after):
        return f"Simulated {how} over whole records it fails: use the model over short times only."
    line = (
        f"Simulated {how} over whole records, the model is {last.after:.3g} {unit} rms from"
        " what was measured"
    )
    # compared with before
    if last.before != last.after:
        line += (
            f", {last.before:.3g} {unit} before"
            if math.isfinite(last.before)
            else "; before, the simulation failed"
        )
    if whole.worse:
        line += ": over so long a time it is worse than without what was found"
    # which parameters it has
    if not whole.refitted:
        longer = f"a refit to more than segments of {segment:.3g} s"
        why = f"{longer} does not lower the error where it was not fitted"
        if not whole.tried:
            why = f"{longer} was not tried"
        elif whole.contradicted:
            why = f"{longer} contradicts what short stretches show"
        return f"{line}. It is not refitted to that: {why}."
    to = (
        "whole records"
        if whole.whole
        else f"stretches of {whole.refitted_to:.3g} s, longer ones do not help"
    )
    usual = f"with those of segments of {segment:.3g} s the error is {last.segments:.3g} {unit}"
    return f"{line}. Its parameters were refitted to {to}; {usual}."


def unexplained_line(left: Unexplained, wording: Wording, open_tie: bool) -> str:
    """Return a line on the unexplained residual; with an open tie no member of it was added."""
    if left.view is None:
        seen = _disturbance(left, wording)
    elif left.view == OUTLIERS and left.label:
        where = f"{FAR_OFF} ({said(left.label)})"
        seen = f"{100 * left.share:.0f} % of the residual's power is in {where}"
    else:
        seen = (
            f"{100 * left.share:.0f} % of the residual can be predicted from"
            f" {view_name(left.view, left.label)}"
        )
    end = (
        "with none of the tied effects added"
        if open_tie
        else "and no effect that was tried explains it"
    )
    return f"Unexplained residual: {seen}, {end}."


def disturbance_line(left: Unexplained, wording: Wording) -> str:
    """Return a line on a large disturbance that acts as noise does."""
    return f"A large disturbance acts: {_disturbance(left, wording)}."


def _disturbance(left: Unexplained, wording: Wording) -> str:
    return (
        f"a random disturbance of {100 * left.disturbance:.0f} % of the {wording.torque} of the"
        " input (rms) is needed to fit the records, and no motion variable predicts it"
    )


def disagreement_line(agreement: RecordAgreement) -> str:
    """Return a line on records that do not agree on the parameters."""
    values = {
        part: value
        for part, value in agreement.values.get(agreement.differs, {}).items()
        if value is not None
    }
    line = (
        "The records do not agree: with parameters of its own for each they are"
        f" {agreement.gain:.0f} nats likelier"
    )
    if agreement.of_halves:
        line = (
            "The record does not agree with itself: with parameters of its own for each half it is"
            f" {agreement.gain:.0f} nats likelier"
        )
    line += f", and chance gives {agreement.level:.0f} at most ({NATS})."
    if values:
        unit = agreement.units[agreement.differs]
        unit = "" if unit == "1" else f" {unit}"
        low, high = (pick(values, key=lambda part: values[part]) for pick in (min, max))
        line += (
            f" Most differs {agreement.differs}: {values[low]:.4g}{unit} in {low},"
            f" {values[high]:.4g}{unit} in {high}."
        )
    return (
        f"{line} Either something was changed between them, or the model is wrong where the motion"
        " is another."
    )


def disagreement_advice(agreement: RecordAgreement) -> str:
    """Return what to do where the records do not agree."""
    if agreement.of_halves:
        return "Find out what changed during the record (temperature, load, supply)."
    changed = "temperature, load, supply, the logger's clock"
    return (
        f"Find out what was changed between the records ({changed}), and diagnose them one by one."
    )


def not_offered(refused: Line) -> str:
    """Return why no unnamed torque is offered."""
    if isinstance(refused, str):
        return refused
    if refused.reason is Reason.NO_FUNCTION:
        return (
            "no smooth function of velocity, position, input or time predicts anything of it in"
            " segments left out of the fit"
        )
    best = f"the best function, of {view_name(refused.facts['variable'])},"
    if refused.reason is Reason.FUNCTION_NO_BETTER:
        return f"{best} does not lower the squared error on held-out segments"
    factor = math.floor(100 * refused.facts["factor"]) / 100
    return (
        f"{best} lowers the squared error on held-out segments by a factor of {factor:.2f} only,"
        f" and {refused.facts['asked']:g} is asked"
    )


def unnamed_line(torque: UnnamedTorque, wording: Wording) -> str:
    """Return a line on the unexplained residual as a smooth function."""
    if torque.refused is not None:
        why = not_offered(torque.refused)
        return f"no unnamed {wording.torque} is offered for the unexplained residual: {why}"
    of = listed([view_name(c.variable) for c in torque.curves], "and")
    before, after = math.sqrt(torque.before), math.sqrt(torque.after)
    return (
        f"an unnamed {wording.torque}, a smooth function of {of}, explains {100 * torque.share:.0f}"
        f" % of the squared error on held-out segments: the rms error falls from {before:.3g} to"
        f" {after:.3g} {torque.output_unit} there. It says nothing about a cause, and holds only in"
        " the range seen; --fill puts it into the augmented model"
    )


def _at_bounds(parameters: Mapping[str, Estimate]) -> Iterator[str]:
    """Give a line each on parameters of the model and of effects that end at a bound; only the
    former have one in [bounds].
    """
    stuck = [name for name, estimate in parameters.items() if estimate.at_bound]
    absent = [name for name in stuck if parameters[name].value == 0.0]
    own = [name for name in stuck if name.split(".")[0] not in all_effects() and name not in absent]
    if absent:
        yield f"The refit of {', '.join(absent)} ends at 0: these records show none of it."
    if own:
        yield (
            f"The refit of {', '.join(own)} ends at a bound: widen it in [bounds], or check units"
            " and signs."
        )
    if others := [name for name in stuck if name not in (*own, *absent)]:
        limit = "ends at the limit of its interval: that is a limit, not an estimate"
        yield f"{', '.join(others)} {limit}; the effect may stand in for another one."


# -- what to measure next --------------------------------------------------------------------------
def what_to_measure(d: Diagnosis) -> str:
    """Return what would show more than the records do, or an empty text."""
    named, left, wording = bool(d.effects), d.remains, d.model.wording
    lines = []
    if d.uniform:
        why = said(d.uniform)
        lines.append(
            f"In such records other effects look much alike, so confirm the name with better ones:"
            f" {why}."
            if named
            else f"Nothing can be named with certainty from such records: {why}."
        )
    for tie in d.ties:
        known = separation(tie, wording)
        each = "; ".join(
            f"for {effect_name(n, wording)}: {find_effect(n, wording).excitation}" for n in tie
        )
        lines.append(f"To distinguish {effects_listed(tie, 'from', wording)}: {known or each}.")
    if left.flag and (named or not d.ties):
        lines.append(_search_further(left))
    elif left.disturbed:
        lines.append(_search_further(replace(left, view=None)))
    return " ".join(lines)


def _search_further(left: Unexplained) -> str:
    """Return what to record to find what a residual comes from."""
    if left.view is None:
        return (
            "Look for a loose part, and measure on its other side too; and log all that acts on the"
            " axis."
        )
    if left.view in REPEAT_ADVICE:
        return REPEAT_ADVICE[left.view]
    if left.view == OUTLIERS:
        return (
            f"Record again what happens in the {FAR_OFF}, and little else, to find what is"
            " unexplained there."
        )
    return (
        f"Record motion that varies {view_name(left.view)} most, and all else little, to find what"
        " is unexplained there."
    )


# -- what was not found ----------------------------------------------------------------------------
def undetected(limits: Sequence[Undetected], model: Model) -> dict[str, str]:
    """Return for each effect that was not found how large it may be without being detected."""
    same = "; all this if the records start at the same position"
    return {u.name: _undetected(u, model) + (same if u.same_start else "") for u in limits}


def _undetected(each: Undetected, model: Model) -> str:
    if each.reason:
        return said(each.reason)
    effect = find_effect(each.name, model.wording)
    needs = f"what shows it: {effect.excitation}"
    if each.gain is not None and each.before:
        added = effect_name(each.before, model.wording)
        gained = f"before {added} was added it gained {each.gain:.0f} nats"
        return f"{gained}; beside that nothing shows it"
    if each.gain is not None:
        failed = said(each.failed) if each.failed else ""
        return f"it gains {each.gain:.0f} nats, more than chance, but {failed}"
    if each.confounded:
        return f"these records cannot distinguish it from {', '.join(each.confounded)}; {needs}"
    if not each.measurable:
        return f"tried; the likelihood gain does not exceed chance; {needs}"
    if each.limit is None:
        return f"these records cannot show it; {needs}"
    strength = effect.strength
    unit = model.unit(strength.name)
    return (
        f"{strength.description}: more than {each.limit:.2g}{'' if unit == '1' else ' ' + unit}"
        " would have been detected"
    )
