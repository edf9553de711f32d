"""Scenario files: TOML schema, overrides, and error lines that name file, key, value and what to
do.
"""

from __future__ import annotations

import math
import os
import re
import tomllib
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from bristle.common.errors import BristleError
from bristle.common.toml import InUnit, Section, first_mistake, mistake, read_toml, too_much
from bristle.common.units import quantity
from bristle.records.layout import Column, LayoutTable

LONGEST_RUN = 5_000_000  # steps of a run, all of which are kept in memory
PARAMETER_PARTS = ("plant", "controller", "observer")  # parts of a scenario that have parameters


def _seconds(given: object) -> float:
    value = _in_unit(given, "s", "20 s")
    if value <= 0:
        raise ValueError("must be longer than 0 s")
    return value


def _hertz(given: object) -> float:
    value = _in_unit(given, "Hz", "5 Hz")
    if value <= 0:
        raise ValueError("must be higher than 0 Hz")
    return value


def _radians(given: object) -> float:
    return _in_unit(given, "rad", "90 deg")


def _in_unit(given: object, unit: str, example: str) -> float:
    if not isinstance(given, (str, int, float)):
        raise ValueError(f'not a quantity; write a number with a unit such as "{example}"')
    return quantity(given, unit)


Seconds = Annotated[float, BeforeValidator(_seconds), InUnit("s")]
Hertz = Annotated[float, BeforeValidator(_hertz), InUnit("Hz")]
Radians = Annotated[float, BeforeValidator(_radians), InUnit("rad")]
Given = str | int | float | bool
Number = Annotated[float, Field(allow_inf_nan=False)]


class Part(Section):
    """An FMU on the bus: built by bristle, or a file."""

    fmu: str | None = None
    """Path of an FMU, relative to the scenario file, in place of one that is built."""
    variables: dict[str, str | dict[str, str | float]] = Field(default={})
    """Names of the FMU's variables where they are not those of the bus, by these: `u = "voltage"`,
    or `u = { name = "voltage", unit = "mV", scale = 1.0 }` with its unit and what one of its number
    is worth in that."""
    parameters: dict[str, Given] = Field(default={})
    """Start values by the names of the FMU's parameters, as text with a unit ("0.001 kg.m2");
    numbers alone where the unit is 1.
    """


class Plant(Part):
    """The servo: a friction law of bristle, or an FMU with inputs u (tau_load, load_scale) and
    outputs theta, v.
    """

    law: str | None = None
    """Friction law of the plant that is built."""
    effects: list[str] = Field(default=[])
    """Effects that the plant has beside its law; their parameters are among `parameters`, such as
    `cogging.amplitude`.
    """


class Controller(Part):
    """The reference generator and PI controller: input y_v, outputs u, reference."""

    compensation: Literal["none", "valid", "adapted"] = "none"
    """Which estimates the controller gets, to compensate friction and inertia: those that are
    valid, or all, on trial, once adapted. The same run without them is compared."""


class Observer(Part):
    """The adaptive observer: a method of bristle, or an FMU with inputs u, y_theta, y_v and outputs
    P_hat, P_valid.
    """

    method: str | None = None
    """Method of the observer that is built."""


class Sine(Section):
    """A sine over the whole run, held constant over each step."""

    amplitude: Given
    """Its amplitude, with the unit of the input."""
    frequency: Hertz
    """Its frequency, below half the rate of the steps."""
    phase: Radians = 0.0
    """Its phase at the start of the run."""


class Noise(Section):
    """Coloured noise over the whole run: white noise behind a low-pass of first order, held
    constant over each step.
    """

    rms: Given
    """Its rms, with the unit of the input."""
    bandwidth: Hertz
    """Frequency at which its spectrum has fallen to half, below half the rate of the steps."""
    seed: int = Field(default=1, ge=0)
    """Chooses the noise; the seed of the controller does not change it."""


class Stimulus(Section):
    """An input over time: steps at points in time, and what is added to them; one of u takes the
    place of the controller.
    """

    variable: str
    """Input of the plant (u, tau_load, load_scale) or of the controller (u_ff, reference_scale)."""
    points: list[tuple[Given, Given]] = Field(default=[], min_length=1)
    """Pairs [time, value]: from this time on the input has this value; before the first it is 1
    (the scales) or 0.
    """
    sine: Sine | None = None
    """A sine that is added."""
    noise: Noise | None = None
    """Coloured noise that is added."""

    @model_validator(mode="after")
    def _something(self) -> Stimulus:
        if not self.points and self.sine is None and self.noise is None:
            raise ValueError("nothing to apply; give points, sine or noise")
        return self


