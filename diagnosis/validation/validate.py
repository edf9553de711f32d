"""A model or a plant FMU against records that it was not fitted to: simulated in open loop, from
the start of each to its end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from bristle.common.metrics import fit_percent, mse_percent, rms
from bristle.diagnosis.answer import (
    Finding,
    Line,
    Reason,
    ValidatedRecord,
    Validation,
    finding,
)
from bristle.diagnosis.estimation.dataset import SEGMENT_SECONDS
from bristle.diagnosis.estimation.simulator import (
    Servo,
    fixed_values,
)
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.validation.fmu_simulation import FmuSimulator
from bristle.diagnosis.validation.long_simulation import OpenLoop, Records, open_loop
from bristle.fmus.host import Fmu
from bristle.plant.effects import effect as find_effect
from bristle.records.clock import one_after_the_other, overlap
from bristle.records.record import Record

# records, and the horizon [s] after which it begins anew
Simulated = Callable[[Records, float], OpenLoop | None]


def validated(
    name: str,
    model: Model,
    records: Sequence[Record],
    simulate: Simulated,
    notes: Sequence[Line] = (),
) -> Validation:
    """Return the errors of a simulation of each record; `notes` go before those of the records."""
    rows = tuple(_row(r, model, simulate) for r in records)
    own = (line for r in records for line in r.findings)
    return Validation(name, model.output_kind, rows, (*notes, *own))


def model_simulation(model: Model, h: float) -> Simulated:
    """Return what simulates a model, only its starts fitted; `h` [s] is the sampling period."""
    servo, values = (
        Servo(model.friction, tuple(model.effects), (), (), fixed_values(h), False),
        model.settings(),
    )
    return lambda own, seconds: open_loop(servo, values, own, seconds)


def validated_fmu(
    fmu: Fmu,
    model: Model,
    records: Sequence[Record],
    notes: Sequence[Line],
    timeout: float | None = None,
) -> Validation:
    """Return the errors of a plant FMU, run from the measured state where it can be; how it was run
    goes before the `notes`.
    """
    simulator = FmuSimulator(fmu, model.output_kind == "velocity", timeout)
    validation = validated(fmu.path.name, model, records, simulator.open_loop, notes)
    return replace(validation, notes=(*simulator.notes(), *validation.notes))


def on_one_clock(model: Model, records: Sequence[Record]) -> tuple[Sequence[Record], list[Finding]]:
    """Return the records with the times that an event of the model counts by, and what is said of
    that.

    Where each record has a clock of its own, a diagnosis lets them follow one another, and so does
    this.
    """
    timed = {name: kind for name in model.effects if (kind := find_effect(name).timing)}
    if not timed or not overlap((float(r.time[0]), float(r.time[-1])) for r in records):
        return records, []
    notes = [finding(Reason.BEGINS_ANEW, effect=e) for e, kind in timed.items() if kind == "course"]
    events = tuple(name for name, kind in timed.items() if kind == "event")
    if not events:
        return records, notes
    first = min(float(r.time[0]) for r in records)
    begins = one_after_the_other(first, [len(r) * r.h for r in records])
    moved = [
        replace(r, time=r.time - r.time[0] + begin)
        for r, begin in zip(records, begins, strict=True)
    ]
    order = tuple(r.name for r in records)
    notes.append(finding(Reason.ONE_AFTER_THE_OTHER, effects=events, records=order))
    return moved, notes


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
