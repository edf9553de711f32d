"""The model file of a diagnosis: friction law, parameters, bounds, and the columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from bristle.common.arguments import as_path
from bristle.common.errors import BristleError, suggest
from bristle.common.toml import first_mistake, mistake, quoted, read_toml
from bristle.common.units import interval, parse_unit, quantity
from bristle.model.variables import Parameter
from bristle.plant.controller import CONTROLLER
from bristle.plant.effect import Effect
from bristle.plant.effects import BESIDE, owners_of_inputs
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects
from bristle.plant.friction import law as find_law
from bristle.plant.friction import law_names
from bristle.plant.known import KNOWN
from bristle.plant.law import FrictionLaw
from bristle.plant.servo import A2, B, J, servo
from bristle.plant.wording import Wording
from bristle.records.formats.reading import READERS
from bristle.records.layout import (
    INPUT_UNITS,
    SETPOINT,
    KnownTable,
    Layout,
    LayoutTable,
    layout_lines,
    layout_of,
)

Given = str | int | float | bool
BOUND_FACTOR = 5.0  # a parameter without bounds may move by this factor either way
NO_LIMIT = 1e6  # u_max: the measured input is what arrived, so the model must not clip it


# -- what a file may hold --------------------------------------------------------------------------
class ModelTable(LayoutTable):
    """A model file, checked as far as it can be without looking at the friction law."""

    friction: str
    """Friction law of the model."""
    parameters: dict[str, Any]
    """Nominal value of each parameter: `J`, `a2`, those of the law and, for a voltage or current,
    `b`.
    """
    bounds: dict[str, Any] | None = None
    """[least, greatest] of each parameter that may change; the others stay. Without it inertia,
    viscous friction and the levels of dry friction may change by a factor of 5 either way."""
    effects: dict[str, dict[str, Given]] = Field(default={})
    """Effects that the model has already, each a table `[effects.NAME]` of its parameters."""
    controller: dict[str, Given] | None = None
    """What is known of the controller that follows a `setpoint`: `kp`, `ki`, `kd`, `limit` and
    more; what is missing is estimated."""
    known: KnownTable | None = None
    """Columns of what is known at each sample: a `torque` against the motor, and the `inertia` or
    an `inertia_factor` on J, of the rest of an arm, say."""
    variables: dict[str, str | dict[str, str | float]] = Field(default={})
    """Names of a plant FMU's variables where they are not u, theta and v, by these: `u =
    "voltage"`, or `u = { name = "voltage", unit = "mV", scale = 1.0 }` with its unit and what one
    of its number is worth in that."""


# -- the model -------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Model(Layout):
    """A model of the servo that was measured, and the layout of its records.

    All numbers are in SI, all names those of `bristle.plant.servo`. A torque or a force as input
    acts with b = 1.

    Attributes
    ----------
    friction : str
        The friction law.
    parameters : dict of str to float
        Nominal values of J, a2, b (voltage and current only) and the law's own (``coulomb.Fc``).
    bounds : dict of str to (float, float)
        Which of these may move, and how far; the others stay.
    effects : dict of str to dict
        Effects that the model has already: values of their parameters, without the effect's name
        before them.
    variables : dict of str to str or dict
        How a plant FMU calls u, theta and v, where it does otherwise, as `bristle.fmus.alias.alias`
        takes it.
    path : Path or None
        The file it came from.
    """

    friction: str
    parameters: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    variables: dict[str, str | dict[str, str | float]] = field(default_factory=dict)
    path: Path | None = None

    @property
    def wording(self) -> Wording:
        """Words for its axis and its input."""
        return Wording(self.linear, self.drive)

    @property
    def values(self) -> dict[str, float]:
        """Nominal values of all parameters, those of the effects that it has already included
        (``gravity.amplitude``).
        """
        return {
            **self.parameters,
            **{f"{e}.{p}": x for e, values in self.effects.items() for p, x in values.items()},
        }

    @property
    def controller(self) -> dict[str, float] | None:
        """What is known of the controller that follows a setpoint; None for another input."""
        return self.effects.get(CONTROLLER.name)

    def unit(self, name: str) -> str:
        """Return the SI unit of a parameter of servo, law or effect (``cogging.amplitude``)."""
        return own_unit(_declared(self.friction)[name], self.linear, self.drive)

    def unit_in_fmu(self, name: str, unit: str) -> str:
        """Return the unit of a variable of a plant FMU, by its name and its unit in ServoPlant."""
        if name == "u":
            return self.input_unit
        return unit_on(name, unit, self.linear, self.drive)

    def allowed(self, name: str) -> tuple[float, float]:
        """Return the least and the greatest value that such a parameter may have, SI."""
        declared = _declared(self.friction)[name]
        return declared.minimum, declared.maximum

    def settings(self, parameters: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return what a servo of this law and these effects is set to: `parameters` in place of the
        nominal ones.

        The input is never clipped (u_max), and b is 1 where the input is a torque or a force.
        """
        return {"u_max": NO_LIMIT, "b": 1.0, **self.values, **(parameters or {})}

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any], where: Path | str = "model") -> Model:
        """Return the model that a tree such as a model file's describes; `BristleError`, one line,
        begins with `where`.
        """
        if not isinstance(tree, Mapping):
            raise BristleError(
                f"{where}: is a {type(tree).__name__}; give a dict such as tomllib.load returns, or"
                " use load_model"
            )
        try:
            table = ModelTable.model_validate(dict(tree))
        except ValidationError as error:
            raise first_mistake(where, ModelTable, error) from None
        return _model(table, where)


def must_be_model(model: object) -> None:
    """Raise `BristleError` where something else is given for a model, its path say."""
    if not isinstance(model, Model):
        raise BristleError(
            f"the model is a {type(model).__name__}; give what load_model or Model.from_dict"
            " returns"
        )


def load_model(path: Path | str) -> Model:
    """Read and check a model file.

    Parameters
    ----------
    path : path
        TOML file with the friction law, parameters, bounds and columns of the records.

    Raises
    ------
    BristleError
        One line that names file, key, value and what is allowed.
    """
    path = as_path("model", path)
    if path.suffix.lower() in READERS:
        raise BristleError(
            f"{path}: is a file of records, not a model file; the model (TOML) comes first, then"
            " the records"
        )
    _, tree = read_toml(path, "model file")
    if "observer" in tree:
        raise BristleError(f"{path}: is a scenario file, no model file; give it to bristle run")
    return Model.from_dict(tree, path)


def si_unit(unit: str, linear: bool, kind: str) -> str:
    """Return a declared unit as it is for a linear axis (kg for kg.m2, m for rad) and for an input
    that is no voltage.
    """
    if linear:
        unit = re.sub(r"kg\.m2", "kg", unit)
        unit = re.sub(r"N\.m(?![A-Za-z0-9])", "N", unit)
        unit = re.sub(r"(?<![A-Za-z])rad", "m", unit)
    unit = re.sub(r"(?<![A-Za-z])V(?![A-Za-z])", INPUT_UNITS[kind], unit)
    # as of the gain of an input that is a torque
    return "1" if not any(parse_unit(unit).exponents) else unit


def own_unit(parameter: Parameter, linear: bool, kind: str) -> str:
    """Return the unit of a parameter on such a rig; the phase of a wave is always an angle."""
    return unit_on(parameter.name, parameter.unit, linear, kind)


def unit_on(full_name: str, unit: str, linear: bool, kind: str) -> str:
    """Return the unit of a variable of the servo on such a rig, from its name and its unit on a
    shaft driven by a voltage.
    """
    name = full_name.rpartition(".")[2]
    if linear and name in {e.periods for e in all_effects().values()}:
        return "rad/m"
    return unit if name.startswith("phase") else si_unit(unit, linear, kind)


def _may_have() -> dict[str, Effect]:
    """Return what a model may have, by name: the effects, and the unnamed torques."""
    return {**all_effects(), **BESIDE}


def _declared(friction: str) -> dict[str, Parameter]:
    """Return the parameters of the servo, the law and all effects by name."""
    own = (
        J,
        A2,
        B,
        *find_law(friction).parameters,
        *(p for e in _may_have().values() for p in e.parameters),
    )
    return {p.name: p for p in own}


# -- from the file to the model --------------------------------------------------------------------
@dataclass(frozen=True)
class _File:
    """What the numbers of a model file are checked against: the friction law, the parameters it may
    name, the rig.
    """

    where: Path | str
    law: FrictionLaw
    names: Mapping[str, Parameter]
    layout: Layout

    def mistake(self, key: str, value: object, message: str) -> BristleError:
        return mistake(self.where, key, value, message)

    def full_name(self, key: str, name: str, value: object) -> str:
        """Return a parameter's full name in the servo: Fc becomes coulomb.Fc."""
        for full in (name, f"{self.law.name}.{name}"):
            if full in self.names:
                return full
        if name == "b":
            message = (
                "only an input of kind voltage or current has a gain; remove b, or correct"
                " input.kind"
            )
            raise self.mistake(f"{key}.b", value, message)
        short = [full.removeprefix(f"{self.law.name}.") for full in self.names]
        message = (
            f"no parameter of law '{self.law.name}'{suggest(name, short)}; there are:"
            f" {', '.join(short)}"
        )
        raise self.mistake(f"{key}.{name}", value, message)

    def number(self, key: str, value: object, parameter: Parameter) -> float:
        """Return a value in SI, which a bare number is already, inside the parameter's interval."""
        unit = own_unit(parameter, self.layout.linear, self.layout.drive)
        if isinstance(value, bool) or not isinstance(value, (str, int, float)):
            raise self.mistake(
                key,
                value,
                f'must be a number [{unit}] or text such as "1 {unit}"; change the value',
            )
        try:
            number = _quantity(value, unit) if isinstance(value, str) else float(value)
        except BristleError as error:
            raise self.mistake(key, value, str(error)) from None
        if not parameter.minimum <= number <= parameter.maximum:
            message = (
                f"outside {interval(parameter.minimum, parameter.maximum, unit)}; choose a value in"
                " that interval"
            )
            about = Wording(self.layout.linear).fill(parameter.description)
            raise self.mistake(key, value, f"{message} ({about})")
        return number


def _model(table: ModelTable, where: Path | str) -> Model:
    known = law_names()
    if table.friction not in known:
        message = (
            f"unknown friction law{suggest(table.friction, known)}; choose one of:"
            f" {', '.join(known)}"
        )
        raise mistake(where, "friction", table.friction, message)
    # parameters and bounds, by the names that the law declares
    law, layout = find_law(table.friction), layout_of(table, where, known=table.known)
    gain = () if layout.drive in ("torque", "force") else (B,)
    file = _File(where, law, {p.name: p for p in (J, A2, *gain, *law.parameters)}, layout)
    parameters = _parameters(file, table.parameters)
    controller = _controller(file, table.controller)
    bounds = (
        default_bounds(law, parameters)
        if table.bounds is None
        else _bounds(file, table.bounds, parameters, controller)
    )
    # effects that exclude each other, or the law, are refused here
    effects = {name: _effect(file, name, given) for name, given in table.effects.items()}
    effects |= {} if controller is None else {CONTROLLER.name: controller}
    effects = _with_known(file, effects)
    if effects:
        try:
            servo(law, False, [find_effect(name) for name in effects])
        except BristleError as error:
            raise mistake(where, "effects", None, str(error)) from None
    path = where if isinstance(where, Path) else None
    return Model(
        friction=table.friction,
        parameters=parameters,
        bounds=bounds,
        effects=effects,
        variables=table.variables,
        path=path,
        **vars(layout),
    )


def _with_known(
    file: _File, effects: Mapping[str, dict[str, float]]
) -> dict[str, dict[str, float]]:
    """Return the effects with the one of [known], if it has columns for it; refuse those that lack
    a column.
    """
    found = dict(effects)
    owners = owners_of_inputs()
    acting = {owners.get(key, KNOWN.name) for key in file.layout.known}
    if KNOWN.name in acting:
        found[KNOWN.name] = {"scale": 1.0, **found.get(KNOWN.name, {})}
    for name in found:
        if (own := _may_have()[name].inputs) and name not in acting:
            tables = " or ".join(f"[known.{each.name}]" for each in own)
            raise file.mistake(f"effects.{name}", None, f"lacks a column; add {tables}")
    return found


def _flat(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Let `coulomb.Fc = ...` mean the same with and without quotes."""
    for key, value in tree.items():
        if isinstance(value, dict) and value:
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _quantity(text: str, unit: str) -> float:
    """Read a number with a unit; a parameter without a dimension needs none."""
    return quantity(text, "1" if parse_unit(unit).exponents == parse_unit("1").exponents else unit)


def _parameters(file: _File, given: Mapping[str, Any]) -> dict[str, float]:
    """Return all nominal values; what is missing is refused, unless optional or 0 by default."""
    parameters: dict[str, float] = {}
    for name, value in _flat(given):
        full = file.full_name("parameters", name, value)
        if full in parameters:
            raise file.mistake(f"parameters.{name}", value, f"{full} is given twice; give it once")
        parameters[full] = file.number(f"parameters.{name}", value, file.names[full])
    for name, parameter in file.names.items():
        if name not in parameters:
            if parameter.default != 0.0 and not parameter.optional:
                why = (
                    f", which an input of kind '{file.layout.input_kind}' needs"
                    if name == "b"
                    else ""
                )
                raise file.mistake(
                    f"parameters.{name}", None, f"missing; add it ({parameter.description}{why})"
                )
            parameters[name] = parameter.default
    return parameters


def _controller(file: _File, given: Mapping[str, Given] | None) -> dict[str, float] | None:
    """Return what is known of the controller; None where the input is no setpoint."""
    if file.layout.input_kind != SETPOINT:
        if given is None:
            return None
        said = 'only a setpoint has a controller; remove it, or write kind = "setpoint"'
        raise file.mistake(CONTROLLER.name, None, said)
    if file.layout.output_kind != "position":
        said = f"'{file.layout.output_kind}' has no setpoint; give the column of the position"
        raise file.mistake("output.kind", file.layout.output_kind, said)
    own = {p.name.removeprefix(f"{CONTROLLER.name}."): p for p in CONTROLLER.parameters}
    for key, value in (given or {}).items():
        if key not in own:
            said = f"no parameter of a controller{suggest(key, list(own))}; there are:"
            raise file.mistake(f"controller.{key}", value, f"{said} {', '.join(own)}")
    return {
        key: file.number(f"controller.{key}", value, own[key])
        for key, value in (given or {}).items()
    }


def _bounds(
    file: _File,
    given: Mapping[str, Any],
    parameters: Mapping[str, float],
    controller: Mapping[str, float] | None,
) -> dict[str, tuple[float, float]]:
    if controller is not None:
        names = {p.name: p for p in CONTROLLER.parameters}
        file = replace(file, names={**file.names, **names})
        parameters = {**parameters, **{f"{CONTROLLER.name}.{k}": x for k, x in controller.items()}}
    bounds: dict[str, tuple[float, float]] = {}
    for name, value in _flat(given):
        full, key = file.full_name("bounds", name, value), f"bounds.{name}"
        if not isinstance(value, (list, tuple)) or len(value) != 2:
            raise file.mistake(
                key,
                value,
                "must be two numbers, [lowest, highest]; leave it out to keep the parameter fixed",
            )
        if full in bounds:
            raise file.mistake(key, value, f"{full} is given twice; give it once")
        low, high = (
            file.number(f"{key}[{k}]", each, file.names[full]) for k, each in enumerate(value)
        )
        if low >= high:
            raise file.mistake(
                key,
                list(value),
                "must rise; write [lowest, highest], or leave it out to keep the parameter fixed",
            )
        nominal = parameters.get(full, low)
        if not low <= nominal <= high:
            raise file.mistake(
                key,
                list(value),
                f"the nominal value {nominal:g} lies outside; widen the bounds or correct it",
            )
        bounds[full] = (low, high)
    return bounds


def default_bounds(
    law: FrictionLaw, parameters: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Return the bounds of a model that gives none.

    J, a2 and the levels of the law's friction (its parameters in N.m, or in 1/s2 where it is
    normalised) move by a factor of `BOUND_FACTOR` either way, down to 0 where 0 is allowed. What is
    nominally 0 has no scale to move on, and stays; so does b, because an input's gain and all other
    parameters share one factor.
    """
    frictions = [p for p in law.parameters if p.unit in ("N.m", "1/s2")]
    bounds = {}
    for p in (J, A2, *frictions):
        value = parameters[p.name]
        if value != 0.0:
            ends = sorted((0.0 if p.minimum == 0.0 else value / BOUND_FACTOR, value * BOUND_FACTOR))
            bounds[p.name] = (max(ends[0], p.minimum), min(ends[1], p.maximum))
    return bounds


def _effect(file: _File, name: str, given: Mapping[str, Given]) -> dict[str, float]:
    known = _may_have()
    if name not in known:
        message = f"unknown effect{suggest(name, list(known))}; choose one of: {', '.join(known)}"
        raise file.mistake(f"effects.{name}", None, message)
    own = {p.name.removeprefix(f"{name}."): p for p in known[name].parameters}
    values = {}
    for key, value in given.items():
        if key not in own:
            message = (
                f"no parameter of effect '{name}'{suggest(key, list(own))}; there are:"
                f" {', '.join(own)}"
            )
            raise file.mistake(f"effects.{name}.{key}", value, message)
        values[key] = file.number(f"effects.{name}.{key}", value, own[key])
    for key, parameter in own.items():
        if key not in values:
            if parameter.default != 0.0 and key not in known[name].optional_parameters:
                raise file.mistake(
                    f"effects.{name}.{key}", None, f"missing; add it ({parameter.description})"
                )
            values[key] = parameter.default
    return values


# -- and back --------------------------------------------------------------------------------------
def model_text(model: Model) -> str:
    """Return a model file that reads back as this model; full precision, units as comments."""
    short = {name: name.removeprefix(f"{model.friction}.") for name in model.parameters}
    lines = [f"friction = {quoted(model.friction)}", "", "[parameters]"]
    lines += [
        f"{_key(short[name])} = {float(value)!r}  # {model.unit(name)}"
        for name, value in model.parameters.items()
    ]
    lines += ["", "[bounds]"]
    lines += [
        f"{_key(short.get(name, name))} = [{float(low)!r}, {float(high)!r}]"
        for name, (low, high) in model.bounds.items()
    ]
    lines += ["", *layout_lines(model)]
    for effect, values in model.effects.items():
        lines += ["", f"[{effect}]" if effect == CONTROLLER.name else f"[effects.{effect}]"]
        lines += [
            f"{_key(name)} = {float(value)!r}  # {model.unit(f'{effect}.{name}')}"
            for name, value in values.items()
        ]
    return "\n".join([*lines, ""])


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else quoted(name)