class Record(LayoutTable):
    """A measured file in place of plant and controller."""

    file: str
    """Path of the file (CSV, XLSX, MAT, NPZ, Parquet and others), relative to the scenario file."""
    velocity: Column | None = None
    """Column of a velocity that was measured besides the position; without it, the position is
    differentiated.
    """


class Validation(Section):
    """A second run of the same plant and controller, on which open-loop models are compared."""

    seed: int = Field(default=2, ge=1)
    """Seed of the reference signal of the second run; it must differ from that of the first."""
    duration: Seconds = 100.0
    """Length of the second run."""
    baselines: bool = True
    """Whether fitted viscous and Coulomb models, and the best fit of the identified law, are
    compared as well.
    """


class Check(Section):
    """A demand on a number of result.json."""

    quantity: str
    """Dotted path of a number of result.json; the table of check quantities lists them."""
    name: str | None = None
    """Name of the check in the report; otherwise the path."""
    min: Number | None = None
    """The number must be at least this."""
    max: Number | None = None
    """The number must be at most this."""
    max_abs: Number | None = None
    """The absolute value of the number must be at most this."""

    @model_validator(mode="after")
    def _limited(self) -> Check:
        if self.min is None and self.max is None and self.max_abs is None:
            raise ValueError("no limit; give min, max or max_abs")
        low = max(
            -math.inf if self.min is None else self.min,
            -math.inf if self.max_abs is None else -self.max_abs,
        )
        high = min(
            math.inf if self.max is None else self.max,
            math.inf if self.max_abs is None else self.max_abs,
        )
        if low > high:
            raise ValueError(
                f"no number is at least {low:g} and at most {high:g}; correct the limits"
            )
        return self


class Scenario(Section):
    """A scenario file, checked as far as it can be without looking at the FMUs."""

    name: str = ""
    """Name of the scenario, for readers; results are named by the file."""
    title: str = ""
    """Headline of the report."""
    shows: str = ""
    """What the scenario shows, for the report."""
    source: str = ""
    """Where plant and method come from, for the report."""
    limits: str = ""
    """What the scenario does not show, for the report."""
    duration: Seconds | None = None
    """Length of the run; required with [plant]."""
    step: Seconds = 1e-3
    """Communication step: the interval at which all FMUs exchange values. The duration is a whole
    number of steps.
    """
    plant: Plant | None = None
    """The servo; required unless [record] is given."""
    controller: Controller = Controller()
    """Reference generator and PI controller; our own where the table is left out."""
    observer: Observer
    """The adaptive observer under test."""
    sensor: Literal["clean", "encoder"] = "clean"
    """What the observer reads: exact position and velocity, or counts of an encoder and their
    differences.
    """
    controller_sensor: Literal["clean", "encoder"] = "clean"
    """What the controller reads."""
    stimuli: list[Stimulus] = Field(default=[])
    """Inputs of plant and controller that change at given times."""
    record: Record | None = Field(default=None, validate_default=True)
    """A measured file in place of plant and controller."""
    validation: Validation | None = None
    """A second run, on which the identified model is compared with others."""
    checks: list[Check] = Field(default=[], validate_default=True)
    """The verdict: the scenario passes if all of them hold. Required with [plant]; a [record]
    without any passes if the observer itself says that its estimates of alpha2 and b hold."""

    @field_validator("checks", mode="before")
    @classmethod
    def _some_checks(cls, given: object, info: ValidationInfo) -> object:
        if given == [] and not (info.context or {}).get("record"):
            raise PydanticCustomError("missing", "missing", {"keys": "checks"})
        return given

    @field_validator("record")
    @classmethod
    def _something_to_run_on(cls, record: Record | None, info: ValidationInfo) -> Record | None:
        if record is None and info.data.get("plant", ...) is None:
            raise PydanticCustomError("missing", "missing", {"keys": "plant or record"})
        return record

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        if self.plant and self.record:
            raise ValueError("give either [plant] or [record], not both")
        if self.record and (
            self.stimuli or self.validation or "controller" in self.model_fields_set
        ):
            raise ValueError(
                "[record] replaces plant and controller; remove [controller], [[stimuli]] and"
                " [validation]"
            )
        if self.record and {"sensor", "controller_sensor"} & self.model_fields_set:
            raise ValueError(
                "[record] is what a sensor showed; remove sensor and controller_sensor"
            )
        if self.open_loop and (self.validation or "controller" in self.model_fields_set):
            raise ValueError(
                "a stimulus of u replaces the controller; remove [controller] and [validation]"
            )
        if self.plant and self.duration is None:
            raise ValueError('duration is missing; write for example duration = "20 s"')
        for key, part, choice in (
            ("plant", self.plant, "law"),
            ("observer", self.observer, "method"),
        ):
            if part is not None and (part.fmu is None) == (getattr(part, choice) is None):
                raise ValueError(
                    f"[{key}] needs either {choice} or fmu"
                    + ("; both are given" if part.fmu else "; none is given")
                )
        if self.plant is not None and self.plant.fmu is not None and self.plant.effects:
            raise ValueError("[plant] effects join a law, and fmu is given; remove one of them")
        for key, duration in (
            ("duration", self.duration),
            ("validation.duration", self.validation and self.validation.duration),
        ):
            if duration:
                _steps(key, duration, self.step)
        return self

    @property
    def steps(self) -> int:
        """Number of communication steps."""
        return round((self.duration or 0.0) / self.step)

    @property
    def open_loop(self) -> bool:
        """Whether a stimulus drives the plant, in the place of the controller."""
        return any(stimulus.variable == "u" for stimulus in self.stimuli)


