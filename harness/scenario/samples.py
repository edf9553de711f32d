"""A measured record as an observer reads it: input, position and velocity, and their units."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.common.toml import mistake
from bristle.harness.scenario.reading import Loaded
from bristle.harness.scenario.rig import Rig, normalising
from bristle.records import Layout, Record, read_record
from bristle.records.layout import SETPOINT, layout_of
from bristle.records.resolution import noise_step

# fraction by which the scenario's step may differ from the record's sampling period
STEP_TOLERANCE = 0.01
# s, shortest and longest sampling period that observers are tried at
TRIED_PERIODS = (0.5e-3, 20e-3)


@dataclass(frozen=True)
class Samples:
    """A record in SI units, uniformly sampled; arrays have shape (n,)."""

    h: float  # sampling period [s]
    u: Array  # input, in the unit of the rig
    theta: Array  # position [rad or m]
    v: Array  # velocity [rad/s or m/s]
    measured: tuple[str, ...]  # which of theta and v were measured; the other one follows from it
    findings: tuple[str, ...] = ()  # what was found in the record and repaired, one line each
    rig: Rig = field(default_factory=Rig)  # units, and the scales that an observer reads them in
    # step of the position sensor [rad or m]; None: no position was measured
    resolution: float | None = None

    def __len__(self) -> int:
        return len(self.u)


def read_samples(loaded: Loaded) -> Samples:
    """Read the record that a scenario names; `BristleError` where observers cannot read it."""
    scenario = loaded.scenario
    assert scenario.record is not None
    layout = layout_of(scenario.record, loaded.path, "record.", scenario.record.velocity)
    if layout.input_kind == SETPOINT:
        said = (
            "the observers need what drives the servo; give the torque, force, voltage or current"
        )
        raise mistake(loaded.path, "record.input.kind", SETPOINT, said)
    try:
        record = read_record(layout, loaded.beside(scenario.record.file))
    except BristleError as error:
        raise loaded.error("record.file", scenario.record.file, str(error)) from None
    if (
        "step" in scenario.model_fields_set
        and abs(scenario.step - record.h) > STEP_TOLERANCE * record.h
    ):
        raise loaded.error(
            "step",
            f"{scenario.step:g} s",
            f"the record is sampled every {record.h:g} s; leave step out",
        )
    # a shorter duration leaves the end of the record out
    count = len(record)
    if scenario.duration is not None:
        count = round(scenario.duration / record.h) + 1
        if count > len(record):
            longest = f"the record ends after {(len(record) - 1) * record.h:g} s"
            raise loaded.error(
                "duration", f"{scenario.duration:g} s", f"{longest}; shorten it or leave it out"
            )
    # position and velocity as the observer reads them, and the scales in which it does
    theta, v, measured = _motion(layout, record)
    rig = normalising(layout, record.h, record.y[:count], record.u[:count])
    findings = (*record.findings, *_untried(record))
    return Samples(
        record.h,
        record.u[:count],
        theta[:count],
        v[:count],
        measured,
        findings,
        rig,
        _position_step(layout, record),
    )


def _untried(record: Record) -> list[str]:
    """Return a line if the record is sampled faster or slower than the observers are tried."""
    shortest, longest = TRIED_PERIODS
    if shortest * (1 - STEP_TOLERANCE) <= record.h <= longest * (1 + STEP_TOLERANCE):
        return []
    tried = f"observers are tried at {shortest:g} to {longest:g} s: read their estimates with care"
    return [f"record {record.name}: sampled every {record.h:.6g} s; {tried}"]


def _position_step(layout: Layout, record: Record) -> float | None:
    """Return the step of the position sensor: as declared, else the coarser of what the readings
    show and of their noise.
    """
    if layout.output_kind == "velocity":
        return None
    return layout.resolution or max(record.resolution or 0.0, noise_step(record.y))


def _motion(layout: Layout, record: Record) -> tuple[Array, Array, tuple[str, ...]]:
    """Return position, velocity, and which of them were measured.

    A position alone gives the velocity as a backward difference, as a counter does; a velocity
    alone gives the position as its integral from 0 by the trapezoidal rule.
    """
    if layout.output_kind == "velocity":
        v = record.y
        return np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * record.h / 2)]), v, ("v",)
    if record.velocity is not None:
        return record.y, record.velocity, ("theta", "v")
    steps = np.diff(record.y) / record.h
    return record.y, np.concatenate([steps[:1], steps]), ("theta",)
