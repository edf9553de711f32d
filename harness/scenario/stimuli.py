"""Stimuli: inputs of plant and controller over time, as steps, a sine and coloured noise in SI
units, checked against the FMU.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bristle.common.errors import BristleError, suggest
from bristle.common.signals import Array
from bristle.common.units import interval, quantity
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Port
from bristle.harness.scenario.reading import Loaded
from bristle.harness.scenario.scenario import NoiseTable, Sine, Stimulus

Event = tuple[int, Port, float]
Free = Mapping[str, tuple[str, Fmu]]  # input -> the unit that has it, and its FMU

START_DRAWS = 12  # uniform draws whose sum, nearly Gaussian, is the start of coloured noise


@dataclass(frozen=True)
class Signal:
    """One input over time.

    Attributes
    ----------
    key : str
        Where it is in the scenario, for errors.
    variable, unit : str
        Input, and the unit on the bus that has it.
    start : float
        Value before the first of the points.
    points : tuple of (int, float)
        Step from which the input has a value, and the value.
    sine, noise : (Sine, float), (NoiseTable, float), optional
        What is added to that value, with its amplitude or rms in the unit of the input.
    """

    key: str
    variable: str
    unit: str
    start: float
    points: tuple[tuple[int, float], ...]
    sine: tuple[Sine, float] | None = None
    noise: tuple[NoiseTable, float] | None = None

    @property
    def ports(self) -> tuple[Port, ...]:
        """The inputs that receive it: a voltage goes to the observer too."""
        return tuple(
            (unit, self.variable)
            for unit in (("plant", "observer") if self.variable == "u" else (self.unit,))
        )

    @property
    def varying(self) -> bool:
        """Whether it changes at every step."""
        return self.sine is not None or self.noise is not None

    def values(self, count: int, h: float) -> Array:
        """Return the value that is held over each of `count` steps of h seconds, shape (count,)."""
        values = np.full(count, self.start)
        for step, value in self.points:
            values[step:] = value
        if self.sine is not None:
            sine, amplitude = self.sine
            values += amplitude * np.sin(
                2 * math.pi * sine.frequency * h * np.arange(count) + sine.phase
            )
        if self.noise is not None:
            noise, rms = self.noise
            values += rms * coloured(count, 2 * math.pi * noise.bandwidth * h, noise.seed)
        return values

    def settled(self) -> Signal:
        """Return it with its last value from the beginning."""
        value = self.points[-1][1] if self.points else self.start
        return Signal(
            self.key, self.variable, self.unit, self.start, ((0, value),), self.sine, self.noise
        )


def coloured(count: int, corner: float, seed: int) -> Array:
    """Return stationary noise of variance 1, shape (count,): x' = a x + sqrt(1 - a^2) n with n
    white and a = exp(-corner).

    Source: ljung1999 section 13.3 (filtered white noise).
    """
    from scipy.signal import lfilter

    draws = np.random.Generator(np.random.PCG64(seed))
    first = float(draws.random(START_DRAWS).sum()) - START_DRAWS / 2
    a = math.exp(-corner)
    white = math.sqrt(3.0) * (2.0 * draws.random(count) - 1.0)
    white[:1] = first
    gain = np.full(count, math.sqrt(1.0 - a * a))
    gain[:1] = 1.0
    return np.asarray(lfilter([1.0], [1.0, -a], gain * white))


def read_stimuli(loaded: Loaded, free: Free, h: float) -> tuple[Signal, ...]:
    """Return the stimuli of a scenario, whose units have the `free` inputs, at a step of h seconds.

    Raises
    ------
    BristleError
        One line with file, key, value and what is allowed.
    """
    return tuple(_signals(loaded, free, h))


def _signals(loaded: Loaded, free: Free, h: float) -> Iterator[Signal]:
    stimuli = loaded.scenario.stimuli
    for i, stimulus in enumerate(stimuli):
        key, name = f"stimuli[{i}]", stimulus.variable
        # each free input has one stimulus at most
        if name in [earlier.variable for earlier in stimuli[:i]]:
            raise loaded.error(
                f"{key}.variable", name, "has a stimulus already; put all points into one"
            )
        if name not in free:
            known = suggest(name, list(free))
            message = (
                f"no free input of plant or controller{known}; choose one of:"
                f" {', '.join(free) or 'none'}"
            )
            raise loaded.error(f"{key}.variable", name, message)
        # sizes in the unit of the input, and frequencies that the steps can show
        unit, fmu = free[name]
        sine = noise = None
        if stimulus.sine is not None:
            sine = (
                stimulus.sine,
                _size(loaded, f"{key}.sine.amplitude", stimulus.sine.amplitude, fmu.unit(name)),
            )
            _below_nyquist(loaded, f"{key}.sine.frequency", stimulus.sine.frequency, h)
        if stimulus.noise is not None:
            noise = (
                stimulus.noise,
                _size(loaded, f"{key}.noise.rms", stimulus.noise.rms, fmu.unit(name)),
            )
            _below_nyquist(loaded, f"{key}.noise.bandwidth", stimulus.noise.bandwidth, h)
        yield Signal(
            key,
            name,
            unit,
            fmu.start(name),
            tuple(_points(loaded, key, stimulus, fmu, h)),
            sine,
            noise,
        )


def _size(loaded: Loaded, key: str, given: str | int | float | bool, unit: str) -> float:
    try:
        value = quantity(given, unit)
    except BristleError as error:
        raise loaded.error(key, given, str(error)) from None
    if value < 0:
        raise loaded.error(key, given, "must be at least 0; drop the sign")
    return value


def _below_nyquist(loaded: Loaded, key: str, frequency: float, h: float) -> None:
    if frequency >= 0.5 / h:
        raise loaded.error(
            key,
            f"{frequency:g} Hz",
            f"must be below {0.5 / h:g} Hz, half the rate of the steps; lower it",
        )


def _points(
    loaded: Loaded, at: str, stimulus: Stimulus, fmu: Fmu, h: float
) -> Iterator[tuple[int, float]]:
    """Yield the points: a value of t is on the bus from the first step at t or later."""
    before = -math.inf
    for j, (when, what) in enumerate(stimulus.points):
        key = f"{at}.points[{j}]"
        try:
            time, value = _time(when), fmu.physical(stimulus.variable, what)
        except BristleError as error:
            raise loaded.error(key, f"{when}, {what}", str(error)) from None
        if time <= before or time < 0:
            raise loaded.error(key, when, "times must increase from 0 s; sort the points")
        before = time
        yield math.ceil(time / h - 1e-6), value


def _time(given: object) -> float:
    if not isinstance(given, (str, int, float)):
        raise BristleError('not a time; write for example "60 s"')
    return 0.0 if given in (0, 0.0) and not isinstance(given, bool) else quantity(given, "s")


def events(signals: Sequence[Signal]) -> tuple[Event, ...]:
    """Return the signals that only change at points as events, in order of time."""
    return tuple(
        sorted(
            (step, port, value)
            for s in signals
            if not s.varying
            for step, value in s.points
            for port in s.ports
        )
    )


def series(signals: Sequence[Signal], steps: int, h: float) -> dict[Port, Array]:
    """Return the signals that change at every step as recorded inputs, a value for each step."""
    return {
        port: values
        for s in signals
        if s.varying
        for values in [s.values(steps, h)]
        for port in s.ports
    }


def check_range(
    loaded: Loaded, free: Free, signals: Sequence[Signal], steps: int, h: float
) -> None:
    """Raise `BristleError` if what is added to the values leaves the interval of the input within
    so many steps.
    """
    for signal in signals:
        fmu = free[signal.variable][1]
        low, high = fmu.interval(signal.variable)
        values = signal.values(steps, h) if signal.varying else np.empty(0)
        beyond = values[(values < low) | (values > high)]
        if len(beyond):
            unit = fmu.unit(signal.variable)
            reached = f"{beyond[0]:g}" + ("" if unit == "1" else f" {unit}")
            message = (
                f"reaches {reached}, outside {interval(low, high, unit)}; lower the sine or the"
                " noise"
            )
            raise loaded.error(signal.key, signal.variable, message)