def _steps(key: str, duration: float, step: float) -> None:
    count = duration / step
    if count < 1 or abs(count - round(count)) > 1e-6 * count:
        raise ValueError(
            f"{key} = {duration:g} s is not a whole number of steps of {step:g} s; change one of"
            " them"
        )
    if count > LONGEST_RUN:
        raise ValueError(
            f"{key} = {duration:g} s is {count:.0f} steps; allowed are {LONGEST_RUN}: shorten it or"
            " lengthen step"
        )


# -- reading ---------------------------------------------------------------------------------------


class Loaded:
    """A scenario with where it came from."""

    def __init__(
        self,
        path: Path,
        text: str,
        scenario: Scenario,
        overrides: Sequence[str],
        notes: Sequence[str] = (),
    ) -> None:
        self.path, self.text, self.scenario, self.overrides, self.notes = (
            path,
            text,
            scenario,
            list(overrides),
            list(notes),
        )

    @property
    def name(self) -> str:
        """The file's stem."""
        return self.path.stem

    def beside(self, file: str) -> Path:
        """Return a path as written in the file, which is relative to the file."""
        return Path(os.path.realpath(self.path.parent / Path(file).expanduser()))

    def error(self, key: str, value: object, message: str) -> BristleError:
        """Return the one-line error for a key of this file."""
        return mistake(self.path, key, value, message)


def load(path: Path, overrides: Sequence[str] = (), seed: int | None = None) -> Loaded:
    """Read and check a scenario file.

    Parameters
    ----------
    path : Path
        The TOML file.
    overrides : sequence of str
        ``path=value`` as text.
    seed : int, optional
        Seed of the controller's reference.

    Raises
    ------
    BristleError
        One line that names file, key, value and what is allowed.
    """
    text, tree = read_toml(path, "scenario file")
    return parse(path, text, tree, overrides, seed)


def parse(
    path: Path,
    text: str,
    tree: dict[str, Any],
    overrides: Sequence[str] = (),
    seed: int | None = None,
) -> Loaded:
    """Check a scenario file that has been read: its text, and its tree, which is changed; the rest
    as of `load`.
    """
    if "friction" in tree and "output" in tree:
        raise BristleError(
            f"{path}: is a model file, no scenario file; give it to bristle diagnose, with records"
        )
    for part in PARAMETER_PARTS:
        _flatten_parameters(tree, part)
    for override in overrides:
        _override(tree, override)
    if seed is not None:
        if "record" in tree:
            raise BristleError(
                f"{path}: seed {seed}: a [record] has no reference to seed; leave the seed out"
            )
        tree.setdefault("controller", {}).setdefault("parameters", {})["seed"] = seed
    notes = _new_record_keys(path, tree)
    try:
        scenario = Scenario.model_validate(tree, context={"record": "record" in tree})
    except ValidationError as error:
        raise first_mistake(path, Scenario, error) from None
    given = [*overrides, *([f"controller.parameters.seed={seed}"] if seed is not None else [])]
    return Loaded(path, text, scenario, given, notes)


