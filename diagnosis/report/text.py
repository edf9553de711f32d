"""The sentences of a diagnosis: what is missing, how much, how certain, and what to measure
next.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from bristle.diagnosis.estimation.uncertainty import STRENGTH_HALF_WIDTH
from bristle.diagnosis.localisation.residual_localisation import OUTLIERS
from bristle.diagnosis.localisation.unexplained import Unexplained
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report.result import (
    Agreement,
    Estimate,
    Gap,
    Named,
    UnnamedTorque,
    WholeRecords,
)
from bristle.diagnosis.selection.detection_limit import Undetected
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects
from bristle.plant.effects import separation
from bristle.plant.wording import ROTARY, Wording

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
NATS = "natural units of log-likelihood: a gain of 4.6 nats is odds of 100 to 1"
OUTLIER_NOTE = "a few outlier segments may dominate it"
MOST_DIGITS = 6  # significant digits of a value at most
FAR_OFF = "segments with a large error"
AXES = {  # first part of a view -> name and kind of quantity
    "theta": ("position", "angle"),
    "v": ("velocity", "speed"),
    "a": ("acceleration", "acceleration"),
    "u": ("input", "input"),
    "du": ("rate of the input", "input rate"),
    "t": ("time", "time"),
    "history": ("travel since the last reversal", "angle"),
    "direction": ("sign of the velocity", "none"),
    "frequency": ("frequency", "frequency"),
    "tone": ("oscillation in time", "time"),
    OUTLIERS: (FAR_OFF, "none"),
}


@dataclass(frozen=True)
class Facts:
    """What the sentences are written from."""

    verdict: str
    gap: Gap
    remains: Unexplained
    effects: Sequence[Named] = ()
    ties: Sequence[Sequence[str]] = ()
    # all that were fitted, for those that end at a bound
    parameters: Mapping[str, Estimate] | None = None
    unidentified: Sequence[str] = ()  # the model's parameters if the records determine none of them
    narrow: str = ""  # why the motion is too poor to distinguish effects
    wording: Wording = ROTARY
    hindrance: str = ""  # why nothing can be named, where that is not the motion or a tie


# -- names -----------------------------------------------------------------------------------------
def view_name(view: str, label: str = "") -> str:
    """Return a view in words, with what was found in it: "theta", "7 in a turn" is position (7 in a
    turn).
    """
    first, _, second = view.partition(" x ")
    names = [AXES.get(part, (part, ""))[0] for part in (first, second) if part]
    return " × ".join(names) + (f" ({label})" if label else "")


def effect_name(name: str, wording: Wording = ROTARY) -> str:
    """Return an effect in words, its identifier in brackets; a name that is no effect stays as it
    is.
    """
    known = all_effects(wording)
    return f"{known[name].title} ({name})" if name in known else name


def titles_listed(names: Sequence[str], word: str, wording: Wording = ROTARY) -> str:
    """Return effects in words alone, as "a, b and c"; a name that is no effect stays as it is."""
    known = all_effects(wording)
    return listed([known[name].title if name in known else name for name in names], word)


def listed(names: Sequence[str], word: str) -> str:
    """Return "a, b and c"."""
    return (
        names[0]
        if len(names) == 1
        else f"{', '.join(names[:-1])} {word} {names[-1]}"
        if names
        else "nothing"
    )


def effects_listed(names: Sequence[str], word: str, wording: Wording = ROTARY) -> str:
    """Return effects in words, as "a (name), b (name) and c (name)"."""
    return listed([effect_name(name, wording) for name in names], word)


# -- numbers ---------------------------------------------------------------------------------------
def rounded(value: float, low: float, high: float) -> tuple[tuple[str, str, str, str], int] | None:
    """Return value, low, high and half the interval as texts, and the power of ten they are given
    in.

    They end with the second digit of the half width, and at the sixth of the value at the latest:
    an interval that is narrower is given as wide as that digit. None where there is no interval.
    """
    half = (high - low) / 2
    if not (all(map(math.isfinite, (value, low, high))) and half > 0):
        return None
    most = math.floor(math.log10(max(abs(value), half)))
    last = max(math.floor(math.log10(half)) - 1, most - MOST_DIGITS + 1)
    if value and abs(value) < 10.0**last:  # far from the middle of a wide interval, but not 0
        last = math.floor(math.log10(abs(value)))
    if half < 10.0**last:
        half = 10.0**last
        low, high = value - half, value + half
    power = 0 if -3 <= most < 5 else most
    mid, below, above, spread = (
        f"{x / 10.0**power:z.{max(0, power - last)}f}" for x in (value, low, high, half)
    )
    return (mid, below, above, spread), power


def plain_texts(e: Estimate) -> tuple[str, str, str]:
    """Return an estimate and the ends of its interval as plain texts; the ends are empty where
    there is none.
    """
    found = rounded(e.value, *e.ci95) if e.ci95 else None
    if found is None:
        return f"{e.value:.4g}", "", ""
    (mid, low, high, _), power = found
    times = f"e{power}" if power else ""
    return mid + times, low + times, high + times


def value(e: Estimate) -> str:
    """Return an estimate with its interval."""
    mid, low, high = plain_texts(e)
    unit = "" if e.unit == "1" else f" {e.unit}"
    length = (
        f", a period of {2e3 * math.pi / e.value:.5g} mm" if e.unit == "rad/m" and e.value else ""
    )
    return f"{mid}{unit} ({low} to {high}){length}" if low else f"{mid}{unit} (uncertain){length}"


def reported_parameters(e: Named) -> dict[str, Estimate]:
    """Return the parameters of an effect that a sentence gives: those of its form or of a second
    term only if it needs them.
    """
    known = find_effect(e.name)
    defaults = {p.name.split(".")[1]: p.default for p in known.parameters}

    def idle(names: Iterable[str]) -> bool:
        found = [
            (defaults[name], e.parameters[name].ci95) for name in names if name in e.parameters
        ]
        return all(ci is not None and ci[0] <= default <= ci[1] for default, ci in found)

    left_out = {*known.shape_parameters} if idle(known.shape_parameters) else set()
    left_out |= {*known.second_term} if idle(known.second_term[:1]) else set()
    return {name: estimate for name, estimate in e.parameters.items() if name not in left_out}


# -- the answer ------------------------------------------------------------------------------------
def statement(facts: Facts) -> tuple[str, ...]:
    """Return the answer, one sentence or two a line."""
    left = facts.remains
    return (
        *(_missing(effect, facts.wording) for effect in facts.effects),
        *(_tie(tie, facts) for tie in facts.ties),
        *_without_name(facts),
        _error(facts),
        *(
            [unexplained_line(left, facts.wording, bool(facts.ties and not facts.effects))]
            if left.flag
            else ()
        ),
        *_at_bounds(facts.parameters or {}),
        *_unknown(facts),
    )


def _missing(e: Named, wording: Wording) -> str:
    found = ", ".join(
        f"{name} {value(estimate)}" for name, estimate in reported_parameters(e).items()
    )
    effect = find_effect(e.name, wording)
    about = "" if effect.description == effect.title else f", {effect.description}"
    certain = f"Probability that chance improves the fit as much: p ≤ {e.p:.2g}"
    return (
        f"Missing: {effect_name(e.name, wording)}{about}. Estimated, with 95 % intervals: {found}."
        f" {certain}."
    )


def _tie(tie: Sequence[str], facts: Facts) -> str:
    named = [effect.name for effect in facts.effects if effect.name in tie]
    if not named:
        return f"These records cannot distinguish {effects_listed(tie, 'from', facts.wording)}."
    others = effects_listed([name for name in tie if name not in named], "or", facts.wording)
    return (
        f"These records cannot distinguish {effects_listed(named, 'and', facts.wording)} from"
        f" {others}, which fits equally well."
    )


def _without_name(facts: Facts) -> Iterator[str]:
    if facts.verdict == "none":
        yield (
            "No effect of the catalogue improves the fit by more than chance does, and by enough to"
            " matter."
        )
    if facts.unidentified:
        unknown = (
            f"these records do not determine {listed(facts.unidentified, 'or')}, and so cannot show"
            " what is missing"
        )
        check = "Check the columns in [input] and [output], or give records with more motion"
        yield f"The output hardly follows the input: {unknown}. {check}."
    elif facts.verdict == "not_identifiable":
        why = (
            "too many effects explain it equally well"
            if facts.ties
            else "the motion in the records is too uniform"
        )
        why = facts.hindrance or why
        yield f"Something is missing, but these records cannot identify it: {why}."


def _error(facts: Facts) -> str:
    """Return the line on the error of the output."""
    gap = facts.gap
    squares = gap.before, gap.after, gap.noise_floor
    before, after, floor = (math.sqrt(x) if x is not None and x >= 0 else math.nan for x in squares)
    # what is predicted is partly taken for noise
    most = "at most " if facts.remains.predictable else ""
    alone = f"disturbance and sensor noise alone account for {most}{floor:.3g} {gap.output_unit}"
    if gap.noise_floor is None:
        alone = "disturbance and sensor noise alone account for less; how much less is not known"
    elif floor >= after:
        alone = f"disturbance and sensor noise alone account for {most}as much"
    if not facts.effects:
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


def open_loop_line(whole: WholeRecords, segment: float) -> str:
    """Return the line on whole records; `segment` is the length of a segment [s]."""
    unit, last = whole.records[0].unit, whole.horizons[-1]
    if not math.isfinite(last.after):
        return (
            "In open loop over whole records the simulation fails: use the model over short times"
            " only."
        )
    found = (
        f"Simulated in open loop over whole records, the model is {last.after:.3g} {unit} rms from"
        " what was measured"
    )
    if last.before != last.after:
        found += (
            f", {last.before:.3g} {unit} before"
            if math.isfinite(last.before)
            else "; before, the simulation failed"
        )
    if whole.worse:
        found += ": over so long a time it is worse than without what was found"
    if not whole.refitted:
        longer = f"a refit to more than segments of {segment:.3g} s"
        why = (
            f"{longer} does not lower the error where it was not fitted"
            if whole.tried
            else f"{longer} was not tried"
        )
        return f"{found}. Its parameters are those of the segments: {why}."
    to = (
        "whole records"
        if whole.whole
        else f"stretches of {whole.refitted_to:.3g} s, longer ones do not help"
    )
    usual = f"with those of segments of {segment:.3g} s the error is {last.segments:.3g} {unit}"
    return f"{found}. Its parameters were refitted to {to}; {usual}."


def unexplained_line(left: Unexplained, wording: Wording, open_tie: bool) -> str:
    """Return a line on the residual that is unexplained; with an open tie none of its members was
    added.
    """
    if left.view is None:
        said = (
            f"a random disturbance of {100 * left.disturbance:.0f} % of the {wording.torque} of the"
            " input is needed"
        )
        said += " to fit the records, and no motion variable predicts it"
    elif left.view == OUTLIERS and left.label:
        said = f"{100 * left.share:.0f} % of the residual's power is in {FAR_OFF} ({left.label})"
    else:
        said = (
            f"{100 * left.share:.0f} % of the residual can be predicted from"
            f" {view_name(left.view, left.label)}"
        )
    end = (
        "with none of the tied effects added"
        if open_tie
        else "and no effect that was tried explains it"
    )
    return f"Unexplained residual: {said}, {end}."


def begins_anew(name: str) -> str:
    """Return a line on an effect whose course each record begins with, where each has a clock of
    its own.
    """
    return f"{name} begins anew in each record, since each has a clock of its own"


def disagreement_line(found: Agreement) -> str:
    """Return a line on records that do not agree on the parameters."""
    values = {
        part: value
        for part, value in found.values.get(found.differs, {}).items()
        if value is not None
    }
    line = (
        f"The records do not agree: with parameters of its own for each they are {found.gain:.0f}"
        " nats likelier"
    )
    if found.of_halves:
        line = (
            "The record does not agree with itself: with parameters of its own for each half it is"
            f" {found.gain:.0f} nats likelier"
        )
    line += f", and chance gives {found.level:.0f} at most ({NATS})."
    if values:
        unit = "" if found.units[found.differs] == "1" else f" {found.units[found.differs]}"
        low, high = (pick(values, key=lambda part: values[part]) for pick in (min, max))
        line += (
            f" Most differs {found.differs}: {values[low]:.4g}{unit} in {low},"
            f" {values[high]:.4g}{unit} in {high}."
        )
    return (
        f"{line} Either something was changed between them, or the model is wrong where the motion"
        " is another."
    )


def disagreement_advice(found: Agreement) -> str:
    """Return what to do where the records do not agree."""
    if found.of_halves:
        return "Find out what changed during the record (temperature, load, supply)."
    changed = "temperature, load, supply, the logger's clock"
    return (
        f"Find out what was changed between the records ({changed}), and diagnose them one by one."
    )


def unnamed_line(found: UnnamedTorque, wording: Wording) -> str:
    """Return a line on the unexplained residual as a smooth function."""
    if not found.offered:
        return (
            f"no unnamed {wording.torque} is offered for the unexplained residual: {found.reason}"
        )
    of = listed([view_name(c.variable) for c in found.curves], "and")
    before, after = math.sqrt(found.before), math.sqrt(found.after)
    return (
        f"an unnamed {wording.torque}, a smooth function of {of}, explains {100 * found.share:.0f}"
        f" % of the squared error on held-out segments: the rms error falls from {before:.3g} to"
        f" {after:.3g} {found.output_unit} there. It says nothing about a cause, and holds only in"
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


def _unknown(facts: Facts) -> Iterator[str]:
    """Give lines on the named effects whose strength or free play is not known."""
    unknown = [e.name for e in facts.effects if not e.known]
    play = [name for name in unknown if find_effect(name).free_play]
    for what, names in (
        ("strength", [name for name in unknown if name not in play]),
        ("play", play),
    ):
        if names:
            of, it = effects_listed(names, "or", facts.wording), "it" if len(names) == 1 else "each"
            within = f"{100 * STRENGTH_HALF_WIDTH:.0f} %"
            yield (
                f"The {what} of {of} is not known to within {within}: {it} may stand in for"
                " something else."
            )


def experiment(facts: Facts) -> str:
    """Return what to measure next, or an empty text."""
    named, left = bool(facts.effects), facts.remains
    lines = []
    if facts.narrow and named:
        lines = [
            "In such records other effects look much alike, so confirm the name with better ones:"
            f" {facts.narrow}."
        ]
    elif facts.narrow:
        lines = [f"Nothing can be named with certainty from such records: {facts.narrow}."]
    for tie in facts.ties:
        known = separation(tie, facts.wording)
        each = "; ".join(
            f"for {effect_name(n, facts.wording)}: {find_effect(n, facts.wording).excitation}"
            for n in tie
        )
        lines.append(
            f"To distinguish {effects_listed(tie, 'from', facts.wording)}: {known or each}."
        )
    if left.flag and (named or not facts.ties):
        lines.append(_search_further(left))
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
def undetected(
    found: Sequence[Undetected],
    model: Model,
    tied: Collection[str] = (),
    added: str = "",
    drifting: bool = False,
) -> dict[str, str]:
    """Return for each effect that was not found how large it may be without being detected.

    `tied` are the effects that were found or are in a tie, which are left out; `added` is the one
    that was added after these were tried. With `drifting` it is not known where the positions of
    the records are relative to each other.
    """
    texts = {}
    for each in found:
        if each.name in tied:
            continue
        text = _undetected(each, model, added)
        if drifting and not each.reason and find_effect(each.name).position_dependent:
            text += "; all this if the records start at the same position"
        texts[each.name] = text
    return texts


def _undetected(each: Undetected, model: Model, added: str) -> str:
    effect = find_effect(each.name, model.wording)
    needs = f"what shows it: {effect.excitation}"
    if each.reason:
        return each.reason
    if each.gain is not None and added:
        return (
            f"before {effect_name(added, model.wording)} was added it gained {each.gain:.0f} nats;"
            " beside that nothing shows it"
        )
    if each.gain is not None:
        return f"it gains {each.gain:.0f} nats, more than chance, but {each.failed}"
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
