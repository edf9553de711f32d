"""A model or a plant FMU against records that it was not fitted to: simulated in open loop, from
the start of each to its end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.metrics import fit_percent, mse_percent, rms
from bristle.common.output import plain
from bristle.common.table import Array
from bristle.diagnosis.estimation.simulator import Servo
from bristle.diagnosis.fmu.open_loop import FmuSimulator
from bristle.diagnosis.fmu.workflow import plant_fmu, unit_lines
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.preparation import SEGMENT_SECONDS, fixed_values
from bristle.diagnosis.report.result import Trace
from bristle.diagnosis.report.text import begins_anew
from bristle.diagnosis.whole.open_loop import OpenLoop, Records, open_loop
from bristle.diagnosis.workflow import check_arguments
from bristle.plant.effects import effect as find_effect
from bristle.records.clock import one_after_the_other, overlap
from bristle.records.record import Record

# records, and the horizon [s] after which it begins anew
Simulated = Callable[[Records, float], OpenLoop | None]


@dataclass(frozen=True)
class ValidatedRecord:
    """A record in open loop: errors in `unit`, FIT and the error of eq. (25) in per cent; NaN where
    they cannot be given.

    `horizons`: (horizon [s], rms error); the last one is the whole record. `time` [s], `input`
    [SI], `measured`, `simulated`: sample by sample, shape (n,).
    """

    name: str
    unit: str
    rms: float
    fit_percent: float
    mse_percent: float
    horizons: tuple[tuple[float, float], ...]
    time: Array
    input: Array
    measured: Array
    simulated: Array

    @property
    def trace(self) -> Trace:
        """The signals, for a figure."""
        return Trace(
            self.name,
            self.time,
            self.input,
            self.measured,
            self.simulated,
            self.simulated,
            np.zeros(len(self.time), bool),
        )


@dataclass(frozen=True)
class Validation:
    """The result of a validation; `to_dict` gives the content of validation.json.

    Attributes
    ----------
    name : str
        What was validated: the name of a file, or of a friction law.
    kind : {"position", "velocity"}
        What was measured.
    records : tuple of ValidatedRecord
        Errors and signals of each record.
    findings : tuple of str
        Lines about the records and how the model was run.
    """

    name: str
    kind: str
    records: tuple[ValidatedRecord, ...]
    findings: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the errors of each record."""
        from bristle.common import pages

        return pages.render("bristle.diagnosis.report/validation_notebook.html", validation=self)

    def to_dict(self) -> dict[str, Any]:
        """Return what validation.json holds: plain numbers, lists and text, no NaN."""
        keys = ("name", "unit", "rms", "fit_percent", "mse_percent", "horizons")
        rows = [{key: getattr(record, key) for key in keys} for record in self.records]
        content: dict[str, Any] = plain(
            {"model": self.name, "records": rows, "findings": list(self.findings)}
        )
        return content


def validate(model: Model, records: Sequence[Record]) -> Validation:
    """Simulate a model over records in open loop, and compare.

    Parameters
    ----------
    model : Model
        From `load_model`: a model file, or the augmented.toml of a diagnosis. Nothing of it is
        fitted.
    records : sequence of Record
        From `load_records` or `records_from_arrays`. Position and velocity at their starts are
        fitted.

    Returns
    -------
    Validation
        Errors of every record over its whole length and over shorter horizons.

    Raises
    ------
    BristleError
        If there is no record, or the model cannot be simulated.
    """
    check_arguments(model, records)
    records, lines = _on_one_clock(model, records)
    servo = Servo(model.friction, tuple(model.effects), (), (), fixed_values(records[0].h), False)
    values = model.settings()
    name = model.friction if model.path is None else model.path.name
    found = _validated(
        name, model, records, lambda own, seconds: open_loop(servo, values, own, seconds)
    )
    return replace(found, findings=(*lines, *found.findings))


def validate_fmu(
    fmu_path: Path, model: Model, records: Sequence[Record], timeout: float | None = None
) -> Validation:
    """Simulate a plant FMU over records in open loop, and compare.

    Parameters
    ----------
    fmu_path : Path
        Co-Simulation FMU of FMI 2 or 3 with input u and output theta, or v where the records hold
        velocities. It runs in a process of its own. Where it can be started from the measured
        position and velocity, it is, and the position is fitted.
    model : Model
        What the records hold; `fmu_model`, or from a file.
    records : sequence of Record
        From `load_records` or `records_from_arrays`.
    timeout : float, optional
        Seconds that a simulation may take.

    Returns
    -------
    Validation
        As of `validate`; of an FMU that cannot be started from a given state, over whole records
        alone.

    Raises
    ------
    BristleError
        If the FMU cannot be read, lacks these variables, crashes, takes longer than `timeout` or
        refuses a step.
    """
    check_arguments(model, records)
    fmu = plant_fmu(fmu_path, model)
    simulator = FmuSimulator(fmu, model.output_kind == "velocity", timeout)
    found = _validated(fmu.path.name, model, records, simulator.open_loop)
    return replace(found, findings=(*simulator.lines(), *unit_lines(fmu, model), *found.findings))


def _on_one_clock(model: Model, records: Sequence[Record]) -> tuple[Sequence[Record], list[str]]:
    """Return the records with the times that an event of the model counts by, and a line that says
    so.

    Where each record has a clock of its own, a diagnosis lets them follow one another, and so does
    this.
    """
    timed = {name: kind for name in model.effects if (kind := find_effect(name).timing)}
    if not timed or not overlap((float(r.time[0]), float(r.time[-1])) for r in records):
        return records, []
    lines = [begins_anew(name) for name, kind in timed.items() if kind == "course"]
    events = [name for name, kind in timed.items() if kind == "event"]
    if not events:
        return records, lines
    begins = one_after_the_other(
        min(float(r.time[0]) for r in records), [len(r) * r.h for r in records]
    )
    moved = [
        replace(r, time=r.time - r.time[0] + begin)
        for r, begin in zip(records, begins, strict=True)
    ]
    order = ", ".join(r.name for r in records)
    return moved, [
        *lines,
        (
            f"{' and '.join(events)} by the time over the records one after the other, in the order"
            f" given: {order}"
        ),
    ]


def _validated(
    name: str, model: Model, records: Sequence[Record], simulate: Simulated
) -> Validation:
    rows = tuple(_row(r, model, simulate) for r in records)
    findings = tuple(line for r in records for line in r.findings)
    return Validation(name, model.output_kind, rows, findings)


def _row(record: Record, model: Model, simulate: Simulated) -> ValidatedRecord:
    resolution = model.resolution or record.resolution or 1e-12
    own = Records((record,), model.output_kind == "velocity", resolution, resolution / 3)
    curve = []
    for seconds in (SEGMENT_SECONDS, *own.horizons(SEGMENT_SECONDS)):
        loop = simulate(own, seconds)
        if loop is not None:
            curve.append((seconds, loop.error))
    assert loop is not None  # whole records are simulated anyhow
    [y], [seen] = loop.measured, loop.simulated
    errors = rms(y - seen), fit_percent(y, seen), mse_percent(y, seen)
    return ValidatedRecord(
        record.name,
        model.output_unit,
        *errors,
        tuple(curve),
        record.time[: len(y)],
        record.u[: len(y)],
        y,
        seen,
    )