OLD_RECORD_KEYS = ("u", "theta", "v")  # of [record], before it had the tables of a model file


def _new_record_keys(path: Path, tree: dict[str, Any]) -> list[str]:
    """Replace the deprecated keys of [record] by [record.input], [record.output] and
    [record.velocity]; say so, also as warning.
    """
    section = tree.get("record")
    old = [key for key in OLD_RECORD_KEYS if isinstance(section, dict) and key in section]
    if not isinstance(section, dict) or not old:
        return []
    kinds = {
        "u": ("input", "voltage"),
        "theta": ("output", "position"),
        "v": ("output", "velocity"),
    }
    new, written = {key: value for key, value in section.items() if key not in old}, []
    for key in old:
        name, kind = kinds[key]
        if key == "v" and "theta" in old:
            name, kind = "velocity", ""
        if name in section:
            raise mistake(
                path,
                f"record.{key}",
                None,
                f"is the deprecated name of [record.{name}], which is given as well; remove it",
            )
        given = section[key]
        new[name] = {**given, "kind": kind} if kind and isinstance(given, dict) else given
        written.append(f"{key} as [record.{name}]" + (f' with kind = "{kind}"' if kind else ""))
    tree["record"] = new
    line = f"{path}: record: the keys {', '.join(old)} are deprecated; write {', '.join(written)}"
    warnings.warn(line, FutureWarning, stacklevel=2)
    return [line]


def _flatten_parameters(tree: dict[str, Any], part: str) -> None:
    """Let `modified.sigma0 = ...` mean the same with and without quotes."""
    section = tree.get(part)
    if not isinstance(section, dict) or not isinstance(section.get("parameters"), dict):
        return
    flat: dict[str, Any] = {}

    def walk(prefix: str, node: Mapping[str, Any]) -> None:
        for key, value in node.items():
            if isinstance(value, dict):
                walk(f"{prefix}{key}.", value)
            else:
                flat[f"{prefix}{key}"] = value

    walk("", section["parameters"])
    section["parameters"] = flat


def _parse(text: str) -> Any:
    """Read an override's value as TOML where it is TOML, else as a plain string."""
    try:
        return tomllib.loads(f"x = {text}")["x"]
    except tomllib.TOMLDecodeError:
        return text
    except (ValueError, RecursionError) as error:
        raise BristleError(f"override '{text}': {too_much(error)}") from None


def keys_of(path: str) -> list[str]:
    """Return the keys of a dotted path, of which one that has a dot itself is in quotes."""
    return [quoted or bare for quoted, bare in re.findall(r'"([^"]*)"|([^."]+)', path.strip())]


def _override(tree: dict[str, Any], override: str) -> None:
    """Apply one ``path=value``; behind ``plant.parameters.`` everything is one structured name."""
    path, separator, text = override.partition("=")
    keys = keys_of(path)
    if not separator or not keys:
        raise BristleError(
            f"override '{override}': not path=value; write for example plant.parameters.J=0.002"
            " kg.m2"
        )
    if len(keys) > 2 and keys[0] in PARAMETER_PARTS and keys[1] == "parameters":
        keys = [*keys[:2], ".".join(keys[2:])]
    node: Any = tree
    for depth, key in enumerate(keys):
        last = depth == len(keys) - 1
        if isinstance(node, list):
            if not key.isdigit() or int(key) >= len(node):
                raise BristleError(
                    f"override '{override}': '{key}' is no index of a list of {len(node)}; count"
                    " from 0"
                )
            if last:
                node[int(key)] = _parse(text.strip())
            node = node[int(key)]
        elif isinstance(node, dict):
            if last:
                node[key] = _parse(text.strip())
            node = node.setdefault(key, {})
        else:
            raise BristleError(
                f"override '{override}': '{'.'.join(keys[:depth])}' is a value, not a table;"
                " shorten the path"
            )
