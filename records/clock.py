"""The time of a record, made uniform, and one sampling period for all records."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.records.record import Raw, Record
from bristle.records.resolution import common_step

# fraction by which a rounded sampling period may lie outside the allowed range
PERIOD_ROUNDING = 1e-6
UNIFORM_TOLERANCE = 0.01  # fraction of the mean by which a sampling interval may differ from it
# fraction of the sampling period: largest rms deviation of the intervals that is resampled
LARGEST_JITTER = 0.5
RATE_TOLERANCE = 1e-3  # fraction: sampling periods that differ by less are treated as equal
REPEATED_SHARE = 0.02  # largest share of repeated time stamps that are left out
# of the sampling period: largest step in which a printed time may count as rounded
PRINTED_STEP = 0.7
PRINTED_DEVIATION = 0.75  # of that step: largest deviation of a rounded time from a uniform one
# intervals: deviation from a whole number up to which a longer interval counts as missing samples
WHOLE_INTERVALS = 0.2


def increasing(raw: Raw) -> None:
    """Leave out repeated time stamps, if they are few; refuse a time that falls."""
    steps = np.diff(raw.time)
    if (steps < 0).any():
        k = int(np.argmax(steps < 0)) + 1
        seen = f"time decreases at sample {k}, from {raw.time[k - 1]:.9g} to {raw.time[k]:.9g} s"
        raise raw.error(f"{seen}; sort the record, or split it there if it holds two runs")
    again = np.flatnonzero(steps == 0) + 1
    if len(again):
        seen = f"time stamps repeat the one before (first at sample {again[0]})"
        if len(again) > REPEATED_SHARE * len(raw.time):
            allowed = f"allowed {REPEATED_SHARE:.0%}; write the time with more digits"
            raise raw.error(f"{len(again)} of {len(raw.time)} {seen}, {allowed}")
        raw.say(f"{len(again)} {seen}; these samples are left out")
        raw.keep(np.concatenate([[True], steps != 0]))


def period_of(raw: Raw, shortest: float, longest: float) -> float:
    """Return the median sampling period [s]; refuse one outside an interval."""
    h = float(np.median(np.diff(raw.time)))
    line = (
        f"sampled every {h:.7g} s; allowed are {shortest:g} to {longest:g} s: is [time] unit right "
    )
    if h > longest * (1 + PERIOD_ROUNDING):
        raise raw.error(
            f"{line}(ms, us)? else sample faster; a valve or an axis that rests between samples:"
            " bristle stiction"
        )
    if h < shortest * (1 - PERIOD_ROUNDING):
        raise raw.error(f"{line}(s, ms)?")
    return h


def clock(raw: Raw) -> tuple[Array, float, bool]:
    """Return time [s], sampling period [s], and whether the samples still have to be interpolated
    to a uniform time.

    A time is taken as uniform if its intervals differ little from their mean, or if it is uniform
    up to the digits in which it is written. Other intervals are interpolated if they scatter
    moderately, apart from missing samples.
    """
    n, steps = len(raw.time), np.diff(raw.time)
    grid = np.linspace(raw.time[0], raw.time[-1], n)
    h = float(grid[-1] - grid[0]) / (n - 1)
    if np.max(np.abs(steps - h)) <= UNIFORM_TOLERANCE * h:
        return grid, h, False
    digit = common_step(raw.time, finest=True)
    slope, start = np.polyfit(np.arange(n), raw.time - raw.time[0], 1)
    line = raw.time[0] + start + slope * np.arange(n)
    if (
        digit is not None
        and digit < PRINTED_STEP * h
        and np.max(np.abs(raw.time - line)) <= PRINTED_DEVIATION * digit
    ):
        raw.say(
            f"time is written in steps of {digit:.4g} s; taken as uniform, {slope:.6g} s a sample"
        )
        return line, float(slope), False
    ordinary = float(np.median(steps))
    missing = (np.round(steps / ordinary) > 1) & (
        np.abs(steps / ordinary - np.round(steps / ordinary)) < WHOLE_INTERVALS
    )
    rms = float(np.sqrt(np.mean((steps[~missing] - ordinary) ** 2))) / ordinary
    if rms > LARGEST_JITTER:
        seen = f"sampling intervals scatter by {rms:.0%} rms about {ordinary:g} s"
        raise raw.error(f"{seen}, allowed {LARGEST_JITTER:.0%}; sample with a steady clock")
    if missing.any():
        where = f"{int(missing.sum())} places (first after {raw.time[np.argmax(missing)]:.6g} s)"
        raw.say(f"one or two samples are missing at {where}; interpolated")
    raw.say(
        f"sampling intervals scatter by {rms:.1%} rms about {ordinary:.4g} s; interpolated to"
        " uniform ones"
    )
    return raw.time, ordinary, True


def one_rate(records: list[Record]) -> list[Record]:
    """Bring all records to one sampling period, the coarsest; each is interpolated at most once."""
    h = max(record.h for record in records)
    if h - min(record.h for record in records) <= RATE_TOLERANCE * h:
        h = float(np.mean([record.h for record in records]))
    found = []
    for record in records:
        differs = abs(record.h - h) > RATE_TOLERANCE * h
        if differs and (h - record.h > UNIFORM_TOLERANCE * h or not record.resampled):
            line = (
                f"record {record.name}: sampled every {record.h:.6g} s, another record every"
                f" {h:.6g} s; resampled to that"
            )
            record = replace(record, findings=(*record.findings, line))
        found.append(replace(_resampled(record, h) if differs or record.resampled else record, h=h))
    return found


def overlap(spans: Iterable[tuple[float, float]]) -> bool:
    """Return whether some records overlap, by the times of their first and last samples."""
    return any(later[0] <= earlier[1] for earlier, later in pairwise(sorted(spans)))


def one_after_the_other(begin: float, seconds: Sequence[float]) -> list[float]:
    """Return the times of the first samples of records of these lengths [s], without a gap between
    them, from the first on.
    """
    return [float(time) for time in begin + np.cumsum([0.0, *seconds[:-1]])]


def must_agree(records: Sequence[Record]) -> None:
    """Refuse records, perhaps made by hand, of uneven time or of different sampling periods."""
    how = "use records_from_arrays, which makes time and rate uniform"
    for record in records:
        off = np.abs(np.diff(record.time) - record.h) > UNIFORM_TOLERANCE * record.h
        if off.any():
            k = int(np.argmax(off))
            seen = (
                f"h is {record.h:.6g} s, but from sample {k} to the next it is"
                f" {record.time[k + 1] - record.time[k]:.6g} s"
            )
            raise BristleError(f"record {record.name}: {seen}; {how}")
        if abs(record.h - records[0].h) > RATE_TOLERANCE * record.h:
            seen = (
                f"sampled every {record.h:.6g} s, record {records[0].name} every"
                f" {records[0].h:.6g} s"
            )
            raise BristleError(f"record {record.name}: {seen}; {how}")


def _resampled(record: Record, h: float) -> Record:
    """Return the record at period h: outputs interpolated, the held input averaged over each new
    interval.
    """
    time, u = record.time, record.u
    n = int(np.floor((time[-1] - time[0]) / h * (1 + 1e-12))) + 1
    grid = time[0] + h * np.arange(n)
    held = np.concatenate([[0.0], np.cumsum(u[:-1] * np.diff(time))])
    last = time[-1] + h  # the last sample is held as well
    area = np.interp([*grid, grid[-1] + h], [*time, last], [*held, held[-1] + u[-1] * h])
    y, velocity = (
        (
            None
            if values is None
            else np.asarray(
                Akima1DInterpolator(time, values, method="makima")(np.minimum(grid, time[-1]))
            )
        )
        for values in (record.y, record.velocity)
    )
    assert y is not None
    known = {name: np.interp(grid, time, values) for name, values in record.known.items()}
    same = replace(record, time=grid, u=np.diff(area) / h, y=y, velocity=velocity, known=known)
    return replace(same, resampled=True)
