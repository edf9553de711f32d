"""The columns of a measured file: names, units, scale, kind and resolution, written alike in model
files and in scenarios.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from bristle.common.errors import BristleError
from bristle.common.table import factor_to
from bristle.common.toml import Section, mistake, quoted
from bristle.common.units import quantity
from bristle.records.formats.rate import rate_of

LOAD = "load"  # what records call a second position
GOAL = "goal"  # what records call a goal beside a measured input
SETPOINT = "setpoint"  # kind of an input that is a goal for the output
# SI unit of each other kind of input
INPUT_UNITS = {"torque": "N.m", "force": "N", "voltage": "V", "current": "A"}


# SI unit of what may be known at each sample
KNOWN_UNITS = {
    "rotary": {"torque": "N.m", "inertia": "kg.m2", "inertia_factor": "1", "temperature": "K"},
    "linear": {"torque": "N", "inertia": "kg", "inertia_factor": "1", "temperature": "K"},
}


# -- what a file may hold --------------------------------------------------------------------------
class Column(Section):
    """A column of the file and its unit."""

    column: str
    """Name of the column."""
    unit: str
    """Unit of its values; "1" for counts."""
    scale: str | None = None
    """What one of that unit is worth where the unit does not fit, such as `0.088 deg`."""


class TimeTable(Section):
    """The column of the time, or the rate in its place."""

    column: str | None = None
    """Name of the column."""
    unit: str | None = None
    """Unit of its values."""
    scale: str | None = None
    """What one of that unit is worth where the unit does not fit."""
    rate: str | None = None
    """Sampling rate such as `200 Hz`, or interval such as `5 ms`, of records without a time."""


class InputTable(Column):
    """The column of the input."""

    kind: Literal["torque", "force", "voltage", "current", "setpoint"]
    """What the input is: `torque` and `force` fit an output that turns and one that moves, the
    others either; `setpoint` is the position, or by its unit the velocity, that a controller
    follows, in model files alone.
    """
    goal: Column | None = None
    """Column of the goal of the output, from which a controller made this input: a table
    `[input.goal]`."""


class OutputTable(Column):
    """The column of the output."""

    kind: Literal["position", "velocity"]
    """What the output is."""
    resolution: str | float | None = None
    """Smallest step of the output, in the column's unit or with a unit."""
    load: Column | None = None
    """Column of a second position, behind the gear or coupling: a table `[output.load]`. Where a
    gear is between both, its ratio is in `scale`."""
    differences: bool = False
    """Whether a velocity is the difference of two readings of a position over a sampling period; it
    is summed to that.
    """


class KnownTable(Section):
    """What is known of the servo at each sample."""

    torque: Column | None = None
    """Column of a torque (or force) that acts against the motion, such as that of the rest of an
    arm."""
    inertia: Column | None = None
    """Column of the inertia (or mass) in the place of J."""
    inertia_factor: Column | None = None
    """Column of the factor on J, in the place of `inertia`."""
    temperature: Column | None = None
    """Column of the temperature of what rubs, on which friction may depend."""


class LayoutTable(Section):
    """The three tables [time], [input] and [output]."""

    time: TimeTable
    """Column of the time, or the sampling rate of records without one."""
    input: InputTable
    """Column of the input, held from each sample to the next."""
    output: OutputTable
    """Column of the output."""


# -- the layout ------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Layout:
    """The columns of a record and what they are.

    Attributes
    ----------
    time, input, output : Column
        Where the record holds them; no time is None.
    rate : float or None
        Sampling rate [Hz] of records without a time.
    input_kind : {"torque", "force", "voltage", "current", "setpoint"}
        What the input is; a setpoint is what a controller follows.
    output_kind : {"position", "velocity"}
        What the output is.
    resolution : float or None
        Smallest step of the output [rad, rad/s, m or m/s], if it is known.
    linear : bool
        A linear axis: kg, m and N in place of kg.m2, rad and N.m.
    velocity : Column or None
        A velocity that was recorded besides the position.
    differences : bool
        Whether the column of the output holds the differences of a position, as a velocity.
    known : dict of str to Column
        Columns of what is known at each sample: "torque", "inertia", "inertia_factor",
        "temperature".
    load : Column or None
        A second position, of the load.
    goal : Column or None
        A goal of the output, from which a controller made the input.
    goal_is_rate : bool
        Whether the column of a setpoint holds a velocity; it is summed to a position.
    """

    time: Column | None = None
    rate: float | None = None
    input: Column
    input_kind: str
    output: Column
    output_kind: str
    resolution: float | None = None
    linear: bool = False
    velocity: Column | None = None
    differences: bool = False
    known: Mapping[str, Column] = field(default_factory=dict)
    load: Column | None = None
    goal: Column | None = None
    goal_is_rate: bool = False

    @property
    def input_unit(self) -> str:
        """SI unit of the input."""
        if self.input_kind == SETPOINT:
            return _output_unit("position", self.linear)
        return INPUT_UNITS[self.input_kind]

    @property
    def drive(self) -> str:
        """What drives the axis: the input, or what a controller makes of a setpoint."""
        if self.input_kind == SETPOINT:
            return "force" if self.linear else "torque"
        return self.input_kind

    @property
    def output_unit(self) -> str:
        """SI unit of the output."""
        return _output_unit(self.output_kind, self.linear)

    @property
    def columns(self) -> dict[str, tuple[Column, str]]:
        """Column and SI unit of time, input, output and, if recorded besides, velocity; no time
        where there is none.
        """
        read = _output_unit("velocity" if self.differences else self.output_kind, self.linear)
        found = {} if self.time is None else {"time": (self.time, "s")}
        rate = _output_unit("velocity", self.linear)
        found |= {
            "input": (self.input, rate if self.goal_is_rate else self.input_unit),
            "output": (self.output, read),
        }
        if self.velocity is not None:
            found["velocity"] = self.velocity, rate
        if self.load is not None:
            found[LOAD] = self.load, _output_unit("position", self.linear)
        if self.goal is not None:
            found[GOAL] = self.goal, self.output_unit
        units = KNOWN_UNITS["linear" if self.linear else "rotary"]
        return found | {f"known.{key}": (x, units[key]) for key, x in self.known.items()}


