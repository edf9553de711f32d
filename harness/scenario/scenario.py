"""Scenario files: TOML schema, overrides, errors that name file, key, value and what to do."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import (
    BeforeValidator,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from bristle.common.toml import InUnit, Section
from bristle.common.units import quantity
from bristle.records.layout import Column, LayoutTable

LONGEST_RUN = 5_000_000  # steps of a run, all of which are kept in memory


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


class PartTable(Section):
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


class Plant(PartTable):
    """The servo: a friction law of bristle, or an FMU with inputs u (tau_load, load_scale) and
    outputs theta, v.
    """

    law: str | None = None
    """Friction law of the plant that is built."""
    effects: list[str] = Field(default=[])
    """Effects that the plant has beside its law; their parameters are among `parameters`, such as
    `cogging.amplitude`.
    """


class Controller(PartTable):
    """The reference generator and PI controller: input y_v, outputs u, reference."""

    compensation: Literal["none", "valid", "adapted"] = "none"
    """Which estimates the controller gets, to compensate friction and inertia: those that are
    valid, or all, on trial, once adapted. The same run without them is compared."""


class Observer(PartTable):
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


class NoiseTable(Section):
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
    noise: NoiseTable | None = None
    """Coloured noise that is added."""

    @model_validator(mode="after")
    def _something(self) -> Stimulus:
        if not self.points and self.sine is None and self.noise is None:
            raise ValueError("nothing to apply; give points, sine or noise")
        return self


class RecordTable(LayoutTable):
    """A measured file in place of plant and controller."""

    file: str
    """Path of the file (CSV, XLSX, MAT, NPZ, Parquet and others), relative to the scenario file."""
    velocity: Column | None = None
    """Column of a velocity that was measured besides the position; without it, the position is
    differentiated.
    """


class ValidationTable(Section):
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
    record: RecordTable | None = Field(default=None, validate_default=True)
    """A measured file in place of plant and controller."""
    validation: ValidationTable | None = None
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
    def _something_to_run_on(
        cls, record: RecordTable | None, info: ValidationInfo
    ) -> RecordTable | None:
        if record is None and info.data.get("plant", ...) is None:
            raise PydanticCustomError("missing", "missing", {"keys": "plant or record"})
        return record

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        self._check_record()
        if self.open_loop and (self.validation or "controller" in self.model_fields_set):
            raise ValueError(
                "a stimulus of u replaces the controller; remove [controller] and [validation]"
            )
        if self.plant and self.duration is None:
            raise ValueError('duration is missing; write for example duration = "20 s"')
        self._check_choices()
        self._check_lengths()
        return self

    def _check_record(self) -> None:
        """Refuse what a record takes the place of."""
        if not self.record:
            return
        if self.plant:
            raise ValueError("give either [plant] or [record], not both")
        if self.stimuli or self.validation or "controller" in self.model_fields_set:
            raise ValueError(
                "[record] replaces plant and controller; remove [controller], [[stimuli]] and"
                " [validation]"
            )
        if {"sensor", "controller_sensor"} & self.model_fields_set:
            raise ValueError(
                "[record] is what a sensor showed; remove sensor and controller_sensor"
            )

    def _check_choices(self) -> None:
        """Refuse a part that is neither built nor a file, or both."""
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

    def _check_lengths(self) -> None:
        """Refuse a run that is no whole number of steps."""
        lengths = {"duration": self.duration}
        if self.validation:
            lengths["validation.duration"] = self.validation.duration
        for key, duration in lengths.items():
            if duration:
                _steps(key, duration, self.step)

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
