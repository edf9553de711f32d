"""Read measured files, convert them to SI, find what is wrong with them, repair and report it or
refuse the record.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bristle.common.arguments import as_paths
from bristle.common.errors import BristleError
from bristle.common.table import Array, Columns, si_column
from bristle.records.clock import clock, increasing, one_rate, period_of
from bristle.records.differences import summed
from bristle.records.formats.own_rows import at_rows_of
from bristle.records.formats.reading import read_columns
from bristle.records.layout import GOAL, LOAD, SETPOINT, Layout
from bristle.records.record import COLUMN_NAMES, Raw, Record, vectors
from bristle.records.resolution import common_step
from bristle.records.sensor import (
    MOTIONLESS_STEPS,
    compare_resolution,
    must_move,
    repaired,
    report_steps,
)
from bristle.records.signed import signed_input

# SI: no rig gives a smaller or larger value, and the square of one is not finite
SMALLEST_VALUE, LARGEST_VALUE = 1e-30, 1e30
TEMPERATURE = "known.temperature"
COLDEST, HOTTEST = 150.0, 500.0  # K: of a servo that works, by far
BRIDGED_SAMPLES = 5  # samples: most that are not finite in a row and are interpolated over
BRIDGED_SHARE = 0.02  # of the samples: most that are not finite and are interpolated over
WRAP_SHARE = 0.5  # of the range: a larger change across samples that are not finite is a wrap
# sampling intervals: a longer interval is a gap, a shorter one is interpolated over
GAP_INTERVALS = 3.5
# of its range: columns that differ by less are the same, written with more or fewer digits
COPY_TOLERANCE = 1e-6
CONSTANT_TOLERANCE = 1e-9  # of its largest value: an input that varies by less is constant
# s: a time that starts later is counted from the first sample of the first record
LATE_START = 10.0
# s: a time that starts later still is counted from 1970, not on the clock of the records before
EPOCH_START = 1e6


@dataclass(frozen=True)
class Requirements:
    """What a record must have to serve a purpose.

    Attributes
    ----------
    samples, duration : int, float
        Least number of samples and least duration [s] of a record, or of a piece of it between
        gaps.
    shortest_period, longest_period : float
        Range of the sampling period [s].
    identification : bool
        Whether the record is to identify a servo: its output must move and the input of one record
        at least, spikes and wraps of the sensor are repaired, a late start of the time is
        subtracted, a gap cuts the record. Else the samples stay as recorded, and a gap is refused.
    """

    samples: int = 10
    duration: float = 0.0
    shortest_period: float = 0.0
    longest_period: float = float("inf")
    identification: bool = False


AS_RECORDED = Requirements()
# name, time, input, output and, where the layout has more, what else is known
RecordArrays = (
    tuple[str, ArrayLike, ArrayLike, ArrayLike]
    | tuple[str, ArrayLike, ArrayLike, ArrayLike, Mapping[str, ArrayLike]]
)


def read_record(layout: Layout, path: Path | str) -> Record:
    """Read one measured file; samples stay as they are, only an uneven time is resampled.

    Parameters
    ----------
    layout : Layout
        Names the columns and their units.
    path : path
        A file of a format that `bristle.records.formats.reading.READERS` lists, packed or not.

    Returns
    -------
    Record
        In SI, uniformly sampled; `findings` says what was wrong.

    Raises
    ------
    BristleError
        One line: what, where, what is allowed, what to do.
    """
    [record] = read_records(layout, path)
    return record


def read_records(
    layout: Layout, paths: Path | str | Sequence[Path | str], needs: Requirements = AS_RECORDED
) -> list[Record]:
    """Read measured files, check and repair them; return at least one record for each, all with the
    same sampling period.

    Parameters
    ----------
    layout : Layout
        Names the columns and their units.
    paths : path or sequence of path
        Files of such formats, each once.
    needs : Requirements
        What the records must have; `BristleError` says what one lacks.
    """
    _must_be_layout(layout)
    listed = distinct_files(paths)
    return records_of_tables(layout, ((path, read_columns(path)) for path in listed), listed, needs)


def distinct_files(paths: Path | str | Sequence[Path | str]) -> list[Path]:
    """Return the measured files that are given, at least one and none twice."""
    listed = as_paths("paths", paths)
    if not listed:
        raise BristleError("no record is given; give at least one measured file")
    real = [os.path.realpath(path) for path in listed]  # unlike `resolve`, of a loop of links too
    for k, path in enumerate(real):
        if path in real[:k]:
            raise BristleError(
                f"record {listed[k]}: is given twice; a copy is no second measurement: leave it out"
            )
    return listed


def records_of_tables(
    layout: Layout,
    tables: Iterable[tuple[Path, Columns]],
    paths: Sequence[Path],
    needs: Requirements,
) -> list[Record]:
    """Return the records of files that are read already, as `read_records` does; `tables` gives
    path and columns of each.
    """
    names = _names(paths)
    return _records(
        layout,
        [
            _raw(layout, path, name, columns)
            for (path, columns), name in zip(tables, names, strict=True)
        ],
        needs,
    )


def records_from_arrays(
    layout: Layout,
    arrays: Iterable[RecordArrays],
    needs: Requirements = AS_RECORDED,
) -> list[Record]:
    """Check and repair records in memory; return at least one for each entry, all with the same
    sampling period.

    Parameters
    ----------
    layout : Layout
        What the arrays are; its column names and units are not used.
    arrays : iterable of (name, time, u, y) or (name, time, u, y, known)
        Arrays of shape (n,) in SI: seconds, the layout's `input_unit` and `output_unit`, or
        velocities if it says `differences`; `known` is a dict of such arrays, by the names of the
        layout's `known`, "load" for a second position, and "goal" for a goal.
    needs : Requirements
        What the records must have; `BristleError` says what one lacks.
    """
    _must_be_layout(layout)
    if not isinstance(arrays, Iterable):
        raise BristleError("the records are no list; give one of (name, time, u, y)")
    return _records(layout, _raw_records(arrays), needs)


def must_show(layout: Layout, records: Sequence[Record], needs: Requirements) -> None:
    """Refuse records, made by hand maybe, that are too short, impossible or without motion."""
    still: list[BristleError] = []
    for record in records:
        raw = Raw(record.name, record.name, record.time, record.u, record.y)
        if len(record) * record.h < needs.duration:
            raise _too_short(raw, needs)
        _must_be_possible(layout, raw)
        try:
            must_move(layout, raw, record.resolution or layout.resolution)
        except BristleError as error:
            still.append(error)
    if len(still) == len(records):
        raise still[0]
    _must_be_driven(layout, records, records[0].name)


def _must_be_layout(layout: object) -> None:
    if not isinstance(layout, Layout):
        raise BristleError(
            f"the layout is a {type(layout).__name__}; give a Layout, or a model that load_model"
            " returns"
        )


def _raw(layout: Layout, path: Path, name: str, columns: Columns) -> Raw:
    columns = columns.at(layout.time.column) if layout.time else columns
    used = {column.column for column, _ in layout.columns.values()}
    columns = at_rows_of(columns, layout.output.column, used)
    columns = signed_input(layout, columns)
    found = {
        key: si_column(
            f"record {path}: {key}", columns, column.column, column.unit, column.scale, unit
        )
        for key, (column, unit) in layout.columns.items()
    }
    if layout.rate is not None:
        found = {"time": np.arange(len(found["output"])) / layout.rate, **found}
    time, u, y = (found.pop(key) for key in COLUMN_NAMES[:3])
    raw = Raw.of(
        name, str(path), vectors(str(path), time, u, y, found.pop("velocity", None), found)
    )
    for line in columns.findings:
        raw.say(line)
    return raw


def _names(paths: Sequence[Path]) -> list[str]:
    """Return the stem of each file, with as many folders before it as tell it from others."""
    return [
        _name(path, [other for k, other in enumerate(paths) if k != number])
        for number, path in enumerate(paths)
    ]


def _name(path: Path, others: Sequence[Path]) -> str:
    """Return the shortest end of a path, without its suffix, that no other path has; with the
    suffix if all of it is alike.
    """
    parts, alike = (
        path.absolute().parts,
        [other.absolute().parts for other in others if other.stem == path.stem],
    )
    for depth in range(1, len(parts)):
        alike = [other for other in alike if other[-depth:-1] == parts[-depth:-1]]
        if not alike:
            return "/".join((*parts[-depth:-1], path.stem))
    return path.name


def _raw_records(entries: Iterable[object]) -> Iterator[Raw]:
    """Check that each entry is a record in memory; errors name it as it is named there."""
    for number, entry in enumerate(entries, start=1):
        if not isinstance(entry, list | tuple) or len(entry) not in (4, 5):
            raise BristleError(f"record {number}: is not (name, time, u, y); give these four")
        name, time, u, y = entry[:4]
        known = entry[4] if len(entry) == 5 else {}
        if not isinstance(known, Mapping):
            raise BristleError(
                f"record {name}: what is known is a {type(known).__name__}; give a dict of arrays"
            )
        beside = (LOAD, GOAL)
        named = {key if key in beside else f"known.{key}": x for key, x in known.items()}
        yield Raw.of(name, name, vectors(name, time, u, y, known=named))


# -- records together ------------------------------------------------------------------------------
def _records(layout: Layout, raws: Iterable[Raw], needs: Requirements) -> list[Record]:
    """Check and repair records, and bring them to one sampling period."""
    records: list[Record] = []
    before: dict[str, dict[str, Array]] = {}
    origin: float | None = None
    for raw in raws:
        if raw.where in before:
            raise BristleError(
                f"record {raw.where}: two records have this name; give each its own, by which"
                " reports call it"
            )
        _cut_ends(raw)
        _must_be_possible(layout, raw)
        for other, columns in before.items():
            if all(_same(x, columns[key]) for key, x in raw.columns.items()):
                raise raw.error(
                    f"is the same as {other}; a copy is no second measurement: leave it out"
                )
        before[raw.where] = raw.columns
        if needs.identification:
            origin = _count_from_first(raw, origin)
        records += _pieces(layout, raw, needs)
    if not records:
        raise BristleError("no record is given; give at least one")
    if needs.identification:
        _must_be_driven(layout, records, next(iter(before)))
        records = [_report_constant_input(layout, record) for record in records]
    records = one_rate(records)
    return report_steps(layout, records) if needs.identification else records


def _count_from_first(raw: Raw, origin: float | None) -> float:
    """Count a time that starts late from the first sample of the first such record; return that
    sample's time, or 0.
    """
    begin = float(raw.time[0])
    if origin is None or (not origin and abs(begin) > EPOCH_START):
        origin = begin if abs(begin) > LATE_START else 0.0
    if origin and abs(begin) > LATE_START:
        raw.time = raw.time - origin
        raw.say(f"time starts at {begin:.6g} s; counted from the first record's first sample")
    return origin


def _same(one: Array, other: Array) -> bool:
    """True if two columns differ by no more than the digits of their file formats."""
    return len(one) == len(other) and bool(
        np.max(np.abs(one - other)) <= COPY_TOLERANCE * np.ptp(one)
    )


def _constant(u: Array) -> bool:
    return bool(np.ptp(u) <= CONSTANT_TOLERANCE * np.max(np.abs(u)))


def _must_be_driven(layout: Layout, records: Sequence[Record], where: str) -> None:
    if all(_constant(record.u) for record in records):
        seen = f"input is constant ({records[0].u[0]:g} {layout.input_unit}) in every record"
        raise BristleError(
            f"record {where}: {seen}; check [input] column, and give a record in which it varies"
        )
    if layout.input_kind == SETPOINT and all(_same(each.u, each.y) for each in records):
        raise BristleError(
            f"record {where}: goal and output hold the same values in every record; give the"
            " position that was measured as [output] column"
        )


def _report_constant_input(layout: Layout, record: Record) -> Record:
    if not _constant(record.u):
        return record
    line = (
        f"input is constant ({record.u[0]:g} {layout.input_unit}): the record shows friction, but"
        " hardly inertia"
    )
    return replace(record, findings=(*record.findings, f"record {record.name}: {line}"))


# -- one record ------------------------------------------------------------------------------------
def _cut_ends(raw: Raw) -> None:
    """Leave out samples that are not finite at the ends; interpolate a few between, refuse more."""
    table = np.column_stack([*raw.columns.values()])
    whole = np.asarray(np.all(np.isfinite(table), axis=1))
    if whole.all():
        return
    good = np.flatnonzero(whole)
    if not len(good):
        raise raw.error("no sample is finite in all columns; check the columns")
    first, last = int(good[0]), int(good[-1])
    if first or last < len(whole) - 1:
        raw.say(
            f"{first} samples at the start and {len(whole) - 1 - last} at the end are not finite;"
            " left out"
        )
    raw.keep(slice(first, last + 1))
    if not whole[first : last + 1].all():
        _bridge(raw)


def _bridge(raw: Raw) -> None:
    """Interpolate a few samples that are not finite; refuse many, or many in a row."""
    for key, values in raw.columns.items():
        bad = ~np.isfinite(values)
        if not bad.any():
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]))).reshape(-1, 2)
        longest, count = int(np.max(edges[:, 1] - edges[:, 0])), int(np.sum(bad))
        where = (
            f"{key} is not finite at {count} of {len(values)} samples (first at sample"
            f" {edges[0, 0]}, at most {longest} in a row)"
        )
        if longest > BRIDGED_SAMPLES or count > BRIDGED_SHARE * len(values):
            allowed = f"{BRIDGED_SAMPLES} in a row and {BRIDGED_SHARE:.0%} in all are interpolated"
            raise raw.error(f"{where}; {allowed}: repair them or cut the record")
        raw.say(f"{where}; interpolated")
        values[bad] = _between(values, ~bad, bad)


def _between(values: Array, good: NDArray[np.bool_], bad: NDArray[np.bool_]) -> Array:
    """Return what lies between good samples, in sensor steps; over a wrap, the sample before."""
    at, known, where = np.flatnonzero(good), values[good], np.flatnonzero(bad)
    found = np.interp(where, at, known)
    before = np.searchsorted(at, where) - 1
    wrapped = np.abs(known[before + 1] - known[before]) > WRAP_SHARE * np.ptp(known)
    found[wrapped] = known[before][wrapped]
    step = common_step(known)
    return found if step is None else known[0] + np.round((found - known[0]) / step) * step


def _must_be_possible(layout: Layout, raw: Raw) -> None:
    """Refuse values that no rig gives."""
    units = {"time": "s"} | {key: unit for key, (_, unit) in layout.columns.items()}
    for key, values in raw.columns.items():
        most = float(np.max(np.abs(values)))
        if most > LARGEST_VALUE or 0.0 < most < SMALLEST_VALUE:
            allowed = f"allowed {SMALLEST_VALUE:g} to {LARGEST_VALUE:g}; check its column and unit"
            raise raw.error(f"{key} reaches {most:.3g} {units[key]}, {allowed}")
        if key == TEMPERATURE and not COLDEST < np.min(values) <= np.max(values) < HOTTEST:
            seen = f"{key} is {np.min(values):.4g} to {np.max(values):.4g} K"
            raise raw.error(
                f"{seen}, allowed {COLDEST:g} to {HOTTEST:g}; check its unit, K or degC"
            )


def _too_short(raw: Raw, needs: Requirements) -> BristleError:
    length = f"lasts {raw.time[-1] - raw.time[0]:.6g} s"
    return raw.error(
        f"{length}; at least {needs.duration:g} s are needed: record longer, or correct [time] unit"
    )


def _pieces(layout: Layout, raw: Raw, needs: Requirements) -> list[Record]:
    """Return the pieces of a record between its gaps, usually one, with the findings of the whole
    in the first.
    """
    increasing(raw)
    if len(raw.time) < needs.samples:
        raise raw.error(
            f"{len(raw.time)} samples; at least {needs.samples} are needed: record longer"
        )
    h = period_of(raw, needs.shortest_period, needs.longest_period)
    if layout.differences:
        raw.y = summed(raw.y, h)
    if layout.goal_is_rate:
        raw.u = summed(raw.u, h)
    resolution = compare_resolution(layout, raw)
    wrapped = needs.identification and repaired(layout, raw, resolution)
    borders = (np.flatnonzero(np.diff(raw.time) > GAP_INTERVALS * h) + 1).tolist()
    if borders and not needs.identification:
        raise _gap(raw, borders[0], h)
    runs = list(zip([0, *borders], [*borders, len(raw.time)], strict=True))
    records, dropped = [], []
    for number, (start, end) in enumerate(runs, start=1):
        which = "" if len(runs) == 1 else f"[{number}]"
        columns = {key: column[start:end] for key, column in raw.columns.items()}
        piece = Raw.of(raw.name + which, raw.where + which, columns)
        if why := _unusable(piece, resolution, needs):
            dropped.append((piece.name, why))
            continue
        time, period, uneven = clock(piece)
        facts = (tuple(piece.lines), resolution, wrapped, uneven)
        read = Record(piece.name, time, period, piece.u, piece.y, *facts, velocity=piece.velocity)
        records.append(replace(read, known=piece.known))
    if len(runs) > 1:
        worst = int(np.argmax(np.diff(raw.time)))
        seen = (
            f"largest {raw.time[worst + 1] - raw.time[worst]:.3g} s after {raw.time[worst]:.6g} s"
        )
        raw.say(f"gaps in time: {len(runs) - 1} ({seen}); cut there into {len(runs)} pieces")
    for name, why in dropped:
        raw.say(f"piece {name} left out: {why}")
    if not records:
        if len(runs) == 1:
            raise _too_short(raw, needs)
        raise raw.error(
            f"no piece between gaps lasts {needs.duration:g} s with {needs.samples} samples; record"
            " without gaps"
        )
    records[0] = replace(records[0], findings=(*raw.lines, *records[0].findings))
    return records


def _unusable(piece: Raw, resolution: float | None, needs: Requirements) -> str:
    """Return why a piece cannot be used, or an empty text."""
    length = piece.time[-1] - piece.time[0]
    if needs.identification and np.ptp(piece.y) <= MOTIONLESS_STEPS * (resolution or 0.0):
        return "nothing moves"
    short = len(piece.time) < needs.samples or length < needs.duration
    return f"only {length:.3g} s and {len(piece.time)} samples" if short else ""


def _gap(raw: Raw, border: int, h: float) -> BristleError:
    gap = (
        f"a gap of {raw.time[border] - raw.time[border - 1]:.3g} s after sample {border - 1}"
        f" ({raw.time[border - 1]:.6g} s)"
    )
    return raw.error(
        f"{gap}, allowed {GAP_INTERVALS:g} sampling intervals of {h:.4g} s; cut the record there,"
        " into files of their own"
    )
