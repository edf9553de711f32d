"""Diagnoses of the four measured data sets: the question, the right answers, the result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import measured_data as measured
import numpy as np
from measured_data import Array, Entry

from bristle.diagnosis import Diagnosis, Model, Record, diagnose, records_from_arrays
from bristle.diagnosis.checks.plausibility import check
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.estimation.fitted_model import fit_with_noise
from bristle.diagnosis.report.text.said import said
from bristle.diagnosis.sliding.stretches import smooth

INPUT_UNITS = {"torque": "N.m", "voltage": "V", "current": "A"}


@dataclass(frozen=True)
class Run:
    """One diagnosis: the question, the sets of effects that count as right, the result; further
    numbers with their names.
    """

    name: str
    question: str
    wanted: tuple[frozenset[str], ...]  # names of effects, any of these sets
    records: tuple[Record, ...]
    found: Diagnosis
    numbers: dict[str, str] = field(default_factory=dict)
    data: dict[str, Any] = field(default_factory=dict)  # for the figures

    @property
    def said(self) -> str:
        """The result in a few words."""
        if self.found.verdict == "named":
            tied = {name for tie in self.found.ties for name in tie}
            return " + ".join(
                _with_rivals(e.name, self.found.ties if e.name in tied else ())
                for e in self.found.effects
            )
        if self.found.verdict == "tie":
            return "tie of " + ", ".join(" / ".join(tie) for tie in self.found.ties)
        return self.found.verdict.replace("_", " ")

    @property
    def right(self) -> bool:
        """True if the effects named are one of the sets that count as right, or may be by the ties
        of their classes.
        """
        each = [
            {e.name, *(name for tie in self.found.ties if e.name in tie for name in tie)}
            for e in self.found.effects
        ]
        return any(frozenset(names) in self.wanted for names in product(*each))


def _with_rivals(name: str, ties: Sequence[Sequence[str]]) -> str:
    others = [other for tie in ties if name in tie for other in tie if other != name]
    return f"{name} (or {', '.join(others)})" if others else name


def declared(kind: str, parameters: dict[str, float], output: str = "rad", **more: Any) -> Model:
    """Return a model with Coulomb friction; its bounds are those that a model file without bounds
    has.
    """
    tables = {
        "friction": "coulomb",
        "parameters": parameters,
        "time": {"column": "t", "unit": "s"},
        "input": {"column": "u", "kind": kind, "unit": INPUT_UNITS[kind]},
        "output": {"column": "y", "kind": "position", "unit": output},
    }
    return Model.from_dict(tables | more)


def taken(model: Model, entries: Sequence[Entry]) -> list[Record]:
    """Return entries as records for the diagnosis."""
    return records_from_arrays(model, [(name, t, u, y) for name, t, u, y, _ in entries])


# -- EMPS ------------------------------------------------------------------------------------------


def emps(tell: Callable[[str], None]) -> Iterator[Run]:
    """A linear axis whose friction differs by direction: the model has viscous and symmetric
    Coulomb friction.
    """
    [entry] = measured.emps()
    model = declared("voltage", {"J": 100.0, "a2": 150.0, "Fc": 30.0, "b": entry[4]["gain"]}, "m")
    records = taken(model, [entry])
    tell("emps")
    found = diagnose(model, records)
    whole = found.whole
    assert whole is not None
    [row], [trace] = whole.records, whole.traces
    numbers = {
        "open loop over the whole record, rms error": (
            f"{1e3 * row.rms_before:.2f} mm before, {1e3 * row.rms_after:.2f} mm after"
        ),
        "FIT over the whole record": f"{row.fit_before:.1f} % before, {row.fit_after:.1f} % after",
    }
    if whole.refitted:
        numbers["the same with the parameters of the segments"] = (
            f"{1e3 * whole.horizons[-1].segments:.2f} mm"
        )
    wanted = (
        frozenset({"bias"}),
        frozenset({"asymmetric_coulomb"}),
        frozenset({"asymmetric_viscous"}),
    )
    data = {
        "time": trace.time,
        "measured": trace.measured,
        "before": trace.before,
        "after": trace.after,
        "rmse": {"before": row.rms_before, "after": row.rms_after},
    }
    yield Run(
        "EMPS",
        "viscous and symmetric Coulomb friction given",
        wanted,
        tuple(records),
        found,
        numbers,
        data,
    )


# -- XL330 -----------------------------------------------------------------------------------------


def xl330(tell: Callable[[str], None]) -> Iterator[Run]:
    """A pendulum whose weight is missing from the model: half a kilogram at 0.1 m, at four gains of
    its position loop.
    """
    model = declared("voltage", {"J": 0.005, "a2": 0.03, "Fc": 0.04, "b": 0.1})
    records = taken(model, measured.xl330())
    tell("xl330")
    found = diagnose(model, records)
    numbers = {}
    weight = next((e for e in found.effects if e.name == "gravity"), None)
    if weight is not None:
        ratio = weight.parameters["amplitude"].value / found.parameters["J"].value
        numbers["weight over inertia, A/J"] = f"{ratio:.1f} s⁻²"
    alone = frozenset({"gravity"})
    wanted = (alone, alone | {"load_friction"}, alone | {"load_friction", "back_emf"})
    yield Run("XL330", "gravity hidden", wanted, tuple(records), found, numbers)


# -- Go1 -------------------------------------------------------------------------------------------

ARM = 0.15  # m


def go1(tell: Callable[[str], None]) -> Iterator[Run]:
    """A leg motor with 0 to 3 kg: fitted without a load, then diagnosed with each."""
    model = declared("torque", {"J": 0.002, "a2": 0.02, "Fc": 0.02})
    tell("go1 without a load")
    records = taken(model, measured.go1(0.0))
    dataset = dataset_of(model, records)
    unloaded = fit_with_noise(dataset, *base_servo_of(model, dataset)).fit.values
    own = {name: float(unloaded[name]) for name in ("J", "a2", "coulomb.Fc")}
    for mass in (1.0, 2.0, 3.0):
        entries = measured.go1(mass)
        known = declared("torque", {"J": own["J"], "a2": own["a2"], "Fc": own["coulomb.Fc"]})
        loaded = taken(known, entries)
        tell(f"go1 with {mass:g} kg")
        found = diagnose(known, loaded)
        numbers = {
            "inertia": f"{found.parameters['J'].value:.3g} kg·m²" if found.parameters else "–"
        }
        data: dict[str, Any] = {"mass": mass}
        weight = next((e for e in found.effects if e.name == "gravity"), None)
        if weight is not None:
            data |= {"A": weight.parameters["amplitude"], "J": found.parameters["J"]}
            gear = mass * 9.81 * ARM / weight.parameters["amplitude"].value
            numbers["weight by the arm over what was found"] = f"{gear:.2f}"
        numbers["with the inertia of the load and bounds of 60 % given"] = _warned(
            mass, own, entries
        )
        yield Run(
            f"Go1, {mass:g} kg",
            "fitted without a load",
            (frozenset({"gravity"}),),
            tuple(loaded),
            found,
            numbers,
            data,
        )


def _warned(mass: float, own: dict[str, float], entries: Sequence[Entry]) -> str:
    """Return the findings of the plausibility check if mass and arm are known and the torque is
    taken for that of the joint.
    """
    inertia = mass * ARM**2 + own["J"]
    bounds = {"J": [0.6 * inertia, 1.6 * inertia], "a2": [0.0, 1.0], "Fc": [0.0, 1.0]}
    model = declared(
        "torque", {"J": inertia, "a2": own["a2"], "Fc": own["coulomb.Fc"]}, bounds=bounds
    )
    found = check(model, taken(model, entries))
    return "; ".join(map(said, (*found.corrections, *found.notes))) or "nothing"


# -- ODrive ----------------------------------------------------------------------------------------

# ripple over that without compensation, below which it is gone, much smaller
GONE_BELOW, SMALLER_BELOW = 0.05, 0.5


def odrive(tell: Callable[[str], None]) -> Iterator[Run]:
    """A brushless motor turned slowly, its cogging compensated or not; the current is the input,
    the position the output.
    """
    plain = math.nan  # ripple without the compensation
    for compensated in (False, True):
        model = declared("current", {"J": 2.5e-4, "a2": 1e-3, "Fc": 5e-3, "b": 7.5e-3})
        entries = measured.odrive(compensated)
        records = taken(model, entries)
        word = "on" if compensated else "off"
        tell(f"odrive, compensation {word}")
        found = diagnose(model, records)
        ripple = float(np.sqrt(np.mean([_ripple(t, y) ** 2 for _, t, _, y, _ in entries])))
        numbers = {"ripple of the position, rms": f"{1e3 * ripple / (2 * math.pi):.2f}e-3 turns"}
        if compensated:
            numbers["cogging in the motion"] = (
                f"{ripple / plain:.0%} of that without compensation: {_weakened(ripple / plain)}"
            )
        plain = ripple
        periods, amplitude, share = _strongest(records, model.parameters["b"])
        seen = f"{1e3 * amplitude:.2f}e-3 N·m, {periods} in a turn, {share:.0%} of its variance"
        numbers["strongest wave of the motor's torque along the position"] = seen
        # a compensated effect may be invisible
        wanted = (frozenset({"cogging"}), *([frozenset[str]()] if compensated else []))
        data = {"compensated": compensated, "gain": model.parameters["b"]}
        question = "cogging hidden, compensated by the drive" if compensated else "cogging hidden"
        yield Run(
            f"ODrive, compensation {word}", question, wanted, tuple(records), found, numbers, data
        )


def _weakened(ratio: float) -> str:
    """Return in words how much of an effect is left."""
    return (
        "gone"
        if ratio < GONE_BELOW
        else "much smaller, not gone"
        if ratio < SMALLER_BELOW
        else "not compensated"
    )


def _ripple(t: Array, y: Array) -> float:
    """Return the rms deviation of the position from a cubic in time; the loop's own start and end
    are left out.
    """
    inside = slice(200, -200)
    x = t[inside] - t[inside].mean()
    return float(np.std(y[inside] - np.polyval(np.polyfit(x, y[inside], 3), x)))


def _strongest(records: Sequence[Record], gain: float) -> tuple[int, float, float]:
    """Return the wave of the torque along the position that explains most: periods in a turn,
    amplitude, share.
    """
    theta, torque = (
        np.concatenate(x) for x in zip(*(torque_along(r, gain) for r in records), strict=True)
    )
    torque = torque - torque.mean()
    best = (0, 0.0, 0.0)
    for n in range(1, 61):
        waves = np.column_stack([np.sin(n * theta), np.cos(n * theta)])
        c, *_ = np.linalg.lstsq(waves, torque, rcond=None)
        share = 1 - float(np.var(torque - waves @ c) / np.var(torque))
        best = max(best, (n, float(np.hypot(*c)), share), key=lambda each: each[2])
    return best


def torque_along(record: Record, gain: float) -> tuple[Array, Array]:
    """Return position [rad] and motor torque [N.m], smoothed, of a record."""
    return record.y, gain * smooth(record.u, record.h, 0.02)


FOLDERS: dict[str, tuple[str, Callable[[Callable[[str], None]], Iterator[Run]]]] = {
    "emps": ("EMPS: a linear axis with a worn screw", emps),
    "bam_xl330_gain": ("XL330: a small servo with a hidden weight", xl330),
    "bam_go1_load": ("Go1: a leg motor under load", go1),
    "odrive_cogging": ("ODrive: a motor with and without its compensation", odrive),
}
