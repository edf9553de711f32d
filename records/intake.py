"""Intake of measured records: recognise what is wrong with them, mend what is safe, report it, refuse the rest."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bristle.common.errors import BristleError
from bristle.common.table import Array, read_columns, si_column
from bristle.diagnosis.modelfile import Model, must_be_model, must_be_path
from bristle.records.clock import clock, increasing, one_rate, period_of
from bristle.records.record import NAMES, Raw, Record, vectors
from bristle.records.sensor import (
    MOTIONLESS_STEPS,
    mend_spikes,
    must_move,
    report_frozen,
    report_limits,
    resolution_of,
    tell_steps,
    unwrap,
)

Entry = tuple[str, str, ArrayLike, ArrayLike, ArrayLike]
LEAST_SAMPLES = 200  # samples, of a record or of a piece of one: five segments of 0.4 s at 100 Hz
LEAST_DURATION = 2.0  # s, likewise
SMALLEST_VALUE, LARGEST_VALUE = 1e-30, 1e30  # SI: no rig gives less or more, and squares of such numbers are no numbers any more
GAP_INTERVALS = 3.5  # an interval of more than this many is a gap; shorter ones are bridged
COPY_TOLERANCE = 1e-6  # of its range: columns that differ by less are one, written with more or fewer digits
LATE_START = (
    10.0  # s: a time that starts later counts from the first record: seen from afar, a drift is none that friction can have
)
EPOCH_START = 1e6  # s: later still, it counts from 1970, and not with the records before


def load_records(model: Model, paths: Path | str | Sequence[Path | str]) -> list[Record]:
    """Read measured files, check and mend them.

    Parameters
    ----------
    model : Model
        Names the columns and their units.
    paths : path or sequence of path
        CSV, MAT, NPZ or Parquet files, each once.

    Returns
    -------
    list of Record
        At least one for each file, all with the same sampling period.

    Raises
    ------
    BristleError
        One line: what, where, what is allowed, what to do.
    """
    must_be_model(model)
    given: object = paths
    listed: list[Any] = list(given) if isinstance(given, Iterable) and not isinstance(given, str) else [given]
    if not listed:
        raise BristleError("no record is given; give at least one measured file")
    for path in listed:
        must_be_path(path, "record")
    real = [Path(path).resolve() for path in listed]
    for k, path in enumerate(real):
        if path in real[:k]:
            raise BristleError(f"record {listed[k]}: is given twice; a copy is no second measurement: leave it out")
    read = [_read(model, Path(path)) for path in listed]
    stems = [Path(path).stem for path in listed]
    names = [f"{stem}#{stems[:i].count(stem) + 1}" if stems.count(stem) > 1 else stem for i, stem in enumerate(stems)]
    return _records(model, [(name, str(path), *columns) for name, path, columns in zip(names, listed, read, strict=True)])


def records_from_arrays(model: Model, arrays: Iterable[tuple[str, ArrayLike, ArrayLike, ArrayLike]]) -> list[Record]:
    """Check and mend records that are in memory.

    Parameters
    ----------
    model : Model
        What the arrays are; its column names and units are not used.
    arrays : iterable of (name, time, u, y)
        Arrays of shape (n,) in SI: seconds, the model's `input_unit` and `output_unit`.

    Returns
    -------
    list of Record
        At least one for each entry, all with the same sampling period.

    Raises
    ------
    BristleError
        One line: what, where, what is allowed, what to do.
    """
    must_be_model(model)
    if not isinstance(arrays, Iterable):
        raise BristleError("the records are no list; give one of (name, time, u, y)")
    return _records(model, _entries(arrays))


def must_show(model: Model, records: Sequence[Record]) -> None:
    """Refuse records in which there is nothing to diagnose: whoever makes a `Record` by hand has not been told yet."""
    still: list[BristleError] = []
    for record in records:
        raw = Raw(record.name, record.name, record.time, record.u, record.y, [])
        if len(record) * record.h < LEAST_DURATION:
            raise _too_brief(raw)
        _possible(model, raw)
        try:
            must_move(model, raw, record.resolution or model.resolution)
        except BristleError as error:
            still.append(error)
    if len(still) == len(records):
        raise still[0]
    _must_be_driven(model, records, records[0].name)


def _must_be_driven(model: Model, records: Sequence[Record], where: str) -> None:
    if all(_constant(record.u) for record in records):
        raise BristleError(
            f"record {where}: input is constant ({records[0].u[0]:g} {model.input_unit}) in every record; "
            "check [input] column, and give a record in which it moves"
        )


def _entries(arrays: Iterable[object]) -> Iterator[Entry]:
    """Check that each entry is what it should be; a record in memory is told by its name."""
    for number, entry in enumerate(arrays, start=1):
        if not isinstance(entry, list | tuple) or len(entry) != 4:
            raise BristleError(f"record {number}: is not (name, time, u, y); give these four")
        name, time, u, y = entry
        yield name, name, time, u, y


def _records(model: Model, entries: Iterable[Entry]) -> list[Record]:
    """Check and mend records, each of a name, what errors call it, time, u and y."""
    records: list[Record] = []
    before: dict[str, tuple[Array, Array, Array]] = {}
    origin: float | None = None
    for name, where, *given in entries:
        time, u, y = vectors(where, *given)
        if where in before:
            raise BristleError(f"record {where}: two records have this name, by which reports tell them; give each its own")
        raw = Raw(name, where, time, u, y, [])
        _cut_ends(raw)
        _possible(model, raw)
        for other, columns in before.items():
            if all(map(_same, (raw.time, raw.u, raw.y), columns)):
                raise raw.error(f"is the same as {other}; a copy is no second measurement: leave it out")
        before[where] = raw.time, raw.u, raw.y
        begin = float(raw.time[0])
        if origin is None or (not origin and abs(begin) > EPOCH_START):
            origin = begin if abs(begin) > LATE_START else 0.0
        if origin and abs(begin) > LATE_START:
            raw.time = raw.time - origin
            raw.say(f"time starts at {begin:.6g} s; counted from the first record's first sample")
        records += _pieces(model, raw)
    if not records:
        raise BristleError("no record is given; give at least one")
    _must_be_driven(model, records, next(iter(before)))
    for i, record in enumerate(records):
        if _constant(record.u):
            line = f"input is constant ({record.u[0]:g} {model.input_unit}): the record shows friction, but hardly inertia"
            records[i] = replace(record, findings=(*record.findings, f"record {record.name}: {line}"))
    return tell_steps(model, one_rate(records))


def _read(model: Model, path: Path) -> tuple[Array, Array, Array]:
    columns = read_columns(path)
    time = si_column(f"record {path}: time", columns, model.time.column, model.time.unit, None, "s")
    u, y = (
        si_column(f"record {path}: {key}", columns, column.column, column.unit, column.scale, unit)
        for key, column, unit in (("input", model.input, model.input_unit), ("output", model.output, model.output_unit))
    )
    return time, u, y


def _same(one: Array, other: Array) -> bool:
    """True if two columns differ by no more than the digits with which files of different formats hold them."""
    return len(one) == len(other) and bool(np.max(np.abs(one - other)) <= COPY_TOLERANCE * np.ptp(one))


def _constant(u: Array) -> bool:
    return bool(np.ptp(u) <= 1e-9 * np.max(np.abs(u)))


def _cut_ends(raw: Raw) -> None:
    """Leave out samples that are not finite at the ends; refuse them between."""
    table = np.column_stack([raw.time, raw.u, raw.y])
    whole = np.asarray(np.all(np.isfinite(table), axis=1))
    if whole.all():
        return
    good = np.flatnonzero(whole)
    if not len(good):
        raise raw.error("no sample is finite in time, input and output; check the columns")
    first, last = int(good[0]), int(good[-1])
    if not whole[first : last + 1].all():
        k = first + int(np.argmin(whole[first : last + 1]))
        key = NAMES[int(np.argmin(np.isfinite(table[k])))]
        count = int(np.sum(~whole[first : last + 1]))
        raise raw.error(f"{key} is not finite at sample {k} ({count} such samples before the end); repair them or cut the record")
    raw.say(f"{first} samples at the start and {len(whole) - 1 - last} at the end are not finite; left out")
    raw.keep(slice(first, last + 1))


def _possible(model: Model, raw: Raw) -> None:
    """Refuse numbers that are none of a rig."""
    units = ("s", model.input_unit, model.output_unit)
    for key, values, unit in zip(NAMES, (raw.time, raw.u, raw.y), units, strict=True):
        most = float(np.max(np.abs(values)))
        if most > LARGEST_VALUE or 0.0 < most < SMALLEST_VALUE:
            raise raw.error(
                f"{key} reaches {most:.3g} {unit}, allowed {SMALLEST_VALUE:g} to {LARGEST_VALUE:g}; check its column and unit"
            )


def _too_brief(raw: Raw) -> BristleError:
    length = f"lasts {raw.time[-1] - raw.time[0]:.6g} s; at least {LEAST_DURATION:g} s are needed"
    return raw.error(f"{length}: record longer, or correct [time] unit")


def _pieces(model: Model, raw: Raw) -> list[Record]:
    increasing(raw)
    if len(raw.time) < LEAST_SAMPLES:
        raise raw.error(f"{len(raw.time)} samples; at least {LEAST_SAMPLES} are needed: record longer")
    h = period_of(raw)
    resolution = resolution_of(model, raw)
    mend_spikes(raw, resolution)
    wrapped = model.output_kind == "position" and unwrap(model, raw, resolution)
    report_frozen(raw, resolution)
    report_limits(raw)
    must_move(model, raw, resolution or model.resolution)
    borders = np.flatnonzero(np.diff(raw.time) > GAP_INTERVALS * h) + 1
    runs = list(zip([0, *borders.tolist()], [*borders.tolist(), len(raw.time)], strict=True))
    records, dropped = [], []
    for number, (start, end) in enumerate(runs, start=1):
        which = "" if len(runs) == 1 else f"[{number}]"
        name = raw.name + which
        piece = Raw(name, raw.where + which, raw.time[start:end], raw.u[start:end], raw.y[start:end], [])
        length = piece.time[-1] - piece.time[0]
        still = np.ptp(piece.y) <= MOTIONLESS_STEPS * (resolution or 0.0)
        if len(piece.time) < LEAST_SAMPLES or length < LEAST_DURATION or still:
            dropped.append((name, "nothing moves" if still else f"only {length:.3g} s and {len(piece.time)} samples"))
            continue
        time, period, jitters = clock(piece)
        records.append(Record(name, time, period, piece.u, piece.y, tuple(piece.lines), resolution, wrapped, jitters))
    if len(runs) > 1:
        worst = int(np.argmax(np.diff(raw.time)))
        seen = f"largest {raw.time[worst + 1] - raw.time[worst]:.3g} s after {raw.time[worst]:.6g} s"
        raw.say(f"gaps in time: {len(runs) - 1} ({seen}); cut there into {len(runs)} pieces")
    for name, why in dropped:
        raw.say(f"piece {name} left out: {why}")
    if not records:
        if len(runs) == 1:
            raise _too_brief(raw)
        raise raw.error(f"no piece between gaps lasts {LEAST_DURATION:g} s with {LEAST_SAMPLES} samples; record without gaps")
    records[0] = replace(records[0], findings=(*raw.lines, *records[0].findings))
    return records