def _output_unit(kind: str, linear: bool) -> str:
    return ("m" if linear else "rad") + ("/s" if kind == "velocity" else "")


def layout_of(
    table: LayoutTable,
    where: Path | str,
    prefix: str = "",
    velocity: Column | None = None,
    known: KnownTable | None = None,
) -> Layout:
    """Return the layout that the tables of a file describe; `velocity` is that of a velocity
    besides the position, `known` what is known at each sample.

    An error is one line that begins with the file, `where`; `prefix` precedes the names of the
    tables in it ("record.").
    """
    linear = _is_linear(table, where, prefix)
    goal_is_rate = table.input.kind == SETPOINT and _fits(
        table.input, _output_unit("velocity", linear)
    )
    summed = _is_summed(table.output, goal_is_rate, where, prefix)
    layout = Layout(
        time=_time(table.time, where, prefix),
        rate=_rate(table.time, where, prefix),
        input=_column(table.input),
        input_kind=table.input.kind,
        output=_column(table.output),
        output_kind="position" if summed else table.output.kind,
        linear=linear,
        resolution=None if summed else _resolution(table.output, where, prefix, linear),
        velocity=velocity and _column(velocity),
        differences=summed,
        known=_known(known, where),
        load=table.output.load and _column(table.output.load),
        goal=table.input.goal and _column(table.input.goal),
        goal_is_rate=goal_is_rate,
    )
    _must_fit_together(layout, table.output.kind, where, prefix)
    _must_differ(layout, where, prefix)
    return layout


def _is_summed(out: OutputTable, goal_is_rate: bool, where: Path | str, prefix: str) -> bool:
    """Return whether the column of the output is summed to a position."""
    if out.differences and out.kind == "position":
        said = 'only a velocity is one of readings; write kind = "velocity"'
        raise mistake(where, f"{prefix}output.differences", True, said)
    if out.differences and out.resolution is not None:
        said = "the step of the position follows from the velocities; leave it out"
        raise mistake(where, f"{prefix}output.resolution", out.resolution, said)
    return out.differences or (goal_is_rate and out.kind == "velocity")


def _must_fit_together(layout: Layout, kind: str, where: Path | str, prefix: str) -> None:
    """Refuse columns beside an input or an output of another kind."""
    if layout.goal is not None and layout.input_kind == SETPOINT:
        said = "the input is the goal itself; give the column of a torque, current or voltage"
        raise mistake(where, f"{prefix}input.goal", None, said)
    if layout.load is not None and layout.output_kind != "position":
        said = 'is compared with the position of the motor; write kind = "position"'
        raise mistake(where, f"{prefix}output.load", None, said)
    if layout.velocity is not None and kind == "velocity":
        said = f"[{prefix}velocity] is given as well; remove one of them"
        raise mistake(where, f"{prefix}output.kind", "velocity", said)


def _fits(column: Column, unit: str) -> bool:
    try:
        factor_to(column.unit, column.scale, unit)
    except BristleError:
        return False
    return True


def _must_differ(layout: Layout, where: Path | str, prefix: str) -> None:
    """Refuse a unit that is none of its quantity, and a column in two roles."""
    roles: dict[str, str] = {}
    for key, (column, unit) in layout.columns.items():
        try:
            factor_to(column.unit, column.scale, unit)
        except BristleError as error:
            raise mistake(where, f"{prefix}{key}.unit", column.unit, str(error)) from None
        if column.column in roles:
            message = (
                f"is the column of [{prefix}{roles[column.column]}] already; name the one that"
                f" holds the {key}"
            )
            raise mistake(where, f"{prefix}{key}.column", column.column, message)
        roles[column.column] = key


