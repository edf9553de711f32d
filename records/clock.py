"""The time of a record: what is wrong with it, and one sampling period for all records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.records.record import Raw, Record
from bristle.records.resolution import common_step

LONGEST_PERIOD, SHORTEST_PERIOD = 0.1, 1e-5  # s: sampling periods outside are not those of a servo, but of a wrong unit
PERIOD_ROUNDING = 1e-6  # of them: a rounded period that is one of these by intent is not outside
UNIFORM_TOLERANCE = 0.01  # a sampling interval may differ from the mean by this fraction
LARGEST_JITTER = 0.5  # largest rms deviation of an interval, as a fraction of it, that is resampled
RATE_TOLERANCE = 1e-3  # sampling periods that differ less are one: the inertia is then off by twice as much at most
REPEATED_SHARE = 0.02  # largest share of repeated time stamps that are left out


def increasing(raw: Raw) -> None:
    """Leave out repeated time stamps, if they are few; refuse a time that runs back."""
    steps = np.diff(raw.time)
    if (steps < 0).any():
        k = int(np.argmax(steps < 0)) + 1
        raise raw.error(
            f"time falls back at sample {k}, from {raw.time[k - 1]:.9g} to {raw.time[k]:.9g} s; "
            "sort the record, or split it there if it holds two runs"
        )
    again = np.flatnonzero(steps == 0) + 1
    if len(again):
        if len(again) > REPEATED_SHARE * len(raw.time):
            raise raw.error(
                f"{len(again)} of {len(raw.time)} time stamps repeat the one before (first at sample {again[0]}), "
                f"allowed {REPEATED_SHARE:.0%}; write the time with more digits"
            )
        raw.say(f"{len(again)} time stamps repeat the one before (first at sample {again[0]}); these samples are left out")
        raw.keep(np.concatenate([[True], steps != 0]))


def period_of(raw: Raw) -> float:
    """Return the ordinary sampling period; refuse one that is not of a servo."""
    h = float(np.median(np.diff(raw.time)))
    if h > LONGEST_PERIOD * (1 + PERIOD_ROUNDING):
        raise raw.error(
            f"sampled every {h:.7g} s; allowed are {SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} s: "
            "is [time] unit right (ms, us)? else sample faster"
        )
    if h < SHORTEST_PERIOD * (1 - PERIOD_ROUNDING):
        raise raw.error(
            f"sampled every {h:.7g} s; allowed are {SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} s: is [time] unit right (s, ms)?"
        )
    return h


def clock(raw: Raw) -> tuple[Array, float, bool]:
    """Return time, sampling period, and whether the samples still have to be interpolated to a uniform time."""
    n, steps = len(raw.time), np.diff(raw.time)
    grid = np.linspace(raw.time[0], raw.time[-1], n)
    h = float(grid[-1] - grid[0]) / (n - 1)
    if np.max(np.abs(steps - h)) <= UNIFORM_TOLERANCE * h:
        return grid, h, False
    digit = common_step(raw.time)
    slope, start = np.polyfit(np.arange(n), raw.time - raw.time[0], 1)
    line = raw.time[0] + start + slope * np.arange(n)
    if digit is not None and digit < 0.7 * h and np.max(np.abs(raw.time - line)) <= 0.75 * digit:
        raw.say(f"time is written in steps of {digit:.4g} s; taken as uniform, {slope:.6g} s a sample")
        return line, float(slope), False
    ordinary = float(np.median(steps))
    missing = (np.round(steps / ordinary) > 1) & (np.abs(steps / ordinary - np.round(steps / ordinary)) < 0.2)
    rms = float(np.sqrt(np.mean((steps[~missing] - ordinary) ** 2))) / ordinary
    if rms > LARGEST_JITTER:
        raise raw.error(
            f"sampling intervals scatter by {rms:.0%} rms about {ordinary:g} s, allowed {LARGEST_JITTER:.0%}; "
            "sample with a steady clock"
        )
    if missing.any():
        where = f"{int(missing.sum())} places (first after {raw.time[np.argmax(missing)]:.6g} s)"
        raw.say(f"one or two samples are missing at {where}; bridged")
    raw.say(f"sampling intervals scatter by {rms:.1%} rms about {ordinary:.4g} s; interpolated to uniform ones")
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
            line = f"record {record.name}: sampled every {record.h:.6g} s, another record every {h:.6g} s; resampled to that"
            record = replace(record, findings=(*record.findings, line))
        if differs or record.resampled:
            time, u, y = _resample(record.time, record.u, record.y, h)
            record = replace(record, time=time, u=u, y=y, resampled=True)
        found.append(replace(record, h=h))
    return found


def must_agree(records: Sequence[Record]) -> None:
    """Refuse records whose time is not uniform, or whose sampling periods differ: nothing later looks at that again."""
    how = "records_from_arrays brings time and rate in order"
    for record in records:
        off = np.abs(np.diff(record.time) - record.h) > UNIFORM_TOLERANCE * record.h
        if off.any():
            k = int(np.argmax(off))
            seen = f"h is {record.h:.6g} s, but from sample {k} to the next it is {record.time[k + 1] - record.time[k]:.6g} s"
            raise BristleError(f"record {record.name}: {seen}; {how}")
        if abs(record.h - records[0].h) > RATE_TOLERANCE * record.h:
            seen = f"sampled every {record.h:.6g} s, record {records[0].name} every {records[0].h:.6g} s"
            raise BristleError(f"record {record.name}: {seen}; {how}")


def _resample(time: Array, u: Array, y: Array, h: float) -> tuple[Array, Array, Array]:
    """Return the record at period h: the output interpolated, the held input averaged over each new interval."""
    n = int(np.floor((time[-1] - time[0]) / h * (1 + 1e-12))) + 1
    grid = time[0] + h * np.arange(n)
    held = np.concatenate([[0.0], np.cumsum(u[:-1] * np.diff(time))])
    last = time[-1] + h  # the last sample is held as well
    area = np.interp([*grid, grid[-1] + h], [*time, last], [*held, held[-1] + u[-1] * h])
    return grid, np.diff(area) / h, np.asarray(Akima1DInterpolator(time, y, method="makima")(np.minimum(grid, time[-1])))
