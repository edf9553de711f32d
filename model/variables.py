"""Parameters and variables: each is declared once; all else about it is generated from here."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from bristle.common.errors import BristleError

__all__ = ["Namespace", "Parameter", "State", "Variable", "declaring"]


@dataclass(frozen=True)
class Parameter:
    """A number the user sets before the simulation starts.

    `name` is the public name (structured, ``lugre.Fc``), `symbol` the paper's letter, `unit` SI,
    `minimum` and `maximum` the closed interval of allowed values, `source` a key of references.bib
    with an equation number. A model file may leave out what is `optional`, and what is 0 by
    default.
    """

    name: str
    symbol: str
    unit: str
    default: float
    minimum: float
    maximum: float
    description: str
    source: str
    optional: bool = False

    @property
    def repeats(self) -> bool:
        """True of a phase, a turn of which changes nothing."""
        return self.unit == "rad" and self.name.rpartition(".")[2].startswith("phase")

    def check(self, value: float) -> float:
        """Return `value` if it lies in the interval, otherwise raise `BristleError`."""
        try:
            finite = math.isfinite(value)
        except TypeError:
            raise BristleError(
                f"{self.name} = {value!r} is not a number; give one in {self.unit}"
            ) from None
        if not (finite and self.minimum <= value <= self.maximum):
            raise BristleError(
                f"{self.name} = {value:g} {self.unit} is outside [{self.minimum:g},"
                f" {self.maximum:g}] {self.unit}; choose a value in that interval"
                f" ({self.description})"
            )
        return value


def declaring(
    prefix: str, source: str
) -> Callable[[str, str, str, tuple[float, float, float], str], Parameter]:
    """Return a function that declares parameters under a prefix, all of one source.

    It takes name, symbol, unit, (default, minimum, maximum) and description.
    """

    def declared(
        name: str, symbol: str, unit: str, values: tuple[float, float, float], text: str
    ) -> Parameter:
        return Parameter(f"{prefix}.{name}", symbol, unit, *values, text, source)

    return declared


@dataclass(frozen=True)
class Variable:
    """An input, an output, a state or a constant: name, SI unit, meaning."""

    name: str
    unit: str
    description: str
    start: float = 0.0
    boolean: bool = False
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None


@dataclass(frozen=True)
class State(Variable):
    """A state; `start` and `scale` are numbers or expressions of the parameters.

    `scale` is the size of the state, against which the integration tolerance counts.
    """

    initial: Any = 0.0
    scale: Any = 1.0


@dataclass
class Namespace:
    """Symbols by name with attribute access; a prefix makes ``p.sigma0`` mean ``lugre.sigma0``."""

    symbols: dict[str, Any] = field(default_factory=dict)
    prefix: str = ""

    def __getattr__(self, name: str) -> Any:
        symbols = self.__dict__["symbols"]
        for key in (f"{self.__dict__['prefix']}{name}", name):
            if key in symbols:
                return symbols[key]
        raise AttributeError(f"no symbol '{name}' under prefix '{self.__dict__['prefix']}'")

    def __getitem__(self, name: str) -> Any:
        return getattr(self, name)

    def under(self, prefix: str) -> Namespace:
        """Return the same symbols seen from a prefix such as ``lugre.``."""
        return Namespace(self.symbols, prefix)
