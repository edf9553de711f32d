"""Intake of measured records: recognise what is wrong with them, mend what is safe, report it, refuse the rest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import Akima1DInterpolator

from bristle.diagnosis.modelfile import Model, must_be_model
from bristle.model.errors import BristleError
from bristle.model.table import Array, read_columns, si_column

SHORTEST = 200  # samples, of a record or of a piece of one: five segments of 0.4 s at 100 Hz, and half are held out
BRIEFEST = 2.0  # s, likewise
LARGEST = 1e30  # SI: no rig gives more, and squares of such numbers are no numbers any more
SLOWEST, FASTEST = 0.1, 1e-5  # s: sampling periods outside are not those of a servo, but of a wrong unit
UNIFORM = 0.01  # a sampling interval may differ from the mean by this fraction
GAP = 3.5  # an interval of more than this many is a gap; shorter ones are bridged
JITTER = 0.5  # largest rms deviation of an interval, as a fraction of it, that is resampled
SAME_RATE = 1e-3  # sampling periods that differ less are one: the inertia is then off by twice as much at most
REPEATED = 0.02  # largest share of repeated time stamps that are left out
EPOCH = 1e6  # s: a time that starts above counts from 1970, not from the start
SATURATED = 0.01  # a share of samples at an extreme value above this is a limit
LIMITED = 10  # samples, at least
CREST = 4.0  # and many times as long as on the values next to it
LEVELS = 20  # an input of fewer values is switched, not limited
STILL = 3.001  # steps of the resolution: less is no motion
SPIKE = 8.0  # a spike steps this many times farther than its neighbours
STUCK = 0.2  # s: an output that stands still so long while the input sweeps most of its range is worth a line


@dataclass(frozen=True)
class Record:
    """A record in SI, uniformly sampled, without holes or wraps.

    Attributes
    ----------
    name : str
        Name of the file; pieces of one are name[1], name[2].
    time : ndarray, shape (n,)
        Time [s], uniform; its start is the record's own, so that records of one session share it.
    h : float
        Sampling period [s], the same for all records that were loaded together.
    u : ndarray, shape (n,)
        Input in the model's `input_unit`, held from each sample to the next.
    y : ndarray, shape (n,)
        Output in the model's `output_unit`.
    findings : tuple of str
        What was found and done, one line each.
    resolution : float or None
        Smallest step that the output was recorded in, None where it has none.
    wrapped : bool
        Whether the position was recorded within one turn, and is unwrapped here.
    resampled : bool
        Whether samples were interpolated.
    """

    name: str
    time: Array
    h: float
    u: Array
    y: Array
    findings: tuple[str, ...] = ()
    resolution: float | None = None
    wrapped: bool = False
    resampled: bool = False

    def __len__(self) -> int:
        return len(self.time)


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
    if isinstance(paths, str | Path):
        paths = [paths]
    if not paths:
        raise BristleError("no record is given; give at least one measured file")
    real = [Path(path).resolve() for path in paths]
    for k, path in enumerate(real):
        if path in real[:k]:
            raise BristleError(f"record {paths[k]}: is given twice; a copy is no second measurement: leave it out")
    read = [_read(model, Path(path)) for path in paths]
    stems = [Path(path).stem for path in paths]
    names = [f"{stem}#{stems[:i].count(stem) + 1}" if stems.count(stem) > 1 else stem for i, stem in enumerate(stems)]
    return records_from_arrays(model, [(name, *columns) for name, columns in zip(names, read, strict=True)])


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
    records: list[Record] = []
    before: dict[str, tuple[Array, Array, Array]] = {}
    origin: float | None = None
    for entry in arrays:
        if not isinstance(entry, list | tuple) or len(entry) != 4:
            raise BristleError(f"record {len(records) + 1}: is not (name, time, u, y); give these four")
        name, *given = entry
        time, u, y = (_vector(name, key, values) for key, values in zip(("time", "input", "output"), given, strict=True))
        if not len(time) == len(u) == len(y):
            sizes = f"time {len(time)}, input {len(u)}, output {len(y)} samples"
            raise BristleError(f"record {name}: columns of different length ({sizes}); cut them to the same samples")
        for other, columns in before.items():
            if all(map(np.array_equal, (time, u, y), columns)):
                raise BristleError(f"record {name}: is the same as {other}; a copy is no second measurement: leave it out")
        before[name] = time, u, y
        raw = _Raw(name, time, u, y, [])
        _cut_ends(raw)
        _possible(model, raw)
        if origin is None and len(raw.time) and abs(raw.time[0]) > EPOCH:
            origin = float(raw.time[0])
        if origin is not None and abs(raw.time[0]) > EPOCH:
            raw.time = raw.time - origin
            raw.say(f"time starts at {origin:.0f} s; counted from the first record's first sample")
        records += _pieces(model, raw)
    if not records:
        raise BristleError("no record is given; give at least one")
    if all(_constant(record.u) for record in records):
        first = records[0]
        raise BristleError(
            f"record {first.name}: input is constant ({first.u[0]:g} {model.input_unit}) in every record; "
            "check [input] column, and give a record in which it moves"
        )
    for i, record in enumerate(records):
        if _constant(record.u):
            line = f"input is constant ({record.u[0]:g} {model.input_unit}): the record shows friction, but hardly inertia"
            records[i] = replace(record, findings=(*record.findings, f"record {record.name}: {line}"))
    return _one_rate(records)


# -- one record ----------------------------------------------------------------------------------------------------------


@dataclass
class _Raw:
    """A record on its way: SI, and whatever else is the matter."""

    name: str
    time: Array
    u: Array
    y: Array
    lines: list[str]

    def say(self, line: str) -> None:
        self.lines.append(f"record {self.name}: {line}")

    def error(self, line: str) -> BristleError:
        return BristleError(f"record {self.name}: {line}")

    def keep(self, chosen: NDArray[np.bool_] | slice) -> None:
        self.time, self.u, self.y = self.time[chosen], self.u[chosen], self.y[chosen]


def _read(model: Model, path: Path) -> tuple[Array, Array, Array]:
    columns = read_columns(path)
    time = si_column(f"record {path}: time", columns, model.time.column, model.time.unit, None, "s")
    u, y = (
        si_column(f"record {path}: {key}", columns, column.column, column.unit, column.scale, unit)
        for key, column, unit in (("input", model.input, model.input_unit), ("output", model.output, model.output_unit))
    )
    return time, u, y


def _vector(name: str, key: str, values: ArrayLike) -> Array:
    try:
        array = np.asarray(values)
        if array.dtype.kind == "c":
            raise TypeError
        array = array.astype(float)
    except (TypeError, ValueError):
        raise BristleError(f"record {name}: {key} is not an array of numbers; give one of shape (n,)") from None
    if array.ndim != 1:
        raise BristleError(f"record {name}: {key} has shape {array.shape}; give one of shape (n,)")
    return array


def _constant(u: Array) -> bool:
    return bool(np.ptp(u) <= 1e-9 * np.max(np.abs(u)))


def _cut_ends(raw: _Raw) -> None:
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
        key = ("time", "input", "output")[int(np.argmin(np.isfinite(table[k])))]
        count = int(np.sum(~whole[first : last + 1]))
        raise raw.error(f"{key} is not finite at sample {k} ({count} such samples before the end); repair them or cut the record")
    raw.say(f"{first} samples at the start and {len(whole) - 1 - last} at the end are not finite; left out")
    raw.keep(slice(first, last + 1))


def _possible(model: Model, raw: _Raw) -> None:
    """Refuse numbers that are none of a rig."""
    units = ("s", model.input_unit, model.output_unit)
    for key, values, unit in zip(("time", "input", "output"), (raw.time, raw.u, raw.y), units, strict=True):
        most = float(np.max(np.abs(values)))
        if most > LARGEST:
            raise raw.error(f"{key} reaches {most:.3g} {unit}, allowed {LARGEST:g}; check its column and unit")


def _pieces(model: Model, raw: _Raw) -> list[Record]:
    _increasing(raw)
    if len(raw.time) < SHORTEST:
        raise raw.error(f"{len(raw.time)} samples; at least {SHORTEST} are needed: record longer")
    h = _period(raw)
    resolution = _resolution(model, raw)
    _spikes(raw, resolution)
    wrapped = model.output_kind == "position" and _unwrap(model, raw, resolution)
    _frozen(raw, resolution)
    _limits(raw)
    _motion(model, raw, raw.y, resolution or model.resolution)
    borders = np.flatnonzero(np.diff(raw.time) > GAP * h) + 1
    runs = list(zip([0, *borders.tolist()], [*borders.tolist(), len(raw.time)], strict=True))
    records, dropped = [], []
    for number, (start, end) in enumerate(runs, start=1):
        name = raw.name if len(runs) == 1 else f"{raw.name}[{number}]"
        piece = _Raw(name, raw.time[start:end], raw.u[start:end], raw.y[start:end], [])
        length = piece.time[-1] - piece.time[0]
        still = np.ptp(piece.y) <= STILL * (resolution or 0.0)
        if len(piece.time) < SHORTEST or length < BRIEFEST or still:
            dropped.append((name, "nothing moves" if still else f"only {length:.3g} s and {len(piece.time)} samples"))
            continue
        time, period, jitters = _clock(piece)
        records.append(Record(name, time, period, piece.u, piece.y, tuple(piece.lines), resolution, wrapped, jitters))
    if len(runs) > 1:
        worst = int(np.argmax(np.diff(raw.time)))
        seen = f"largest {raw.time[worst + 1] - raw.time[worst]:.3g} s after {raw.time[worst]:.6g} s"
        raw.say(f"gaps in time: {len(runs) - 1} ({seen}); cut there into {len(runs)} pieces")
    for name, why in dropped:
        raw.say(f"piece {name} left out: {why}")
    if not records:
        if len(runs) == 1:
            length = f"lasts {raw.time[-1] - raw.time[0]:.6g} s; at least {BRIEFEST:g} s are needed"
            raise raw.error(f"{length}: record longer, or correct [time] unit")
        raise raw.error(f"no piece between gaps lasts {BRIEFEST:g} s with {SHORTEST} samples; record without gaps")
    records[0] = replace(records[0], findings=(*raw.lines, *records[0].findings))
    return records


def _increasing(raw: _Raw) -> None:
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
        if len(again) > REPEATED * len(raw.time):
            raise raw.error(
                f"{len(again)} of {len(raw.time)} time stamps repeat the one before (first at sample {again[0]}), "
                f"allowed {REPEATED:.0%}; write the time with more digits"
            )
        raw.say(f"{len(again)} time stamps repeat the one before (first at sample {again[0]}); these samples are left out")
        raw.keep(np.concatenate([[True], steps != 0]))


def _period(raw: _Raw) -> float:
    """Return the ordinary sampling period; refuse one that is not of a servo."""
    h = float(np.median(np.diff(raw.time)))
    if h > SLOWEST:
        raise raw.error(
            f"sampled every {h:g} s; allowed are {FASTEST:g} to {SLOWEST:g} s: is [time] unit right (ms, us)? else sample faster"
        )
    if h < FASTEST:
        raise raw.error(f"sampled every {h:g} s; allowed are {FASTEST:g} to {SLOWEST:g} s: is [time] unit right (s, ms)?")
    return h


def _clock(raw: _Raw) -> tuple[Array, float, bool]:
    """Return time, sampling period, and whether the samples still have to be interpolated to a uniform time."""
    n, steps = len(raw.time), np.diff(raw.time)
    grid = np.linspace(raw.time[0], raw.time[-1], n)
    h = float(grid[-1] - grid[0]) / (n - 1)
    if np.max(np.abs(steps - h)) <= UNIFORM * h:
        return grid, h, False
    digit = _common_step(raw.time)
    slope, start = np.polyfit(np.arange(n), raw.time - raw.time[0], 1)
    line = raw.time[0] + start + slope * np.arange(n)
    if digit is not None and digit < 0.7 * h and np.max(np.abs(raw.time - line)) <= 0.75 * digit:
        raw.say(f"time is written in steps of {digit:.4g} s; taken as uniform, {slope:.6g} s a sample")
        return line, float(slope), False
    ordinary = float(np.median(steps))
    missing = (np.round(steps / ordinary) > 1) & (np.abs(steps / ordinary - np.round(steps / ordinary)) < 0.2)
    rms = float(np.sqrt(np.mean((steps[~missing] - ordinary) ** 2))) / ordinary
    if rms > JITTER:
        raise raw.error(
            f"sampling intervals scatter by {rms:.0%} rms about {ordinary:g} s, allowed {JITTER:.0%}; sample with a steady clock"
        )
    if missing.any():
        where = f"{int(missing.sum())} places (first after {raw.time[np.argmax(missing)]:.6g} s)"
        raw.say(f"one or two samples are missing at {where}; bridged")
    raw.say(f"sampling intervals scatter by {rms:.1%} rms about {ordinary:.4g} s; interpolated to uniform ones")
    return raw.time, ordinary, True


def _resample(time: Array, u: Array, y: Array, h: float) -> tuple[Array, Array, Array]:
    """Return the record at period h: the output interpolated, the held input averaged over each new interval."""
    n = int(np.floor((time[-1] - time[0]) / h * (1 + 1e-12))) + 1
    grid = time[0] + h * np.arange(n)
    held = np.concatenate([[0.0], np.cumsum(u[:-1] * np.diff(time))])
    last = time[-1] + h  # the last sample is held as well
    area = np.interp([*grid, grid[-1] + h], [*time, last], [*held, held[-1] + u[-1] * h])
    return grid, np.diff(area) / h, np.asarray(Akima1DInterpolator(time, y, method="makima")(np.minimum(grid, time[-1])))


def _one_rate(records: list[Record]) -> list[Record]:
    """Bring all records to one sampling period, the coarsest; each is interpolated at most once."""
    h = max(record.h for record in records)
    if h - min(record.h for record in records) <= SAME_RATE * h:
        h = float(np.mean([record.h for record in records]))
    found = []
    for record in records:
        differs = abs(record.h - h) > SAME_RATE * h
        if differs and (h - record.h > UNIFORM * h or not record.resampled):
            line = f"record {record.name}: sampled every {record.h:.6g} s, another record every {h:.6g} s; resampled to that"
            record = replace(record, findings=(*record.findings, line))
        if differs or record.resampled:
            time, u, y = _resample(record.time, record.u, record.y, h)
            record = replace(record, time=time, u=u, y=y, resampled=True)
        found.append(replace(record, h=h))
    return found


# -- what the output shows -------------------------------------------------------------------------------------------------


def _common_step(values: Array) -> float | None:
    """Return the step whose multiples nearly all values are (from the smallest on), None if there is none."""
    distinct = np.unique(values)
    distinct = distinct - distinct[0]
    gaps = np.diff(distinct)
    gaps = gaps[gaps > 1e-12 * max(1.0, float(np.max(np.abs(values))))]
    if len(gaps) < 2:
        return None
    # most neighbours are one step apart, but a spike lies anywhere, and some steps come in twos and threes only
    for start in dict.fromkeys((float(np.min(gaps)), float(np.median(gaps)))):
        for divisor in (1.0, 2.0, 3.0):
            step = _refined(start / divisor, gaps, distinct)
            if step is not None:
                return step
    return None


def _refined(step: float, gaps: Array, distinct: Array) -> float | None:
    """Return the step that fits gaps and values best, None if more than one in a hundred is no multiple of it."""
    reach = 8.0
    while True:  # small multiples fix the step roughly, larger ones ever better
        near = np.concatenate([gaps[gaps < reach * step], distinct[distinct < reach * step]])
        count = np.round(near / step)
        good = np.abs(near / step - count) < 0.1
        if not (count * good).any() or np.mean(~good) > 0.01:
            return None
        step = float(count[good] @ near[good] / (count[good] @ count[good]))
        if reach * step > distinct[-1]:
            return step
        reach *= 4.0


def _resolution(model: Model, raw: _Raw) -> float | None:
    """Return the step of the output, and compare it with the model's."""
    found = _common_step(raw.y)
    if found is not None and found < 1e-7 * np.ptp(raw.y):
        found = None  # printed digits, not steps of a sensor
    if model.resolution is None:
        return found
    told = f"[output] resolution is {model.resolution:.4g} {model.output_unit}"
    if found is None:
        raw.say(f"{told}, but the output shows no such steps: was it filtered or interpolated?")
    elif not 0.8 < found / model.resolution < 1.25:
        raw.say(f"{told}, but the output comes in steps of {found:.4g} {model.output_unit}; correct the resolution or the unit")
    return found


