"""A measured record as an observer reads it: voltage, position and velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.harness.scenario import Loaded
from bristle.records import Layout, Record, read_record
from bristle.records.layout import layout_of

STEP_TOLERANCE = 0.01  # fraction by which the scenario's step may differ from the record's sampling period


@dataclass(frozen=True)
class Samples:
    """A record in SI units, uniformly sampled; arrays have shape (n,)."""

    h: float  # sampling period [s]
    u: Array  # voltage [V]
    theta: Array  # position [rad]
    v: Array  # velocity [rad/s]
    measured: tuple[str, ...]  # which of theta and v were measured; the other one follows from it
    findings: tuple[str, ...] = ()  # what was found in the record and repaired, one line each

    def __len__(self) -> int:
        return len(self.u)


def read_samples(loaded: Loaded) -> Samples:
    """Read the record that a scenario names; raise `BristleError`, one line, where observers cannot read it."""
    scenario = loaded.scenario
    assert scenario.record is not None
    layout = _layout(loaded)
    try:
        record = read_record(layout, loaded.beside(scenario.record.file))
    except BristleError as error:
        raise loaded.error("record.file", scenario.record.file, str(error)) from None
    if "step" in scenario.model_fields_set and abs(scenario.step - record.h) > STEP_TOLERANCE * record.h:
        raise loaded.error("step", f"{scenario.step:g} s", f"the record is sampled every {record.h:g} s; leave step out")
    count = len(record)
    if scenario.duration is not None:
        count = round(scenario.duration / record.h) + 1
        if count > len(record):
            longest = f"the record ends after {(len(record) - 1) * record.h:g} s"
            raise loaded.error("duration", f"{scenario.duration:g} s", f"{longest}; shorten it or leave it out")
    theta, v, measured = _motion(layout, record)
    return Samples(record.h, record.u[:count], theta[:count], v[:count], measured, record.findings)


def _layout(loaded: Loaded) -> Layout:
    """Return the layout of the record, which an observer must be able to read."""
    table = loaded.scenario.record
    assert table is not None
    if table.input.kind != "voltage":
        message = 'observers read a voltage; write kind = "voltage", and scale = "... V" over the unit of a command that is none'
        raise loaded.error("record.input.kind", table.input.kind, message)
    if layout_of(table, loaded.path, "record.").linear:
        message = 'observers read rad; add scale, the angle that stands for one of this unit, for example "1 rad/m"'
        raise loaded.error("record.output.unit", table.output.unit, message)
    return layout_of(table, loaded.path, "record.", table.velocity)


def _motion(layout: Layout, record: Record) -> tuple[Array, Array, tuple[str, ...]]:
    """Return position [rad], velocity [rad/s], and which of them were measured.

    A position alone gives the velocity as a backward difference, as a counter does; a velocity alone gives the position as its
    integral from 0 by the trapezoidal rule.
    """
    if layout.output_kind == "velocity":
        v = record.y
        return np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * record.h / 2)]), v, ("v",)
    if record.velocity is not None:
        return record.y, record.velocity, ("theta", "v")
    steps = np.diff(record.y) / record.h
    return record.y, np.concatenate([steps[:1], steps]), ("theta",)
