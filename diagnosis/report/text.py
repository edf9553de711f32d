"""The answer in sentences: what was found, how sure that is, what to measure next."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

import numpy as np

from bristle.diagnosis.localisation.residual_localisation import OUTLIERS
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report.result import Estimate, Gap, Named, Remains
from bristle.diagnosis.selection.candidates import Candidate
from bristle.diagnosis.selection.null_distribution import Null
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects
from bristle.plant.effects import separation

REPEAT_ADVICE = {  # what shows more of what remains in a view that no motion varies
    "tone": "Record with the input at zero and the drive on, then with what runs nearby switched off, to see what swings there.",
    "history": "Record motion to and fro, by small steps and by large ones, to see what remains after a reversal.",
    "t": "Record the same motion again, over a longer time, to see what changes with it.",
}
OUTLIER_NOTE = "a few where the servo went another way by chance may be most of it"
UNSEEN_RATIO = 1e3  # relative to the model's own friction or input: a limit beyond this means that records cannot show it
MOST_DIGITS = 6  # of a value, at most
MOST_TIED, MOST_TIED_UNIFORM = 3, 2  # most classes in a tie: with more, or with more in a uniform motion, the records name nothing
AXES = {  # first part of a view -> name and kind of quantity
    "theta": ("position", "angle"), "v": ("velocity", "speed"), "a": ("acceleration", "acceleration"),
    "u": ("input", "input"), "du": ("rate of the input", "input rate"), "t": ("time", "time"),
    "history": ("travel since the last reversal", "angle"), "direction": ("sign of the velocity", "none"),
    "frequency": ("frequency", "frequency"), "tone": ("tone in time", "time"),
}  # fmt: skip


def view_name(view: str, label: str = "") -> str:
    """Return a view in words, with what was found in it: "theta", "7 in a turn" is position (7 in a turn)."""
    if view == OUTLIERS and label:
        return f"far off: {label}"
    first, _, second = view.partition(" x ")
    names = [AXES.get(part, (part, ""))[0] for part in (first, second) if part]
    return " × ".join(names) + (f" ({label})" if label else "")


def words(name: str) -> str:
    """Return an effect's description in words."""
    return find_effect(name).description


def on_axis(text: str, linear: bool, input_kind: str) -> str:
    """Return a text about a servo as it is for a linear axis (force for torque) and for an input that is no voltage.

    Full names of parameters, such as bias.torque, stay as they are.
    """
    text = re.sub(r"\bvoltage\b", input_kind, text)
    text = text.replace("periods in a turn", "2 pi over the length of a period") if linear else text
    return re.sub(r"(?<!\.)\btorque", "force", text) if linear else text


def experiment(ties: Sequence[Sequence[str]], remains: Remains, narrow: str, named: bool = False) -> str:
    """Return what to measure next, or an empty text; `narrow` says why the records are too poor, if they are."""
    lines = [f"Nothing can be named for certain on such records: {narrow}."] if narrow else []
    if narrow and named:
        lines = [f"On such records other effects look much alike, so confirm the name on better ones: {narrow}."]
    for tie in ties:
        known = separation(tie)
        each = "; ".join(f"for {name}: {find_effect(name).excitation}" for name in tie)
        lines.append(f"To tell {' and '.join(tie)} apart: {known or each}.")
    if ties and not named:
        return " ".join(lines)
    if remains.flag and remains.view in REPEAT_ADVICE:
        lines.append(REPEAT_ADVICE[remains.view])
    elif remains.flag and remains.view is None:
        lines.append("Look for what is loose, and measure on the other side of it too; and log all that acts on the axis.")
    elif remains.flag:
        again = f"motion that varies {view_name(remains.view or '')} most"
        if remains.view == OUTLIERS:
            again = "again what happens in the stretches that stand out"
        lines.append(f"Record {again}, and all else little, to see what remains there.")
    return " ".join(lines)


def undetected(
    candidates: Sequence[Candidate],
    null: Null,
    base: float,
    told_parameters: Collection[str],
    model: Model,
    added: str = "",
    adrift: bool = False,
) -> dict[str, str]:
    """Return for each effect that was not found how large it may be without being seen.

    `base` is the likelihood without it, `told` are the effects that were found or are in a tie, `added` the one that was added
    after these candidates were tried. With `adrift` nobody knows how the positions of the records lie beside each other.
    """
    found: dict[str, str] = {}
    for c in candidates:
        if c.name in told_parameters:
            continue
        if c.fit is None:
            found[c.name] = c.refused
            continue
        gain = c.fit.total - base
        seen = f"something like it shows (gain {gain:.0f} nats), but too little of it, or nothing where it was not sought"
        if added:
            seen = f"before {added} was added it gained {gain:.0f} nats; beside that nothing shows it"
        found[c.name] = seen if gain > null.level(c.name) else _limit(c, null, model)
        if adrift and find_effect(c.name).position_dependent:
            found[c.name] += "; all this if the records begin at the same position"
    return found


def _limit(c: Candidate, null: Null, model: Model) -> str:
    effect = find_effect(c.name)
    shows = f"what shows it: {effect.excitation}"
    strength = effect.parameters[0]
    proportional = strength.minimum <= 0 <= strength.maximum and not effect.sparse  # nothing is left of it at zero
    if c.fit is None or not proportional or strength.name not in [f.name for f in c.fit.free]:
        return f"tried, and no trace of it; {shows}"
    place = [f.name for f in c.fit.free].index(strength.name)
    if others := c.fit.collinear_with(place):
        return f"these records cannot tell it from {', '.join(others)}; {shows}"
    spread = float(np.linalg.pinv(c.fit.information, rcond=1e-12, hermitian=True)[place, place])
    limit = math.sqrt(2 * null.level(c.name) * max(spread, 0.0))
    if not math.isfinite(limit) or limit == 0 or limit > min(strength.maximum, 1e5):
        return f"these records cannot show it; {shows}"
    unit = model.unit(strength.name)
    return f"{strength.description}: more than {limit:.2g}{'' if unit == '1' else ' ' + unit} would have been seen"