def _motion(model: Model, raw: _Raw, y: Array, resolution: float | None) -> None:
    span = float(np.ptp(y))
    if span <= STILL * (resolution or 0.0) or span <= 1e-12 * float(np.max(np.abs(y))):
        unit = model.output_unit
        raise raw.error(
            f"nothing moves: the output stays within {span:.3g} {unit}"
            + (f", its resolution is {resolution:.3g} {unit}" if resolution else "")
            + "; check [output] column, and give a record with motion"
        )


def _spikes(raw: _Raw, resolution: float | None) -> None:
    """Replace isolated samples that jump away and back; a servo cannot."""
    d = np.diff(raw.y)
    size = np.abs(d)
    floor = max(6.0 * (resolution or 0.0), 1e-9 * float(np.max(np.abs(raw.y), initial=0.0)))
    mended: list[int] = []
    y = raw.y.copy()
    before = np.max(np.lib.stride_tricks.sliding_window_view(size, 6), axis=1)[:-1]  # of the six steps before step 6, 7, ...
    for k in (6 + np.flatnonzero((size[6:] > floor) & (size[6:] > SPIKE * before))).tolist():
        for width in (1, 2, 3):
            back = k + width
            if back + 6 >= len(d) or (mended and mended[-1] > k - 6):
                continue
            around = max(float(before[k - 6]), float(np.max(size[back + 1 : back + 7])))
            inside = float(np.max(size[k + 1 : back], initial=0.0))
            returns = d[k] * d[back] < 0 and abs(d[k] + d[back]) < 0.25 * size[k]
            if returns and size[back] > SPIKE * around and inside < 0.25 * size[k]:
                y[k + 1 : back + 1] = np.interp(np.arange(k + 1, back + 1), [k, back + 1], raw.y[[k, back + 1]])
                mended.append(k + 1)
                break
    if mended:
        k = mended[0]
        worst = max(float(size[i - 1]) for i in mended)
        where = f"first at sample {k}, {raw.time[k]:.6g} s; up to {worst:.3g}"
        raw.say(f"output jumps away and back at {len(mended)} places ({where}); interpolated over")
        raw.y = y


