"""The model file of a diagnosis: friction law, nominal parameters and their bounds, and what the columns hold."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from bristle.common.errors import BristleError, suggest
from bristle.common.table import factor_to
from bristle.common.toml import Section, first_mistake, mistake, read_toml
from bristle.common.units import parse_unit, quantity
from bristle.model.variables import Parameter
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects
from bristle.plant.friction import law as find_law
from bristle.plant.friction import laws
from bristle.plant.law import FrictionLaw
from bristle.plant.servo import A2, B, J, servo

Given = str | int | float | bool
Kind = Literal["torque", "force", "voltage", "current"]
INPUT_UNITS = {"torque": "N.m", "force": "N", "voltage": "V", "current": "A"}
BOUND_FACTOR = 5.0  # a parameter without bounds may move by this factor either way
NO_LIMIT = 1e6  # u_max: the measured input is what arrived, so the model must not clip it


# -- what a file may hold ----------------------------------------------------------------------------------------------
class TimeTable(Section):
    """The column of the time."""

    column: str
    unit: str


class InputTable(Section):
    """The column of the input; `scale` (such as "0.01 N.m") turns its unit into that of the kind."""

    column: str
    kind: Kind
    unit: str
    scale: str | None = None


class OutputTable(Section):
    """The column of the output; `resolution` is in the column's unit, or text with a unit."""

    column: str
    kind: Literal["position", "velocity"]
    unit: str
    scale: str | None = None
    resolution: str | float | None = None


class ModelTable(Section):
    """A model file, checked as far as it can be without looking at the friction law."""

    friction: str
    parameters: dict[str, Any]
    bounds: dict[str, Any] | None = None
    time: TimeTable
    input: InputTable
    output: OutputTable
    effects: dict[str, dict[str, Given]] = Field(default={})


# -- the model -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Column:
    """A column of a record: its name, its unit, and the scale over that unit, where there is one."""

    column: str
    unit: str
    scale: str | None = None


