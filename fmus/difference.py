"""What differs between two FMUs: for a host that uses the first one, in its start values, and in
what it computes.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.fmus.host import Fmu
from bristle.fmus.response import respond

Array = NDArray[np.float64]

LONGEST_COMPARISON = 20_000  # steps of the default experiment that are compared, at most
USUAL_STEPS = 1000  # steps where the default experiment gives no step size
EQUAL_SHARE = 1e-6  # of a signal's range: largest difference that is none
# periods in the experiment of the two sines that each input follows, times its place among the
# inputs
INPUT_WAVES = (0.9, 3.1)
PUBLIC = (
    "input",
    "output",
    "parameter",
    "calculatedParameter",
    "structuralParameter",
    "independent",
)
ABILITIES = {  # of Co-Simulation and Model Exchange; what it means to lose one
    "canGetAndSetFMUstate": "its state can be stored and restored",
    "canSerializeFMUstate": "its state can be written to a file",
    "providesDirectionalDerivative": "it gives directional derivatives",
    "canHandleVariableCommunicationStepSize": "steps may differ in size",
    "canInterpolateInputs": "it interpolates inputs",
    "hasEventMode": "it has an event mode",
}
DEMANDS = {  # what it means to gain one
    "needsExecutionTool": "it needs another program to run",
    "canBeInstantiatedOnlyOncePerProcess": "there may be one instance a process only",
}


class Change(StrEnum):
    """Kinds of differences. A host that works with the first FMU may notice the first four with the
    second one.
    """

    breaking = "breaking"
    default = "default"
    behaviour = "behaviour"
    unknown = "unknown"
    addition = "addition"
    note = "note"


HARMLESS = (Change.addition, Change.note)


@dataclass(frozen=True)
class Difference:
    """One difference: its kind, where it is (such as "parameter J"), and what it is, in words."""

    change: Change
    place: str
    text: str


def fmu_differences(first: Fmu, second: Fmu) -> list[Difference]:
    """Return what differs between two FMUs, the most serious first: interface, starts, behaviour.

    Parameters
    ----------
    first, second : Fmu
        The one that is used, and the one that is to take its place. Both run in processes of their
        own.

    Raises
    ------
    BristleError
        If the first one cannot be simulated over its default experiment.
    """
    found = [*_interface(first, second), *_variables(first, second), *_experiment(first, second)]
    found += _behaviour(first, second)
    order = list(Change)
    return sorted(found, key=lambda d: order.index(d.change))


# -- interface -------------------------------------------------------------------------------------
def _interface(first: Fmu, second: Fmu) -> Iterator[Difference]:
    """Give what differs beside variables and the experiment."""
    a, b = first.description, second.description
    if first.fmi != second.fmi:
        yield Difference(Change.breaking, "FMU", f"FMI {a.fmiVersion} became FMI {b.fmiVersion}")
    for kind, name in (("coSimulation", "Co-Simulation"), ("modelExchange", "Model Exchange")):
        old, new = getattr(a, kind), getattr(b, kind)
        if old is not None and new is not None:
            yield from _abilities(name, old, new)
        elif old is not new:
            yield _lost_or_new("FMU", name, lost=new is None)
    before, after = _platforms(first), _platforms(second)
    for platform in sorted(before ^ after):
        yield _lost_or_new("FMU", f"binary for {platform}", lost=platform in before)
    for attribute, name in (
        ("guid", "token"),
        ("modelName", "model name"),
        ("generationTool", "tool"),
    ):
        old, new = getattr(a, attribute), getattr(b, attribute)
        if old != new:
            yield Difference(Change.note, "FMU", f"{name} {old} became {new}")


def _abilities(kind: str, old: Any, new: Any) -> Iterator[Difference]:
    if old.modelIdentifier != new.modelIdentifier:
        yield Difference(
            Change.note, kind, f"modelIdentifier {old.modelIdentifier} became {new.modelIdentifier}"
        )
    for table, wanted in ((ABILITIES, True), (DEMANDS, False)):
        for attribute, meaning in table.items():
            before, after = (bool(getattr(each, attribute, not wanted)) for each in (old, new))
            if before != after:
                change = Change.breaking if before is wanted else Change.addition
                yield Difference(
                    change,
                    kind,
                    f"{attribute} is now {str(after).lower()} ({meaning}:"
                    f" {'yes' if after else 'no'})",
                )


def _lost_or_new(place: str, what: str, *, lost: bool) -> Difference:
    return Difference(
        Change.breaking if lost else Change.addition,
        place,
        f"{what} {'is gone' if lost else 'is new'}",
    )


def _platforms(fmu: Fmu) -> set[str]:
    with zipfile.ZipFile(fmu.path) as archive:
        parts = (name.split("/") for name in archive.namelist())
        return {each[1] for each in parts if len(each) > 2 and each[0] == "binaries" and each[2]}


# -- variables -------------------------------------------------------------------------------------
def _variables(first: Fmu, second: Fmu) -> Iterator[Difference]:
    """Give what differs in variables, by name."""
    for name, old in first.variables.items():
        place, new = f"{old.causality} {name}", second.variables.get(name)
        if new is None:
            change = Change.breaking if old.causality in PUBLIC else Change.note
            yield Difference(change, place, "is gone")
        else:
            yield from _variable(first, second, name)
    for name, new in second.variables.items():
        if name not in first.variables:
            yield Difference(Change.addition, f"{new.causality} {name}", "is new")


def _variable(first: Fmu, second: Fmu, name: str) -> Iterator[Difference]:
    """Give what differs in a variable that both have."""
    old, new = first.variables[name], second.variables[name]
    place, settable = (
        f"{old.causality} {name}",
        old.causality in ("input", "parameter", "structuralParameter"),
    )
    for what, before, after in (
        ("type", _type(old), _type(new)),
        ("causality", old.causality, new.causality),
        ("unit", first.unit(name), second.unit(name)),
        ("dimensions", _shape(old), _shape(new)),
    ):
        if before != after:
            yield Difference(Change.breaking, place, f"{what} {before} became {after}")
    if old.variability != new.variability:
        stricter = (old.variability, new.variability) == ("tunable", "fixed")
        change = Change.breaking if stricter else Change.addition if settable else Change.note
        yield Difference(change, place, f"variability {old.variability} became {new.variability}")
    yield from _range(place, first.interval(name), second.interval(name), settable)
    yield from _items(place, first.choices(name), second.choices(name))
    if settable and _number(old.start) != _number(new.start):
        yield Difference(Change.default, place, f"start value {old.start} became {new.start}")
    if old.valueReference != new.valueReference:
        yield Difference(
            Change.note, place, f"value reference {old.valueReference} became {new.valueReference}"
        )


def _type(v: Any) -> str:
    return {"Real": "Float64", "Integer": "Int32"}.get(v.type, str(v.type))


def _shape(v: Any) -> list[str]:
    return [str(d.start) for d in v.dimensions]


def _number(text: object) -> object:
    """Return a start value so that other spellings of it are equal: 1, 1.0 and 1e0; true and 1."""
    try:
        return float({"true": "1", "false": "0"}.get(str(text), str(text)))
    except ValueError:
        return text


def _range(
    place: str, before: tuple[float, float], after: tuple[float, float], settable: bool
) -> Iterator[Difference]:
    if before != after:
        narrower = after[0] > before[0] or after[1] < before[1]
        change = Change.note if not settable else Change.breaking if narrower else Change.addition
        yield Difference(
            change,
            place,
            f"range {before[0]:g} to {before[1]:g} became {after[0]:g} to {after[1]:g}",
        )


def _items(place: str, before: Mapping[str, int], after: Mapping[str, int]) -> Iterator[Difference]:
    """Give what differs in the items of an enumeration; hosts store their numbers."""
    for name, value in before.items():
        if after.get(name) != value:
            now = f"became {after[name]}" if name in after else "is gone"
            yield Difference(Change.breaking, place, f"item {name} = {value} {now}")
    for name in after:
        if name not in before:
            yield Difference(Change.addition, place, f"item {name} is new")


# -- experiment and behaviour ----------------------------------------------------------------------
def _experiment(first: Fmu, second: Fmu) -> Iterator[Difference]:
    old, new = first.description.defaultExperiment, second.description.defaultExperiment
    for attribute in ("startTime", "stopTime", "stepSize", "tolerance"):
        before, after = (_number(getattr(each, attribute, None)) for each in (old, new))
        if before != after:
            yield Difference(
                Change.default, "default experiment", f"{attribute} {before} became {after}"
            )


def _behaviour(first: Fmu, second: Fmu) -> Iterator[Difference]:
    """Give the outputs that differ over the default experiment of the first one, its inputs moved
    within their ranges.
    """
    common = [
        n
        for n in first.names("output")
        if first.is_real(n) and second.has(n, "output") and second.is_real(n)
    ]
    start, h, steps = _steps(first)
    moved = {
        n: wave
        for n, wave in _waves(first, steps).items()
        if second.has(n, "input") and second.is_real(n)
    }
    runs = []
    for fmu in (first, second):
        try:
            runs.append(respond(fmu, h, steps, moved, common, start=start))
        except BristleError as error:
            if fmu is first:
                raise
            yield Difference(
                Change.behaviour, "default experiment", f"cannot be simulated: {error}"
            )
            return
    for name, a, b in zip(common, runs[0].T, runs[1].T, strict=True):
        scale = float(max(np.ptp(a), np.max(np.abs(a)) * EQUAL_SHARE, np.finfo(float).tiny))
        off = np.abs(b - a) / scale
        bad = np.flatnonzero(~(off <= EQUAL_SHARE))
        if len(bad):
            worst = float(np.max(np.where(np.isfinite(off), off, math.inf)))
            text = (
                f"differs from {bad[0] * h:.4g} s on, by {worst:.2g} of its range at most, with the"
                " same inputs"
            )
            yield Difference(Change.behaviour, f"output {name}", text)


def _steps(fmu: Fmu) -> tuple[float, float, int]:
    """Return start [s], step size [s] and number of steps of the default experiment."""
    given = fmu.description.defaultExperiment
    start, stop, h = (
        _time(getattr(given, name, None)) for name in ("startTime", "stopTime", "stepSize")
    )
    start = start or 0.0
    duration = (1.0 if stop is None else stop) - start
    h = duration / USUAL_STEPS if h is None else h
    return start, h, max(1, min(LONGEST_COMPARISON, round(duration / h)))


def _time(text: object) -> float | None:
    value = None if text is None else float(str(text))
    return value if value is not None and math.isfinite(value) else None


def _waves(fmu: Fmu, steps: int) -> dict[str, Array]:
    """Return for each real input two sines around its start value, within its range."""
    t, found = np.arange(steps) / steps, {}
    for k, name in enumerate((n for n in fmu.names("input") if fmu.is_real(n)), start=1):
        low, high = fmu.interval(name)
        start = fmu.start(name) if fmu.variables[name].start is not None else 0.0
        usual = float(fmu.variables[name].nominal or abs(start) or 1.0)
        size = min(
            [
                usual,
                *(abs(end - start) for end in (low, high) if math.isfinite(end) and end != start),
            ]
        )
        wave = sum(np.sin(2 * np.pi * w * k * t) for w in INPUT_WAVES) / 2
        found[name] = np.clip(start + size * np.asarray(wave), low, high)
    return found
