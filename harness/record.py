"""Measured records: the columns a scenario names, in SI, time checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.table import Array, read_columns, si_column
from bristle.harness.scenario import Column, Record

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


def _column(path: Path, columns: dict[str, Array], key: str, column: Column, si_unit: str) -> Array:
    """Return a column in SI units, without a hole."""
    where = f"record {path}: {key}"
    values = si_column(where, columns, column.column, column.unit, column.scale, si_unit)
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
