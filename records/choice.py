"""Which columns of measured files may be time, input and output, and how each would be declared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bristle.common.columns import Array, Columns
from bristle.common.errors import BristleError, suggest
from bristle.common.table import factor_to
from bristle.common.unit_names import COUNTS, unit_symbol
from bristle.records.formats.own_rows import at_rows_of, own_rows
from bristle.records.headings import UNITS, Heading, heading
from bristle.records.intake import WRAP_SHARE
from bristle.records.kinematics import NO_KINEMATICS, Kinematics, motion_in
from bristle.records.layout import INPUT_UNITS, SETPOINT, Column

TURN_COUNTS = 4096  # counts a turn that are assumed where nothing shows them
COUNTER_STEPS = 50  # steps: an output of whole numbers that covers more of them is a counter
DISTINCT_SHARE = 0.9  # of the samples: least share of different values of a time
USUAL_PERIOD = 1e-3  # s: sampling period that a unit of the time is chosen by, where none is given
SLOWEST_PERIOD = 0.1  # s: longest sampling period of a time in s
SHOWN_COLUMNS = 12  # columns that an error lists at most
MOTION_KINDS = ("position", "velocity")
# 0: the first choice
RANKS = {"torque": 0, "force": 0, "current": 1, "voltage": 2, "position": 0, "velocity": 1}
# of a setpoint among inputs and outputs, of u and y, of a column of any other name
SETPOINT_RANK, LETTER_RANK, UNKNOWN_RANK = 10, 15, 20
ROLE_LETTERS = {"u": "input", "y": "output"}  # what control engineers call these
EVEN_SCATTER = 0.1  # of the median interval: largest scatter of a time that is not called so


@dataclass(frozen=True)
class Candidate:
    """A column in a role.

    Attributes
    ----------
    column : Column
        Name, unit and scale.
    kind : str
        "time", a kind of input or a kind of output.
    rank : int
        0 for the likeliest by name and unit.
    doubts : tuple of str
        What had to be assumed, one line each.
    scatter : float
        Of a time: how far its intervals are from their median, on the average and as a share of it.
    rate : float or None
        Sampling rate [Hz] in the place of a time.
    """

    column: Column
    kind: str
    rank: int
    doubts: tuple[str, ...] = ()
    scatter: float = 0.0
    rate: float | None = None

    @property
    def linear(self) -> bool:
        """Whether an output is in metres."""
        try:
            factor_to(
                self.column.unit, self.column.scale, "m" if self.kind == "position" else "m/s"
            )
        except BristleError:
            return False
        return True


@dataclass(frozen=True)
class Files:
    """The columns that all files have, their headings, what the user says of them, and what their
    values say.
    """

    tables: Mapping[Path, Columns]
    units: Mapping[str, str]
    motion: Kinematics = NO_KINEMATICS

    @classmethod
    def of(
        cls, tables: Mapping[Path, Columns], units: Mapping[str, str], asked: Mapping[str, str]
    ) -> Files:
        """Return the columns of tables, all at the instants of one time: of the column that is
        asked for as time or output, or of the topic that looks most like a servo.
        """
        first = next(iter(tables.values()))
        if first.times:
            wanted = first.times.get(asked.get("time", asked.get("output", "")))
            time = wanted or _most_like_a_servo(cls(tables, units), first.times)
            tables = {path: table.at(time) for path, table in tables.items()}
        elif sparse := own_rows(first):
            full = next((name for name in first if name not in sparse), "")
            groups = {name: sparse.get(name, full) for name in first}
            rows = asked.get("output") or _most_like_a_servo(cls(tables, units), groups)
            tables = {path: at_rows_of(table, rows, table) for path, table in tables.items()}
        return cls(tables, units)

    @property
    def names(self) -> list[str]:
        """Names of the columns that all files have and that are as long as most."""
        first = next(iter(self.tables.values()))
        length = max((len(values) for values in first.values()), default=0)
        shared = [name for name in first if all(name in table for table in self.tables.values())]
        return [name for name in shared if len(first[name]) == length]

    def values(self, name: str) -> Array:
        """Return the finite values of a column in all files."""
        values: Array = np.concatenate([table[name] for table in self.tables.values()])
        return values[np.isfinite(values)]

    def heading(self, name: str) -> Heading:
        """Return what name and unit of a column say."""
        if name in self.units:
            symbol = unit_symbol(self.units[name])
            if symbol is None:
                raise BristleError(
                    f"unit '{self.units[name]}' of '{name}' is not known; write for example deg,"
                    " rpm, N.m, ms or count"
                )
            return heading(name, symbol)
        said = heading(name, next(iter(self.tables.values())).units.get(name))
        shown = None if said.quantity else self.motion.quantity(name)
        goal = said.setpoint or name in self.motion.goals
        return replace(said, quantity=said.quantity or shown, setpoint=goal)

    def moving(self, time: Candidate) -> Files:
        """Return the same with what the values of the columns say, by a time that was chosen."""
        table = next(iter(self.tables.values()))
        columns = {name: table[name] for name in self.names if name != time.column.column}
        length = len(next(iter(columns.values()), ()))
        if time.rate:
            seconds = np.arange(length) / time.rate
        else:
            seconds = table[time.column.column] * factor_to(
                time.column.unit, time.column.scale, "s"
            )
        usable = bool(np.isfinite(seconds).all()) and not self.clock(time.column.column)
        return replace(self, motion=motion_in(seconds, columns)) if usable else self

    def clock(self, name: str) -> bool:
        return all(name in table.clocks for table in self.tables.values())

    def varying(self) -> list[Heading]:
        """Return the headings of the columns that change and may be an input or an output."""
        found = []
        for name in self.names:
            values = self.values(name)
            if len(values) and np.ptp(values) > 0.0 and not self.clock(name):
                found.append(self.heading(name))
        return found


def _most_like_a_servo(files: Files, groups: Mapping[str, str]) -> str:
    """Return the group of columns, of one time or of the same rows, that holds a motion and what
    drives it, the longest of several alike; `groups` gives that of each column.
    """
    table = next(iter(files.tables.values()))

    def rank(group: str) -> tuple[int, int, int]:
        names = [name for name, its in groups.items() if its == group]
        own = [files.heading(name) for name in names]
        measured = {h.quantity for h in own if not (h.setpoint or h.unwanted)}
        moves = 2 * ("position" in measured) + ("velocity" in measured)
        length = int(np.isfinite(table[names[0]]).sum())
        return moves, len(measured & set(INPUT_UNITS)), length

    return max(dict.fromkeys(groups.values()), key=rank)


def candidates(
    files: Files, role: str, asked: str | None, taken: Sequence[str] = ()
) -> list[Candidate]:
    """Return what may be the "time", "input" or "output", the likeliest first; `asked` is the
    column that the user wants.

    Raises
    ------
    BristleError
        If there is none, or not the one that is asked for.
    """
    names = [name for name in files.names if name not in taken]
    if asked is not None and asked not in names:
        why = (
            "is another role's already"
            if asked in taken
            else f"is no column of numbers in every file{suggest(asked, names)}"
        )
        raise BristleError(f"{role} '{asked}': {why}; there are: {_listed(names)}")
    make = {"time": _times, "input": _inputs, "output": _outputs}[role]
    found = [each for each in make(files, asked) if each.column.column not in taken]
    if role == "time" and not found and asked is None:
        found = _at_own_rate(files)
    if not found:
        raise _none_found(files, role, asked, names)
    return sorted(found, key=lambda each: (each.rank, each.scatter))


def _none_found(files: Files, role: str, asked: str | None, names: Sequence[str]) -> BristleError:
    """Return why no column can have a role."""
    if asked and np.ptp(files.values(asked)) == 0.0:
        return BristleError(f"{role} '{asked}': is constant; give a column that changes")
    alone = sorted({name for table in files.tables.values() for name in table} - set(files.names))
    more = f"; not in every file, or of another length: {_listed(alone)}" if alone else ""
    why = _what_a_time_does(files) if role == "time" else _what_texts_hold(files, alone)
    if role == "input" and {files.heading(name).quantity for name in names} <= {*MOTION_KINDS}:
        return BristleError(
            f"record {next(iter(files.tables))}: no column is an input, and motion alone does not"
            " tell what moved it; log the torque, force, voltage, current or goal as well, or give"
            f" the column with --{role}: {_listed(names)}{more}"
        )
    rate = ', or the sampling rate, --rate "200 Hz"' if role == "time" else ""
    return BristleError(
        f"record {next(iter(files.tables))}: no column is likely to be the {role}{why}; give it"
        f" with --{role} COLUMN{rate}: {_listed(names)}{more}"
    )


def _what_a_time_does(files: Files) -> str:
    """Return where the first column that is called a time does not rise, or an empty text."""
    for name in (
        name for name in files.names if files.clock(name) or files.heading(name).quantity == "time"
    ):
        for path, table in files.tables.items():
            values = table[name][np.isfinite(table[name])]
            back = np.flatnonzero(np.diff(values) < 0)
            if len(back):
                k = int(back[0])
                return (
                    f": '{name}' goes back in {path}, from {values[k]:.6g} to {values[k + 1]:.6g}"
                    f" at sample {k + 1}"
                )
            if len(repeated := np.flatnonzero(np.diff(values) == 0)):
                return f": '{name}' repeats {len(repeated)} of {len(values)} values in {path}"
    return ""


def _what_texts_hold(files: Files, names: Sequence[str]) -> str:
    """Return what columns hold that are numbers in some files only, or in none."""
    said = {
        name: f"'{name}' holds {table.unusable[name]} in {path}"
        for path, table in reversed(list(files.tables.items()))
        for name in table.unusable
        if name in names or len(files.tables) == 1
    }
    return f": {'; '.join(said.values())}" if said else ""


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN_COLUMNS} more" if len(names) > SHOWN_COLUMNS else ""
    return ", ".join(names[:SHOWN_COLUMNS]) + more


# -- time ------------------------------------------------------------------------------------------
def _times(files: Files, asked: str | None) -> list[Candidate]:
    found, even = [], []
    for name in [asked] if asked else files.names:
        h = files.heading(name)
        series = [table[name][np.isfinite(table[name])] for table in files.tables.values()]
        if not asked and not all(map(_rises, series)):
            continue
        steps = np.concatenate([np.diff(x) for x in series])
        scatter = float(np.mean(np.abs(steps / (np.median(steps) or 1.0) - 1.0)))
        candidate = _time(h, files.clock(name), series[0], scatter)
        if asked or files.clock(name) or h.quantity == "time":
            found.append(candidate)
        elif scatter < EVEN_SCATTER and not _numbered(steps, series[0]):
            doubt = f"no column is called a time; '{name}' rises evenly"
            even.append(replace(candidate, rank=UNKNOWN_RANK, doubts=(doubt, *candidate.doubts)))
    return found or even


def at_rate(rate: float, doubts: tuple[str, ...] = ()) -> Candidate:
    """Return a sampling rate [Hz] in the place of a time."""
    return Candidate(Column(column="", unit="s"), "time", 0, doubts, rate=rate)


def _at_own_rate(files: Files) -> list[Candidate]:
    """Return the sampling rate that the files give apart from their columns, if it is one."""
    [rate, *others] = {table.rate for table in files.tables.values()}
    if rate is None or others:
        return []
    return [at_rate(rate, (f"no column is a time; the rate in the file is taken, {rate:.6g} Hz",))]


def _rises(values: Array) -> bool:
    """Return whether values rise like a time: never back, and hardly ever the same."""
    if len(values) < 2 or not (np.diff(values) >= 0).all():
        return False
    return len(np.unique(values)) > DISTINCT_SHARE * len(values)


def _numbered(steps: Array, values: Array) -> bool:
    """Return whether values are the numbers of the samples."""
    return bool((steps == 1.0).all()) and values[0] in (0.0, 1.0)


def _time(h: Heading, clock: bool, values: Array, scatter: float) -> Candidate:
    if clock or (h.fits and h.quantity == "time"):
        return Candidate(
            Column(column=h.name, unit="s" if clock else str(h.unit)), "time", 0, scatter=scatter
        )
    unit = _time_unit(values)
    step = float(np.median(np.diff(values)))
    doubt = (
        f"the unit of time '{h.name}' is not given; {unit} is assumed, a sample every"
        f" {step:.4g} {unit}"
    )
    return Candidate(Column(column=h.name, unit=unit), "time", 1, (doubt,), scatter)


def _time_unit(values: Array) -> str:
    """Return s, or for whole numbers and long intervals the unit in which the sampling period is
    nearest to the usual one.
    """
    step = float(np.median(np.diff(values)))
    whole = (values == np.round(values)).all()
    if step <= 0.0 or not (whole or step > SLOWEST_PERIOD):
        return "s"
    return min(
        ("ms", "us", "ns"),
        key=lambda unit: abs(np.log(step * factor_to(unit, None, "s") / USUAL_PERIOD)),
    )


# -- input -----------------------------------------------------------------------------------------
def _inputs(files: Files, asked: str | None) -> list[Candidate]:
    found = []
    for h in files.varying():
        if h.setpoint and h.quantity in MOTION_KINDS and asked in (None, h.name):
            found += [goal] if (goal := _goal(files, h, h.quantity)) else []
            continue
        if asked not in (None, h.name) or (
            asked is None
            and (h.quantity in ("time", "position", "velocity") or _excluded(h, "output"))
        ):
            continue
        kind = h.quantity if h.quantity in INPUT_UNITS else None
        if kind is None:
            said = f"what '{h.name}' is, is not said; a voltage is assumed"
            found.append(
                Candidate(Column(column=h.name, unit="V"), "voltage", _unknown_rank(h), (said,))
            )
        elif candidate := _declared(h, kind, INPUT_UNITS[kind], INPUT_UNITS[kind]):
            found.append(candidate)
    return found


def fitted(candidate: Candidate, linear: bool) -> Candidate:
    """Return an input as the axis needs it: a torque that moves a linear axis becomes a force, and
    the other way round.
    """
    if candidate.kind not in ("torque", "force") or linear == (candidate.kind == "force"):
        return candidate
    kind, lever = ("force", "1 1/m") if linear else ("torque", "1 m")
    scale = (
        lever
        if candidate.column.scale is None
        else f"{candidate.column.scale}{'/m' if linear else '.m'}"
    )
    doubt = (
        f"'{candidate.column.column}' is a {candidate.kind} and the output"
        f" {'moves in metres' if linear else 'turns'}: a lever of 1 m is assumed; write the right"
        " one as scale"
    )
    return replace(
        candidate,
        column=candidate.column.model_copy(update={"scale": scale}),
        kind=kind,
        doubts=(*candidate.doubts, doubt),
    )


def _goal(files: Files, h: Heading, kind: str) -> Candidate | None:
    """Return what a controller follows, a position in the unit of the position if it has none."""
    position = files.motion.goals.get(h.name)
    unit = h.unit or (files.heading(position).unit if position else None)
    found = _output(files, replace(h, unit=unit, setpoint=False), kind)
    return found and replace(found, kind=SETPOINT, rank=SETPOINT_RANK + RANKS[kind])


# -- output ----------------------------------------------------------------------------------------
def _outputs(files: Files, asked: str | None) -> list[Candidate]:
    found: list[Candidate | None] = []
    for h in files.varying():
        elsewhere = (h.named and h.quantity in ("time", *INPUT_UNITS)) or _excluded(h, "input")
        if asked not in (None, h.name) or (asked is None and elsewhere):
            continue  # a column that is a voltage by its unit alone may be that of a sensor
        if h.quantity in MOTION_KINDS:
            found.append(_output(files, h, h.quantity))
        else:
            found += [
                _output(files, replace(h, quantity=kind), kind, unknown=True)
                for kind in MOTION_KINDS
            ]
    return [each for each in found if each is not None]


def _output(files: Files, h: Heading, kind: str, unknown: bool = False) -> Candidate | None:
    """Return a column as a position or a velocity."""
    si = UNITS[kind][0]
    shown, turn = None, None
    if kind == "position" and h.unit in (None, COUNTS):
        shown, turn = _shown_turn(files.values(h.name), h.unit == COUNTS)
    per = "/s" if kind == "velocity" else ""
    if h.unit == COUNTS or shown == COUNTS:
        doubts = (
            ()
            if turn
            else (
                (
                    f"counts a turn of '{h.name}' are not known: {TURN_COUNTS} assumed; write what"
                    " one count is as scale"
                ),
            )
        )
        scale = f"{360.0 / (turn or TURN_COUNTS)!r} deg{per}"
        candidate = Candidate(
            Column(column=h.name, unit=f"1{per}", scale=scale.replace("/s", "")),
            kind,
            RANKS[kind],
            doubts,
        )
    else:
        given = _declared(h, kind, si, shown or si)
        if given is None:
            return None
        candidate = given
    if unknown:
        candidate = replace(
            candidate,
            rank=_unknown_rank(h),
            doubts=(f"what '{h.name}' is, is not said; a {kind} is assumed", *candidate.doubts),
        )
    return replace(candidate, rank=candidate.rank + SETPOINT_RANK) if h.setpoint else candidate


def _shown_turn(values: Array, counts: bool) -> tuple[str | None, int | None]:
    """Return the unit that wraps of a position show, degrees or counts, and the counts a turn."""
    span = float(np.ptp(values))
    jumps = np.abs(np.diff(values))
    wraps = bool((jumps > WRAP_SHARE * span).any())
    whole = bool((values == np.round(values)).all()) and span > COUNTER_STEPS
    if (
        wraps
        and not counts
        and abs(span - 360.0) < 0.02 * 360.0
        and not (whole and span < 360.0 - 1.5)
    ):
        return "deg", None
    if not (counts or whole):
        return None, None
    bits = round(float(np.log2(span + 1.0)))
    return COUNTS, 2**bits if wraps and span <= 2**bits < 1.02 * span + 2.0 else None


def _letter(h: Heading) -> str:
    """Return the letter that a name consists of, without number and struct."""
    return h.name.rpartition(".")[2].rstrip("0123456789_").lower()


def _excluded(h: Heading, role: str) -> bool:
    """Return whether a column is unwanted, or called by the letter of another role."""
    return h.unwanted or ROLE_LETTERS.get(_letter(h)) == role


def _unknown_rank(h: Heading) -> int:
    return LETTER_RANK if _letter(h) in ROLE_LETTERS else UNKNOWN_RANK


# -- both ------------------------------------------------------------------------------------------
def _declared(h: Heading, kind: str, si: str, default: str) -> Candidate | None:
    """Return a column with its unit, or with the default one; a unit of another quantity gets a
    scale of 1, which is a doubt.
    """
    rank = RANKS[kind]
    if h.unit is None:
        return Candidate(
            Column(column=h.name, unit=default),
            kind,
            rank,
            (f"the unit of '{h.name}' is not given; {default} is assumed",),
        )
    if h.fits and h.quantity == kind:
        return Candidate(Column(column=h.name, unit=h.unit), kind, rank)
    unit = "1" if h.unit == COUNTS else h.unit
    scale = (
        f"1 {si}"
        if unit in ("1", "%")
        else f"1 {si.replace('/', '/(')}.{unit})"
        if "/" in si
        else f"1 {si}/{unit}"
    )
    worth = (
        f"100 % of '{h.name}' are taken as 1 {si}"
        if unit == "%"
        else f"1 {h.unit} of '{h.name}' is taken as 1 {si}"
    )
    try:
        factor_to(unit, scale, si)
    except BristleError:
        return None
    return Candidate(
        Column(column=h.name, unit=unit, scale=scale),
        kind,
        rank,
        (f"{worth}; write the right value as scale",),
    )
