"""What a record must have to be diagnosed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.diagnosis.modelfile import Model, must_be_model
from bristle.plant.effects import owners_of_inputs
from bristle.plant.known import KNOWN
from bristle.plant.servo import J
from bristle.records import intake
from bristle.records.clock import must_agree
from bristle.records.intake import RecordArrays, Requirements
from bristle.records.layout import GOAL, LOAD
from bristle.records.record import Record

LEAST_SAMPLES = 200  # samples, of a record or of a piece of one: five segments of 0.4 s at 100 Hz
LEAST_DURATION = 2.0  # s, of a record or of a piece of one
# s: range of the sampling period; outside, the unit of the time is wrong
SHORTEST_PERIOD, LONGEST_PERIOD = 1e-5, 0.1
NEEDS = Requirements(
    LEAST_SAMPLES, LEAST_DURATION, SHORTEST_PERIOD, LONGEST_PERIOD, identification=True
)


def load_records(model: Model, paths: Path | str | Sequence[Path | str]) -> list[Record]:
    """Read measured files, checked and repaired as a diagnosis needs it.

    Parameters
    ----------
    model, paths
        As layout and paths of `bristle.records.read_records`, as are what it returns and its
        errors.
    """
    must_be_model(model)
    return intake.read_records(model, paths, NEEDS)


def records_from_arrays(model: Model, arrays: Iterable[RecordArrays]) -> list[Record]:
    """Check records in memory and repair them as a diagnosis needs it.

    Parameters
    ----------
    model, arrays
        As layout and arrays of `bristle.records.records_from_arrays`, as are what it returns and
        its errors.
    """
    must_be_model(model)
    return intake.records_from_arrays(model, arrays, NEEDS)


def must_show(model: Model, records: Sequence[Record]) -> None:
    """Refuse records, made by hand maybe, as `bristle.records.intake.must_show` does."""
    intake.must_show(model, records, NEEDS)


def check_arguments(model: Model, records: Sequence[Record]) -> None:
    """Raise `BristleError` if these are not what they should be: paths, say, or plain arrays, or
    records that show nothing.
    """
    must_be_model(model)
    if not isinstance(records, Sequence) or not all(
        isinstance(record, Record) for record in records
    ):
        raise BristleError(
            "the records are not a list of Record; give what load_records or records_from_arrays"
            " returns"
        )
    if not records:
        raise BristleError("no record is given; give at least one")
    for record in records:
        beside = {LOAD: ("output.load", model.load), GOAL: ("input.goal", model.goal)}
        for key, (table, column) in beside.items():
            if column is not None and key not in record.known:
                raise BristleError(
                    f"record {record.name}: lacks {table}, which the model has a column of; read"
                    " it with load_records, or give it to records_from_arrays"
                )
        for key in model.known:
            if f"known.{key}" not in record.known:
                raise BristleError(
                    f"record {record.name}: lacks the known {key}, which the model has a column"
                    " of; read it with load_records, or give it to records_from_arrays"
                )
    must_agree(records)
    must_show(model, records)


def as_inputs(model: Model, records: Sequence[Record]) -> list[Record]:
    """Return records with what is known as inputs of the servo and of its effects: without the
    position of the load and the goal, an inertia as a factor on J.
    """
    return [replace(record, known=_inputs(model, record.known)) for record in records]


def _inputs(model: Model, given: Mapping[str, Array]) -> dict[str, Array]:
    known = {name: x for name, x in given.items() if name not in (LOAD, GOAL)}
    for own, effect in owners_of_inputs().items():
        if (values := known.pop(f"{KNOWN.name}.{own}", None)) is not None:
            known[f"{effect}.{own}"] = values
    if (inertia := known.pop(f"{KNOWN.name}.inertia", None)) is not None:
        known[f"{KNOWN.name}.inertia_factor"] = inertia / model.parameters[J.name]
    return known