def rounded(value: float, low: float, high: float) -> tuple[tuple[str, str, str, str], int] | None:
    """Return value, low, high and half the interval as texts, and the power of ten they are given in.

    They end with the second digit of the half width, and at the sixth of the value at the latest: an interval that is
    narrower is given as wide as that digit. None where there is no interval.
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
    mid, below, above, spread = (f"{x / 10.0**power:z.{max(0, power - last)}f}" for x in (value, low, high, half))
    return (mid, below, above, spread), power


def told_parameters(e: Named) -> dict[str, Estimate]:
    """Return the parameters of an effect that a sentence gives: without those of its form or of a second term, if the effect
    may be without them."""
    known = find_effect(e.name)
    defaults = {p.name.split(".")[1]: p.default for p in known.parameters}

    def idle(names: Iterable[str]) -> bool:
        found = [(defaults[name], e.parameters[name].ci95) for name in names if name in e.parameters]
        return all(ci is not None and ci[0] <= default <= ci[1] for default, ci in found)

    left_out = {
        *(known.shape_parameters if idle(known.shape_parameters) else ()),
        *(known.second_term if idle(known.second_term[:1]) else ()),
    }
    return {name: estimate for name, estimate in e.parameters.items() if name not in left_out}


def plain_texts(e: Estimate) -> tuple[str, str, str]:
    """Return an estimate and the ends of its interval as plain texts; the ends are empty where there is none."""
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
    length = f", a period of {2e3 * math.pi / e.value:.5g} mm" if e.unit == "rad/m" and e.value else ""
    return f"{mid}{unit} ({low} to {high}){length}" if low else f"{mid}{unit} (uncertain){length}"


def statement(
    verdict: str,
    effects: Sequence[Named],
    ties: Sequence[Sequence[str]],
    gap: Gap,
    remains: Remains,
    base: Mapping[str, Estimate],
    mute: Sequence[str] = (),
) -> tuple[str, ...]:
    """Return the answer, one sentence or two a line; `mute` are the model's parameters if the records tell none of them."""
    lines = []
    for e in effects:
        found = ", ".join(f"{name} {value(estimate)}" for name, estimate in told_parameters(e).items())
        lines.append(f"Missing: {words(e.name)} ({e.name}); {found}; p ≤ {e.p:.2g}.")
    for tie in ties:
        whole = " and ".join(tie) if len(tie) == 2 else ", ".join(tie)
        lines.append(f"These records do not tell {whole} apart.")
    if verdict == "none":
        lines.append("No effect explains more than chance would, or enough to matter.")
    if mute:
        lines.append(
            f"The output hardly follows the input: not even {', '.join(mute)} can be told from these records, let alone what is "
            "missing. Check the columns in [input] and [output], or give records that move more."
        )
    elif verdict == "not_identifiable":
        why = "too many effects explain it alike" if ties else "the records are too poor to tell what"
        lines.append(f"Something is missing, but {why}: these records do not name it.")
    rms = [math.sqrt(x) if x is not None and x >= 0 else math.nan for x in (gap.before, gap.after, gap.noise_floor)]
    most = "at most " if remains.flag else ""  # what is unexplained looks like noise
    alone = f"disturbance and sensor alone give {most}{rms[2]:.3g} {gap.output_unit}"
    if gap.noise_floor is None:
        alone = "disturbance and sensor alone give less, but how much less is not known"
    elif rms[2] >= rms[1]:
        alone = "disturbance and sensor alone give as much"
    if effects:
        fallen = f"falls from {rms[0]:.3g} to {rms[1]:.3g} {gap.output_unit}; {alone}"
        if rms[1] >= rms[0]:
            fallen = f"does not fall ({rms[0]:.3g} {gap.output_unit} before, {rms[1]:.3g} {gap.output_unit} after): {OUTLIER_NOTE}"
        lines.append(f"On stretches kept from the search the rms error of the output {fallen}.")
    else:
        lines.append(f"The rms error of the output is {rms[0]:.3g} {gap.output_unit} with refitted parameters; {alone}.")
    if remains.flag:
        follows = f"{remains.share:.0%} of the residual follows {view_name(remains.view or '', remains.label)}"
        if remains.view == OUTLIERS and remains.label:
            follows = f"{remains.share:.0%} of the residual lies in {remains.label}"
        taken = f"it would take a disturbance of {remains.disturbance:.0%} of the input's torque, and no view shows where it lives"
        shows = taken if remains.view is None else follows
        without = "Without any of these" if ties and not effects else "Something remains that none of the effects explains"
        lines.append(f"{without}: {shows}.")
    return (*lines, *_at_ends(base))


def _at_ends(base: Mapping[str, Estimate]) -> Iterator[str]:
    """Give a line each on parameters of the model and of effects that end at a bound; only the former have one in [bounds]."""
    stuck = [name for name, estimate in base.items() if estimate.at_bound]
    own = [name for name in stuck if name.split(".")[0] not in all_effects()]
    if own:
        yield f"The refit of {', '.join(own)} ends at a bound: widen it in [bounds], or check units and signs."
    if others := [name for name in stuck if name not in own]:
        yield f"{', '.join(others)} at the end of what may be: a limit, no estimate; the effect may be there for something else."