def _unwrap(model: Model, raw: _Raw, resolution: float | None) -> bool:
    """Unwrap a position that jumps by one and the same amount and never leaves a range of that size."""
    d = np.diff(raw.y)
    span = float(np.ptp(raw.y))
    jumps = np.flatnonzero(np.abs(d) > 0.5 * span)
    if not len(jumps) or span == 0.0:
        return False
    rest = np.abs(np.delete(d, jumps))
    if np.max(rest, initial=0.0) > 0.25 * span:
        return False
    sizes = np.abs(d[jumps] - 0.5 * (d[np.maximum(jumps - 1, 0)] + d[np.minimum(jumps + 1, len(d) - 1)]))
    full = 2.0 * np.pi
    turn = float(np.median(sizes))
    likely = [known for known in ((full, 360.0, 1.0) if not model.linear else ()) if abs(turn - known) < 0.02 * known]
    if likely:
        turn = likely[0]
    elif resolution:
        turn = resolution * round(turn / resolution)
    if span > 1.02 * turn or np.max(np.abs(sizes - turn)) > 0.1 * turn:
        return False
    if len(jumps) < 2 and (model.linear or turn != full):
        return False  # one jump of any size may be a slip; one of a turn is not
    raw.y = raw.y + np.concatenate([[0.0], np.cumsum(np.where(np.abs(d) > 0.5 * span, -np.sign(d) * turn, 0.0))])
    first = f"{len(jumps)} times (first at {raw.time[jumps[0]]:.6g} s)"
    if model.linear or turn == full:
        raw.say(f"position wraps by {turn:.6g} {model.output_unit} {first}; unwrapped")
    else:
        raw.say(
            f"position wraps by {turn:.6g} {model.output_unit} {first}; unwrapped, but a turn has {full:.4g} rad: "
            f"check [output] unit ('{model.output.unit}') and scale"
        )
    return True


