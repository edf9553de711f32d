"""A parameter that a fit moves: its interval, its steps, what is known of it before."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bristle.plant.effects import effect as find_effect

START_FACTOR = 300.0  # largest factor between a positive parameter and its start value

# of what is anywhere in an interval of length 1 with the same probability
EVEN_VARIANCE = 1.0 / 12.0


@dataclass(frozen=True)
class Free:
    """A fitted parameter: its interval, whether its steps are factors, an optional prior. What
    `repeats` is a phase [rad]: where it would leave the interval, whole turns are taken off.
    """

    name: str
    low: float
    high: float
    factor: bool = False
    nominal: float | None = None  # mean of the prior, on the scale of the steps (`scaled`)
    prior_sd: float = 1.0  # its standard deviation, on the same scale
    repeats: bool = False

    @property
    def nominal_value(self) -> float:
        """The prior mean, in its unit."""
        assert self.nominal is not None
        return float(np.exp(self.nominal)) if self.factor else self.nominal

    def scaled(self, value: float) -> float:
        """Return a value on the scale of the parameter's steps: its logarithm if it moves by
        factors.
        """
        return float(np.log(value)) if self.factor else value

    @property
    def precision(self) -> float:
        """The inverse variance on the scale of the steps if all that is known is the interval."""
        return 1.0 / (EVEN_VARIANCE * (self.scaled(self.high) - self.scaled(self.low)) ** 2)

    def clip(self, value: float) -> float:
        """Return the value moved into the interval."""
        if self.repeats and not self.low <= value <= self.high:
            return math.remainder(value, 2 * math.pi)
        return min(max(value, self.low), self.high)

    def leaves(self, value: float, step: float) -> bool:
        """True if a step from an end of the interval leads out of it."""
        outwards = (value <= self.low and step < 0) or (value >= self.high and step > 0)
        return bool(outwards and not self.repeats)

    def at_bound(self, value: float) -> bool:
        """True at an end of the interval."""
        if self.repeats:
            return False
        near = 1e-9 * min(self.high - self.low, abs(self.low) + 1.0), 1e-9 * abs(self.high)
        return bool(value <= self.low + near[0] or value >= self.high - near[1])

    def at_binding_bound(self, value: float) -> bool:
        """True at an end of the interval other than 0, where the parameter is merely absent."""
        return self.at_bound(value) and value != 0.0

    def widened(self, factor: float) -> Free:
        """Return the same with both ends moved outwards by a factor; an end at 0 stays."""
        low = self.low / factor if self.low > 0 else self.low * factor
        high = self.high * factor if self.high > 0 else self.high / factor
        return replace(self, low=low, high=high)


def free_parameters(
    name: str, start: Mapping[str, float], limits: Mapping[str, tuple[float, float]]
) -> tuple[Free, ...]:
    """Return an effect's free parameters: those with start values, in intervals and `limits`."""
    free, effect = [], find_effect(name)
    for p in effect.parameters:
        short = p.name.removeprefix(f"{name}.")
        if short not in start:
            continue
        low, high = effect.search_interval.get(short, (p.minimum, p.maximum))
        factor = p.minimum > 0
        if factor:
            low, high = (
                max(low, start[short] / START_FACTOR),
                min(high, start[short] * START_FACTOR),
            )
        low, high = (
            max(low, limits.get(p.name, (low, high))[0]),
            min(high, limits.get(p.name, (low, high))[1]),
        )
        free.append(Free(p.name, low, high, factor, repeats=p.repeats))
    return tuple(free)