def _column(table: Column) -> Column:
    """Return a column without what the tables of the input and the output say besides."""
    return Column(column=table.column, unit=table.unit, scale=table.scale)


def _time(table: TimeTable, where: Path | str, prefix: str) -> Column | None:
    """Return the column of the time; None where a rate stands in its place."""
    if table.rate is not None:
        for key in ("column", "unit", "scale"):
            if (value := getattr(table, key)) is not None:
                said = "is given beside rate; remove one of them"
                raise mistake(where, f"{prefix}time.{key}", value, said)
        return None
    if table.column is None or table.unit is None:
        lacking = "column" if table.column is None else "unit"
        said = f'[{prefix}time] lacks it; write column and unit, or rate = "200 Hz" without a time'
        raise mistake(where, f"{prefix}time.{lacking}", None, said)
    return Column(column=table.column, unit=table.unit, scale=table.scale)


def _rate(table: TimeTable, where: Path | str, prefix: str) -> float | None:
    """Return the sampling rate [Hz] in the place of a time."""
    if table.rate is None:
        return None
    try:
        return rate_of(table.rate)
    except BristleError as error:
        raise mistake(where, f"{prefix}time.rate", table.rate, str(error)) from None


def _known(table: KnownTable | None, where: Path | str) -> dict[str, Column]:
    """Return the columns of what is known at each sample."""
    given = {} if table is None else {key: getattr(table, key) for key in KNOWN_UNITS["rotary"]}
    found = {key: _column(column) for key, column in given.items() if column is not None}
    if {"inertia", "inertia_factor"} <= set(found):
        said = "is given beside known.inertia; remove one of them"
        raise mistake(where, "known.inertia_factor", found["inertia_factor"].column, said)
    return found


def _is_linear(table: LayoutTable, where: Path | str, prefix: str) -> bool:
    """Return whether the output is a linear axis's, which a force must drive, not a torque."""
    out, fits, why = table.output, [], ""
    for linear in (False, True):
        try:
            factor_to(out.unit, out.scale, _output_unit(out.kind, linear))
            fits.append(linear)
        except BristleError as error:
            why = why or str(error)
    if not fits:
        speed = "/s" if out.kind == "velocity" else ""
        hint = (
            why
            if "does not fit" not in why
            else f"does not fit kind '{out.kind}'; write rad{speed}, deg{speed}, m{speed} or "
            f'mm{speed}, or add scale = "... rad{speed}" over that unit'
        )
        raise mistake(where, f"{prefix}output.unit", out.unit, hint)
    linear = fits[0]
    if table.input.kind == ("torque" if linear else "force"):
        moved = "moves in metres" if linear else "turns"
        needed = "force" if linear else "torque"
        message = f'the output {moved}; write "{needed}", or correct {prefix}output.unit'
        raise mistake(where, f"{prefix}input.kind", table.input.kind, message)
    return linear


def _resolution(out: OutputTable, where: Path | str, prefix: str, linear: bool) -> float | None:
    """Return the resolution of the output in SI."""
    if out.resolution is None:
        return None
    want, key = _output_unit(out.kind, linear), f"{prefix}output.resolution"
    try:
        text = isinstance(out.resolution, str)
        value = (
            quantity(out.resolution, want)
            if text
            else float(out.resolution) * abs(factor_to(out.unit, out.scale, want))
        )
    except BristleError as error:
        raise mistake(where, key, out.resolution, str(error)) from None
    if not 0.0 < value < float("inf"):
        raise mistake(
            where, key, out.resolution, "must be above 0; leave it out if it is not known"
        )
    return value


# -- and back --------------------------------------------------------------------------------------
def layout_lines(layout: Layout) -> list[str]:
    """Return the lines of a TOML file that read back as this layout."""
    time = [f'rate = "{layout.rate!r} Hz"'] if layout.time is None else _column_lines(layout.time)
    lines = ["[time]", *time]
    lines += ["", "[input]", *_column_lines(layout.input), f"kind = {quoted(layout.input_kind)}"]
    kind = "velocity" if layout.differences else layout.output_kind
    lines += ["", "[output]", *_column_lines(layout.output), f"kind = {quoted(kind)}"]
    if layout.differences:
        lines.append("differences = true")
    if layout.resolution is not None and not layout.differences:
        lines.append(f'resolution = "{float(layout.resolution)!r} {layout.output_unit}"')
    if layout.velocity is not None:
        lines += ["", "[velocity]", *_column_lines(layout.velocity)]
    if layout.goal is not None:
        lines += ["", "[input.goal]", *_column_lines(layout.goal)]
    if layout.load is not None:
        lines += ["", "[output.load]", *_column_lines(layout.load)]
    for key, column in layout.known.items():
        lines += ["", f"[known.{key}]", *_column_lines(column)]
    return lines


def _column_lines(column: Column) -> list[str]:
    lines = [f"column = {quoted(column.column)}", f"unit = {quoted(column.unit)}"]
    return lines if column.scale is None else [*lines, f"scale = {quoted(column.scale)}"]