def _frozen(raw: _Raw, resolution: float | None) -> None:
    """Report an output that freezes in motion and then catches up, or stands still under a sweeping input."""
    same = np.diff(raw.y) == 0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
    runs = edges.reshape(-1, 2)  # differences start..end-1 are zero
    d = np.abs(np.diff(raw.y))
    span = float(np.ptp(raw.u))
    caught, still = [], []
    for start, end in runs[runs[:, 1] - runs[:, 0] >= 5].tolist():
        if start >= 4 and end + 4 < len(d):
            speed = float(np.mean(d[start - 3 : start]))
            leap = float(d[end])
            after = float(np.max(d[end + 1 : end + 4]))
            if speed > 3 * (resolution or 0.0) and leap > 0.5 * speed * (end - start) and leap > 2.5 * max(after, speed):
                caught.append((start, end))
                continue
        if raw.time[end] - raw.time[start] >= STUCK and np.ptp(raw.u[start : end + 1]) > 0.8 * span > 0.0:
            still.append((start, end))
    for runs_found, what in (
        (caught, "the output freezes in motion and then catches up: a lost reading; cut these parts"),
        (still, "the output stands still while the input sweeps most of its range: a stop, a drive that is off, a stuck sensor?"),
    ):
        if runs_found:
            start, end = runs_found[0]
            where = f"{len(runs_found)} such parts, the first from {raw.time[start]:.6g} to {raw.time[end]:.6g} s"
            raw.say(f"{what} ({where})")


def _limits(raw: _Raw) -> None:
    """Report an input that rests at its largest or smallest value."""
    values, counts = np.unique(raw.u, return_counts=True)
    if len(values) < LEVELS:
        return
    for which, value, count, beside in (
        ("largest", values[-1], counts[-1], np.max(counts[-4:-1])),
        ("smallest", values[0], counts[0], np.max(counts[1:4])),
    ):
        # the crest of a signal in steps also dwells on its last value, but not so much longer than on those before
        if count > max(SATURATED * len(raw.u), LIMITED) and count > CREST * beside and value != 0.0:
            line = f"input is at its {which} value {value:.6g} for {count / len(raw.u):.1%} of the time"
            raw.say(f"{line}: a limit; what is logged must be behind it")