@dataclass(frozen=True)
class Model:
    """A model of the servo that was measured; all numbers in SI, all names those of `bristle.plant.servo`.

    Attributes
    ----------
    friction : str
        The friction law.
    parameters : dict of str to float
        Nominal values of J, a2, b (voltage and current only) and the law's own (``coulomb.Fc``).
    bounds : dict of str to (float, float)
        Which of these may move, and how far; the others stay.
    time, input, output : Column
        Where the record holds them.
    input_kind : {"torque", "force", "voltage", "current"}
        What the input is; torque and force act with b = 1.
    output_kind : {"position", "velocity"}
        What the output is.
    resolution : float or None
        Smallest step of the output [rad, rad/s, m or m/s], if it is known.
    linear : bool
        A linear axis: kg, m and N in place of kg.m2, rad and N.m.
    effects : dict of str to dict
        Effects that the model has already: values of their parameters, without the effect's name before them.
    path : Path or None
        The file it came from.
    """

    friction: str
    parameters: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    time: Column
    input: Column
    input_kind: str
    output: Column
    output_kind: str
    resolution: float | None = None
    linear: bool = False
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    path: Path | None = None

    @property
    def input_unit(self) -> str:
        """SI unit of the input."""
        return INPUT_UNITS[self.input_kind]

    @property
    def output_unit(self) -> str:
        """SI unit of the output."""
        return _output_unit(self.output_kind, self.linear)

    @property
    def values(self) -> dict[str, float]:
        """Nominal values of all parameters, those of the effects that it has already included (``gravity.amplitude``)."""
        return {**self.parameters, **{f"{e}.{p}": x for e, values in self.effects.items() for p, x in values.items()}}

    def unit(self, name: str) -> str:
        """Return the SI unit of a parameter of the servo, of the law or of any effect (``cogging.amplitude``)."""
        return own_unit(_declared(self.friction)[name], self.linear, self.input_kind)

    def allowed(self, name: str) -> tuple[float, float]:
        """Return the least and the greatest value that such a parameter may have, SI."""
        declared = _declared(self.friction)[name]
        return declared.minimum, declared.maximum

    def settings(self, parameters: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return what a servo of this law and these effects is set to: `parameters` in place of the nominal ones.

        The input is never clipped (u_max), and b is 1 where the input is a torque or a force.
        """
        return {"u_max": NO_LIMIT, "b": 1.0, **self.values, **(parameters or {})}

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any], where: Path | str = "model") -> Model:
        """Return the model that a tree such as a model file's describes; `where` begins the line of an error.

        Raises
        ------
        BristleError
            One line that names key, value and what is allowed.
        """
        if not isinstance(tree, Mapping):
            raise BristleError(f"{where}: is a {type(tree).__name__}; give a dict such as tomllib.load returns, or use load_model")
        try:
            table = ModelTable.model_validate(dict(tree))
        except ValidationError as error:
            raise first_mistake(where, ModelTable, error) from None
        return _model(table, where)


def must_be_model(model: object) -> None:
    """Raise `BristleError` where something else is given for a model, its path say."""
    if not isinstance(model, Model):
        raise BristleError(f"the model is a {type(model).__name__}; give what load_model or Model.from_dict returns")


def must_be_path(path: object, what: str) -> None:
    """Raise `BristleError` where something else is given for a path."""
    if not isinstance(path, str | os.PathLike):
        raise BristleError(f"the path of a {what} is a {type(path).__name__}; give text or a Path")


def load_model(path: Path | str) -> Model:
    """Read and check a model file.

    Raises
    ------
    BristleError
        One line that names file, key, value and what is allowed.
    """
    must_be_path(path, "model file")
    path = Path(path)
    _, tree = read_toml(path, "model file")
    return Model.from_dict(tree, path)


def si_unit(unit: str, linear: bool, kind: str) -> str:
    """Return a declared unit as it is for a linear axis (kg for kg.m2, m for rad) and for an input that is no voltage."""
    if linear:
        unit = re.sub(r"kg\.m2", "kg", unit)
        unit = re.sub(r"N\.m(?![A-Za-z0-9])", "N", unit)
        unit = re.sub(r"(?<![A-Za-z])rad", "m", unit)
    return re.sub(r"(?<![A-Za-z])V(?![A-Za-z])", INPUT_UNITS[kind], unit)


def own_unit(parameter: Parameter, linear: bool, kind: str) -> str:
    """Return the unit of a parameter on such a rig: the phase of a wave is an angle on a linear axis, too."""
    name = parameter.name.rpartition(".")[2]
    if linear and name in {e.periods for e in all_effects().values()}:
        return "rad/m"
    return parameter.unit if name.startswith("phase") else si_unit(parameter.unit, linear, kind)


def _declared(friction: str) -> dict[str, Parameter]:
    """Return the parameters of the servo, the law and all effects by name."""
    own = (J, A2, B, *find_law(friction).parameters, *(p for e in all_effects().values() for p in e.parameters))
    return {p.name: p for p in own}


# -- from the file to the model ------------------------------------------------------------------------------------------
def _model(table: ModelTable, where: Path | str) -> Model:
    known = laws()
    if table.friction not in known:
        message = f"unknown friction law{suggest(table.friction, list(known))}; choose one of: {', '.join(known)}"
        raise mistake(where, "friction", table.friction, message)
    law, kind = known[table.friction], table.input.kind
    linear = _linear(table, where)
    _check_columns(table, where)
    names = {p.name: p for p in (J, A2, *(() if kind in ("torque", "force") else (B,)), *law.parameters)}
    parameters = dict(_parameters(table, where, law, names, linear))
    _complete(parameters, names, where, kind)
    bounds = _bounds(table, where, law, names, parameters, linear)
    effects = {name: _effect(name, given, where, linear, kind) for name, given in table.effects.items()}
    if effects:
        try:
            servo(law, False, [find_effect(name) for name in effects])
        except BristleError as error:
            raise mistake(where, "effects", None, str(error)) from None
    resolution = _resolution(table.output, where, linear)
    return Model(
        table.friction,
        parameters,
        bounds,
        Column(table.time.column, table.time.unit),
        Column(table.input.column, table.input.unit, table.input.scale),
        kind,
        Column(table.output.column, table.output.unit, table.output.scale),
        table.output.kind,
        resolution,
        linear,
        effects,
        where if isinstance(where, Path) else None,
    )


def _output_unit(kind: str, linear: bool) -> str:
    return ("m" if linear else "rad") + ("/s" if kind == "velocity" else "")


def _linear(table: ModelTable, where: Path | str) -> bool:
    """Return whether the output is that of a linear axis, which a torque cannot drive and a force must."""
    out, fits, why = table.output, [], ""
    for linear in (False, True):
        try:
            factor_to(out.unit, out.scale, _output_unit(out.kind, linear))
            fits.append(linear)
        except BristleError as error:
            why = why or str(error)
    if not fits:
        speed = "/s" if out.kind == "velocity" else ""
        hint = why if "does not fit" not in why else f"does not fit kind '{out.kind}'; write rad{speed}, deg{speed}, m{speed} or " \
            f"mm{speed}, or add scale = \"... rad{speed}\" over that unit"  # fmt: skip
        raise mistake(where, "output.unit", out.unit, hint)
    linear = fits[0]
    if table.input.kind == ("torque" if linear else "force"):
        moved = "moves in metres" if linear else "turns"
        needed = "force" if linear else "torque"
        raise mistake(where, "input.kind", table.input.kind, f'the output {moved}; write "{needed}", or correct output.unit')
    return linear


def _check_columns(table: ModelTable, where: Path | str) -> None:
    for key, unit, scale, want in (
        ("time", table.time.unit, None, "s"),
        ("input", table.input.unit, table.input.scale, INPUT_UNITS[table.input.kind]),
    ):
        try:
            factor_to(unit, scale, want)
        except BristleError as error:
            raise mistake(where, f"{key}.unit", unit, str(error)) from None
    roles: dict[str, str] = {}
    for key, column in (("time", table.time.column), ("input", table.input.column), ("output", table.output.column)):
        if column in roles:
            message = f"is the column of [{roles[column]}] already; name the one that holds the {key}"
            raise mistake(where, f"{key}.column", column, message)
        roles[column] = key


def _resolution(out: OutputTable, where: Path | str, linear: bool) -> float | None:
    if out.resolution is None:
        return None
    want = _output_unit(out.kind, linear)
    try:
        text = isinstance(out.resolution, str)
        value = quantity(out.resolution, want) if text else float(out.resolution) * abs(factor_to(out.unit, out.scale, want))
    except BristleError as error:
        raise mistake(where, "output.resolution", out.resolution, str(error)) from None
    if not 0.0 < value < float("inf"):
        raise mistake(where, "output.resolution", out.resolution, "must be above 0; leave it out if it is not known")
    return value


def _flat(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Let `coulomb.Fc = ...` mean the same with and without quotes."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _full_name(key: str, name: str, value: object, where: Path | str, law: FrictionLaw, names: Mapping[str, Parameter]) -> str:
    """Return a parameter's name as the servo knows it: Fc becomes coulomb.Fc."""
    for full in (name, f"{law.name}.{name}"):
        if full in names:
            return full
    if name == "b":
        raise mistake(where, f"{key}.b", value, "a torque or force acts as it is; remove b, or give input.kind voltage or current")
    short = [full.removeprefix(f"{law.name}.") for full in names]
    raise mistake(
        where, f"{key}.{name}", value, f"no parameter of law '{law.name}'{suggest(name, short)}; there are: {', '.join(short)}"
    )


def _number(key: str, value: object, parameter: Parameter, where: Path | str, linear: bool, kind: str) -> float:
    """Return a value in SI, which a bare number is already, inside the parameter's interval."""
    unit = own_unit(parameter, linear, kind)
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise mistake(where, key, value, f'must be a number [{unit}] or text such as "1 {unit}"; change the value')
    try:
        number = _quantity(value, unit) if isinstance(value, str) else float(value)
    except BristleError as error:
        raise mistake(where, key, value, str(error)) from None
    if not parameter.minimum <= number <= parameter.maximum:
        message = f"outside [{parameter.minimum:g}, {parameter.maximum:g}] {unit}; choose a value in that interval"
        raise mistake(where, key, value, f"{message} ({parameter.description})")
    return number


def _quantity(text: str, unit: str) -> float:
    """Read a number with a unit; a parameter without a dimension needs none."""
    return quantity(text, "1" if parse_unit(unit).exponents == parse_unit("1").exponents else unit)


def _parameters(
    table: ModelTable, where: Path | str, law: FrictionLaw, names: Mapping[str, Parameter], linear: bool
) -> Iterator[tuple[str, float]]:
    seen = set()
    for name, value in _flat(table.parameters):
        full = _full_name("parameters", name, value, where, law, names)
        if full in seen:
            raise mistake(where, f"parameters.{name}", value, f"{full} is given twice; give it once")
        seen.add(full)
        yield full, _number(f"parameters.{name}", value, names[full], where, linear, table.input.kind)


def _complete(parameters: dict[str, float], names: Mapping[str, Parameter], where: Path | str, kind: str) -> None:
    """Refuse what is missing, but for parameters that are 0 unless somebody wants them (bristle damping, late weights)."""
    for name, parameter in names.items():
        if name not in parameters:
            if parameter.default != 0.0:
                why = f", which an input of kind '{kind}' needs" if name == "b" else ""
                raise mistake(where, f"parameters.{name}", None, f"missing; add it ({parameter.description}{why})")
            parameters[name] = 0.0


def _bounds(
    table: ModelTable,
    where: Path | str,
    law: FrictionLaw,
    names: Mapping[str, Parameter],
    parameters: Mapping[str, float],
    linear: bool,
) -> dict[str, tuple[float, float]]:
    if table.bounds is None:
        return default_bounds(law, parameters)
    found: dict[str, tuple[float, float]] = {}
    for name, value in _flat(table.bounds):
        full = _full_name("bounds", name, value, where, law, names)
        key = f"bounds.{name}"
        if not isinstance(value, (list, tuple)) or len(value) != 2:
            raise mistake(where, key, value, "must be two numbers, [lowest, highest]; leave it out if the parameter is to stay")
        if full in found:
            raise mistake(where, key, value, f"{full} is given twice; give it once")
        low, high = (_number(f"{key}[{k}]", each, names[full], where, linear, table.input.kind) for k, each in enumerate(value))
        if low >= high:
            raise mistake(where, key, list(value), "must rise; write [lowest, highest], or leave it out if the parameter stays")
        nominal = parameters[full]
        if not low <= nominal <= high:
            raise mistake(where, key, list(value), f"the nominal value {nominal:g} lies outside; widen the bounds or correct it")
        found[full] = (low, high)
    return found


def default_bounds(law: FrictionLaw, parameters: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return the bounds of a model that gives none.

    J, a2 and the levels of the law's friction (its parameters in N.m, or in 1/s2 where it is normalised) move by a factor
    of `BOUND_FACTOR` either way, down to 0 where 0 is allowed. What is nominally 0 has no scale to move on, and stays; so does
    b, because an input's gain and all other parameters share one factor.
    """
    levels = [p for p in law.parameters if p.unit in ("N.m", "1/s2")]
    found = {}
    for p in (J, A2, *levels):
        value = parameters[p.name]
        if value != 0.0:
            ends = sorted((0.0 if p.minimum == 0.0 else value / BOUND_FACTOR, value * BOUND_FACTOR))
            found[p.name] = (max(ends[0], p.minimum), min(ends[1], p.maximum))
    return found


def _effect(name: str, given: Mapping[str, Given], where: Path | str, linear: bool, kind: str) -> dict[str, float]:
    known = all_effects()
    if name not in known:
        message = f"unknown effect{suggest(name, list(known))}; choose one of: {', '.join(known)}"
        raise mistake(where, f"effects.{name}", None, message)
    own = {p.name.removeprefix(f"{name}."): p for p in known[name].parameters}
    values = {}
    for key, value in given.items():
        if key not in own:
            message = f"no parameter of effect '{name}'{suggest(key, list(own))}; there are: {', '.join(own)}"
            raise mistake(where, f"effects.{name}.{key}", value, message)
        values[key] = _number(f"effects.{name}.{key}", value, own[key], where, linear, kind)
    for key, parameter in own.items():
        if key not in values:
            if parameter.default != 0.0 and key not in known[name].shape_parameters:
                raise mistake(where, f"effects.{name}.{key}", None, f"missing; add it ({parameter.description})")
            values[key] = parameter.default
    return values


# -- and back ------------------------------------------------------------------------------------------------------------
def model_text(model: Model) -> str:
    """Return a model file that reads back as this model; numbers in full precision, units as comments."""
    short = {name: name.removeprefix(f"{model.friction}.") for name in model.parameters}
    lines = [f"friction = {_text(model.friction)}", "", "[parameters]"]
    lines += [f"{_key(short[name])} = {float(value)!r}  # {model.unit(name)}" for name, value in model.parameters.items()]
    lines += ["", "[bounds]"]
    lines += [f"{_key(short[name])} = [{float(low)!r}, {float(high)!r}]" for name, (low, high) in model.bounds.items()]
    lines += ["", "[time]", *_column(model.time)]
    lines += ["", "[input]", *_column(model.input), f"kind = {_text(model.input_kind)}"]
    lines += ["", "[output]", *_column(model.output), f"kind = {_text(model.output_kind)}"]
    if model.resolution is not None:
        lines.append(f'resolution = "{float(model.resolution)!r} {model.output_unit}"')
    for effect, values in model.effects.items():
        lines += ["", f"[effects.{effect}]"]
        lines += [f"{_key(name)} = {float(value)!r}  # {model.unit(f'{effect}.{name}')}" for name, value in values.items()]
    return "\n".join([*lines, ""])


def write_model(model: Model, path: Path | str) -> None:
    """Write a model file; a half-written one is never seen.

    Raises
    ------
    BristleError
        If the file cannot be written.
    """
    path = Path(path)
    try:
        handle, fresh = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(model_text(model))
            os.chmod(fresh, 0o644)  # mkstemp keeps others out
            os.replace(fresh, path)
        except BaseException:
            Path(fresh).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise BristleError(f"{path}: {error.strerror}; choose a folder you can write") from None


def _column(column: Column) -> list[str]:
    lines = [f"column = {_text(column.column)}", f"unit = {_text(column.unit)}"]
    return lines if column.scale is None else [*lines, f"scale = {_text(column.scale)}"]


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)


def _text(value: str) -> str:
    """Return a basic TOML string: quotes, backslashes and control characters escaped."""
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + re.sub(r"[\x00-\x1f\x7f]", lambda match: f"\\u{ord(match[0]):04x}", escaped) + '"'
