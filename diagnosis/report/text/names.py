"""Names and numbers in words: views, effects, lists, values with their intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from bristle.diagnosis.answer import OUTLIERS, Estimate, Line, Named
from bristle.diagnosis.report.text.said import said
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects
from bristle.plant.wording import ROTARY, Wording

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


# -- names -----------------------------------------------------------------------------------------
def view_name(view: str, label: Line = "") -> str:
    """Return a view in words, with what was found in it: "theta", "7 in a turn" is position (7 in a
    turn).
    """
    first, _, second = view.partition(" x ")
    names = [AXES.get(part, (part, ""))[0] for part in (first, second) if part]
    return " × ".join(names) + (f" ({said(label)})" if label else "")


def effect_name(name: str, wording: Wording = ROTARY) -> str:
    """Return an effect in words, its identifier in brackets; another name stays as it is."""
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
    """Return an estimate and the ends of its interval as texts; the ends are empty without one."""
    texts_and_power = rounded(e.value, *e.ci95) if e.ci95 else None
    if texts_and_power is None:
        return f"{e.value:.4g}", "", ""
    (mid, low, high, _), power = texts_and_power
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
        intervals = [
            (defaults[name], e.parameters[name].ci95) for name in names if name in e.parameters
        ]
        return all(ci is not None and ci[0] <= default <= ci[1] for default, ci in intervals)

    left_out = {*known.shape_parameters} if idle(known.shape_parameters) else set()
    left_out |= {*known.second_term} if idle(known.second_term[:1]) else set()
    return {name: estimate for name, estimate in e.parameters.items() if name not in left_out}
