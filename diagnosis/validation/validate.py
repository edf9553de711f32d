"""A model or a plant FMU against records that it was not fitted to: simulated in open loop, from
the start of each to its end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from bristle.common.errors import BristleError
from bristle.common.metrics import fit_percent, mse_percent, rms
from bristle.common.table import Array
from bristle.diagnosis.answer import (
    AfterStart,
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
from bristle.diagnosis.validation.long_simulation import (
    OpenLoop,
    Records,
    open_loop,
    open_loop_after,
)
from bristle.fmus.host import Fmu
from bristle.plant.effects import effect as find_effect
from bristle.records.clock import one_after_the_other, overlap
from bristle.records.record import Record

LEAST_START_SAMPLES = 3  # of which position and velocity can be told


@dataclass(frozen=True)
class Simulation:
    """How what is validated is simulated over records; None where that is not possible.

    `anew`: beginning anew after so many seconds, with fitted starts; `after`: whole records, from
    starts that are fitted to so many samples at their beginning.
    """

    anew: Callable[[Records, float], OpenLoop | None]
    after: Callable[[Records, int], OpenLoop | None]


def validated(
    name: str,
    model: Model,
    records: Sequence[Record],
    simulation: Simulation,
    notes: Sequence[Line] = (),
    start_samples: int | None = None,
) -> Validation:
    """Return the errors of a simulation of each record; `notes` go before those of the records."""
    if start_samples is not None:
        check_start_samples(start_samples, records)
    rows = tuple(_row(r, model, simulation, start_samples) for r in records)
    own = (line for r in records for line in r.findings)
    return Validation(name, model.output_kind, rows, (*notes, *own))


def check_start_samples(samples: int, records: Sequence[Record]) -> None:
    """Raise `BristleError` unless each record has so many samples and as many again after them."""
    most = min(len(r) for r in records) // 2
    if not LEAST_START_SAMPLES <= samples <= most:
        raise BristleError(
            f"{samples} start samples: allowed are {LEAST_START_SAMPLES} to {most}, half of the"
            " shortest record"
        )


def model_simulation(model: Model, h: float) -> Simulation:
    """Return what simulates a model, only its starts fitted; `h` [s] is the sampling period."""
    servo, values = (
        Servo(model.friction, tuple(model.effects), (), (), fixed_values(h), False),
        model.settings(),
    )
    return Simulation(
        lambda own, seconds: open_loop(servo, values, own, seconds),
        lambda own, samples: open_loop_after(servo, values, own, samples),
    )


def validated_fmu(
    fmu: Fmu,
    model: Model,
    records: Sequence[Record],
    notes: Sequence[Line],
    timeout: float | None = None,
    start_samples: int | None = None,
) -> Validation:
    """Return the errors of a plant FMU, run from the measured state where it can be; how it was run
    goes before the `notes`.
    """
    simulator = FmuSimulator(fmu, model.output_kind == "velocity", timeout)
    simulation = Simulation(simulator.open_loop, simulator.open_loop_after)
    validation = validated(fmu.path.name, model, records, simulation, notes, start_samples)
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


def _row(
    record: Record, model: Model, simulation: Simulation, start_samples: int | None
) -> ValidatedRecord:
    resolution = model.resolution or record.resolution or 1e-12
    own = Records((record,), model.output_kind == "velocity", resolution, resolution / 3)
    curve = []
    for seconds in (SEGMENT_SECONDS, *own.horizons(SEGMENT_SECONDS)):
        loop = simulation.anew(own, seconds)
        if loop is not None:
            curve.append((seconds, loop.error))
    assert loop is not None  # whole records are simulated anyhow
    [y], [seen] = loop.measured, loop.simulated
    return ValidatedRecord(
        record.name,
        model.output_unit,
        *_errors(y, seen),
        tuple(curve),
        record.time[: len(y)],
        record.u[: len(y)],
        y,
        seen,
        None if start_samples is None else _after_start(own, simulation, start_samples),
    )


def _errors(y: Array, seen: Array) -> tuple[float, float, float]:
    """Return the rms error, FIT and the error of eq. (25) [%] of an output (n,)."""
    return rms(y - seen), fit_percent(y, seen), mse_percent(y, seen)


def _after_start(own: Records, simulation: Simulation, samples: int) -> AfterStart | None:
    """Return the errors after the first samples, to which alone the start was fitted."""
    loop = simulation.after(own, samples)
    if loop is None:
        return None
    [y], [seen] = loop.measured, loop.simulated
    return AfterStart(samples, *_errors(y[samples:], seen[samples:]))
