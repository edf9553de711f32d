"""Measured records: one reader for CSV, MAT and NPZ, units converted, time checked."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bristle.harness.fmu import suggest
from bristle.harness.scenario import Column, Record
from bristle.model.errors import BristleError
from bristle.model.units import parse_unit

Array = NDArray[np.float64]

UNIFORM = 0.01  # a sampling interval may differ from the mean by this fraction
SHORTEST = 10  # samples


@dataclass(frozen=True)
class Samples:
    """A record in SI units, uniformly sampled; `measured` says what was measured, the rest follows from it."""

    h: float
    u: Array
    theta: Array
    v: Array
    measured: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.u)


def read_columns(path: Path) -> dict[str, Array]:
    """Return all numeric columns of a file by name.

    Raises
    ------
    BristleError
        If the file cannot be read or is of no known format.
    """
    readers = {".csv": _read_csv, ".mat": _read_mat, ".npz": _read_npz}
    if path.suffix.lower() not in readers:
        raise BristleError(f"record {path}: unknown format '{path.suffix}'; known: {', '.join(readers)}")
    try:
        columns = readers[path.suffix.lower()](path)
    except BristleError:
        raise
    except OSError as error:
        raise BristleError(f"record {path}: {error.strerror or error}; check the path") from None
    except Exception as error:  # each format's reader has its own exceptions
        raise BristleError(f"record {path}: cannot be read: {' '.join(str(error).split())}; check the file") from None
    if not columns:
        raise BristleError(f"record {path}: no column of numbers; check the file")
    return columns


def _read_csv(path: Path) -> dict[str, Array]:
    with path.open(newline="", encoding="utf-8-sig") as stream:
        rows = [row for row in csv.reader(stream) if row]
    if len(rows) < 2:
        raise BristleError(f"record {path}: no data below a header line; write the column names in the first line")
    header = [name.strip() for name in rows[0]]
    if any(_is_number(name) for name in header):
        raise BristleError(f"record {path}: the first line holds numbers; write the column names there")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise BristleError(f"record {path}: line {number} has {len(row)} values, the header {len(header)}; mend that line")
    try:
        table = np.array(rows[1:], dtype=float)
    except ValueError as error:
        raise BristleError(f"record {path}: {error}; keep only numbers below the header") from None
    return {name: table[:, i] for i, name in enumerate(header)}


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_mat(path: Path) -> dict[str, Array]:
    from scipy.io import loadmat

    with path.open("rb") as stream:
        return _vectors({name: value for name, value in loadmat(stream).items() if not name.startswith("__")})


def _read_npz(path: Path) -> dict[str, Array]:
    with np.load(path, allow_pickle=False) as archive:
        return _vectors(dict(archive))


def _vectors(found: dict[str, NDArray[np.generic]]) -> dict[str, Array]:
    numeric = {name: np.asarray(value) for name, value in found.items() if np.asarray(value).dtype.kind in "fiu"}
    return {name: value.astype(float).ravel() for name, value in numeric.items() if value.size == max(value.shape, default=0)}


def _column(path: Path, columns: dict[str, Array], key: str, column: Column, si_unit: str) -> Array:
    """Return a column in SI units."""
    where = f"record {path}: {key}"
    if column.column not in columns:
        near = suggest(column.column, list(columns))
        raise BristleError(f"{where}: no column '{column.column}'{near}; there are: {', '.join(columns)}")
    try:
        unit, want = parse_unit(column.unit), parse_unit(si_unit)
        factor, exponents = unit.factor / want.factor, np.array(unit.exponents)
        if column.scale is not None:
            number, _, text = column.scale.strip().partition(" ")
            scale = parse_unit(text or "1")
            factor, exponents = factor * float(number) * scale.factor, exponents + np.array(scale.exponents)
    except ValueError as error:
        raise BristleError(f"{where}: {error}") from None
    if tuple(exponents) != want.exponents:
        raise BristleError(
            f"{where}: unit '{column.unit}' does not fit, a unit like '{si_unit}' is needed; "
            f'correct it, or add scale = "... {si_unit}" over that unit'
        )
    values = columns[column.column] * factor
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise BristleError(f"{where}: sample {bad[0]} of column '{column.column}' is not finite; repair or cut the record")
    return values


def _period(path: Path, time: Array) -> float:
    """Return the sampling period of a uniform record."""
    if len(time) < SHORTEST:
        raise BristleError(f"record {path}: {len(time)} samples; at least {SHORTEST} are needed")
    steps = np.diff(time)
    if not (steps > 0).all():
        raise BristleError(
            f"record {path}: time does not increase at sample {int(np.argmin(steps > 0)) + 1}; sort or cut the record"
        )
    h = float((time[-1] - time[0]) / (len(time) - 1))
    worst = int(np.argmax(np.abs(steps - h)))
    if abs(steps[worst] - h) > UNIFORM * h:
        raise BristleError(
            f"record {path}: time is not uniform: {steps[worst]:g} s after sample {worst}, mean {h:g} s, "
            f"allowed {UNIFORM:.0%} off; resample it first"
        )
    return h


def read_record(path: Path, record: Record) -> Samples:
    """Read the columns a scenario names and convert them to SI.

    Position without velocity gives velocity as a backward difference (what a counter gives); velocity without
    position gives position as its integral from 0 by the trapezoidal rule.
    """
    columns = read_columns(path)
    wanted = {"time": (record.time, "s"), "u": (record.u, "V"), "theta": (record.theta, "rad"), "v": (record.v, "rad/s")}
    read = {key: _column(path, columns, key, column, unit) for key, (column, unit) in wanted.items() if column is not None}
    lengths = {key: len(values) for key, values in read.items()}
    if len(set(lengths.values())) > 1:
        raise BristleError(f"record {path}: columns of different length ({lengths}); cut them to the same samples")
    h = _period(path, read["time"])
    measured = tuple(key for key in ("theta", "v") if key in read)
    if "v" not in read:
        steps = np.diff(read["theta"]) / h
        read["v"] = np.concatenate([steps[:1], steps])
    if "theta" not in read:
        v = read["v"]
        read["theta"] = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * h / 2)])
    return Samples(h, read["u"], read["theta"], read["v"], measured)
