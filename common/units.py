"""Units: written as in a modelDescription (``N.m.s/rad``, ``1/s2``), reduced to SI base units."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache

from bristle.common.errors import BristleError

__all__ = ["Unit", "convert", "interval", "parse_unit", "per_second", "quantity", "zero_of"]

# the SI base units (and rad) that FMI's BaseUnit has and servo models need
BASE = ("kg", "m", "s", "A", "K", "rad")

_SYMBOLS: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "%": (0.01, {}),
    "kg": (1.0, {"kg": 1}),
    "g": (1e-3, {"kg": 1}),
    "m": (1.0, {"m": 1}),
    "cm": (1e-2, {"m": 1}),
    "mm": (1e-3, {"m": 1}),
    "um": (1e-6, {"m": 1}),
    "s": (1.0, {"s": 1}),
    "ms": (1e-3, {"s": 1}),
    "us": (1e-6, {"s": 1}),
    "ns": (1e-9, {"s": 1}),
    "min": (60.0, {"s": 1}),
    "A": (1.0, {"A": 1}),
    "mA": (1e-3, {"A": 1}),
    "K": (1.0, {"K": 1}),
    "degC": (1.0, {"K": 1}),  # of a difference; of a reading `zero_of` too
    "rad": (1.0, {"rad": 1}),
    "deg": (math.pi / 180.0, {"rad": 1}),
    "rev": (2.0 * math.pi, {"rad": 1}),
    "rpm": (2.0 * math.pi / 60.0, {"rad": 1, "s": -1}),
    "Hz": (1.0, {"s": -1}),
    "kHz": (1e3, {"s": -1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "mN": (1e-3, {"kg": 1, "m": 1, "s": -2}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "mV": (1e-3, {"kg": 1, "m": 2, "s": -3, "A": -1}),
}

# a number with its unit right behind it, as in 5ms
_GLUED = re.compile(r"((?>[-+]?[\d.]+(?:[eE][-+]?\d+)?))(\S.*)")
FREEZING = 273.15  # K


@dataclass(frozen=True)
class Unit:
    """A unit as a factor to SI and the exponents of the base units in the order of `BASE`."""

    text: str
    factor: float
    exponents: tuple[int, ...]


@cache
def parse_unit(text: str) -> Unit:
    """Read a unit such as ``kg.m2`` or ``N.m.s/rad``: factors joined by dots, at most one slash.

    Raises
    ------
    BristleError
        If a symbol is not known.
    """
    numerator, _, denominator = text.strip().partition("/")
    factor, exponents = 1.0, dict.fromkeys(BASE, 0)
    for part, sign in ((numerator, 1), (denominator, -1)):
        for token in part.strip("()").split(".") if part else ():
            match = re.fullmatch(r"(1|%|[A-Za-z]+?)(-?\d*)", token)
            if match is None or match[1] not in _SYMBOLS:
                raise BristleError(
                    f"unit '{text}': '{token}' is not known{_joined(token)}; known:"
                    f" {' '.join(_SYMBOLS)}"
                )
            scale, dimensions = _SYMBOLS[match[1]]
            power = sign * int(match[2] or 1)
            factor *= scale**power
            for base, exponent in dimensions.items():
                exponents[base] += power * exponent
    return Unit(text, factor, tuple(exponents[base] for base in BASE))


def _joined(token: str) -> str:
    """Return a suggestion if a token is two symbols without the dot between them."""
    pairs = ((token[:i], token[i:]) for i in range(1, len(token)))
    meant = next(
        (f"{a}.{b}" for a, b in pairs if a in _SYMBOLS and re.sub(r"\d+$", "", b) in _SYMBOLS), ""
    )
    return f", did you mean '{meant}'?" if meant else ""


def per_second(text: str) -> str:
    """Return the unit of a rate: ``rad/s`` becomes ``rad/s2``."""
    numerator, _, denominator = text.partition("/")
    tokens = [token for token in denominator.strip("()").split(".") if token]
    powers = {
        match[1]: int(match[2] or 1)
        for token in tokens
        if (match := re.fullmatch(r"([A-Za-z]+)(\d*)", token))
    }
    powers["s"] = powers.get("s", 0) + 1
    written = ".".join(name if power == 1 else f"{name}{power}" for name, power in powers.items())
    return f"{numerator}/{written}" if len(powers) == 1 else f"{numerator}/({written})"


def convert(value: float, unit: str, si_unit: str) -> float:
    """Convert `value` from `unit` to `si_unit`, which must have the same dimensions."""
    have, want = parse_unit(unit), parse_unit(si_unit)
    if have.exponents != want.exponents:
        raise BristleError(f"unit '{unit}' does not fit: a unit like '{si_unit}' is needed")
    return value * (have.factor / want.factor) + zero_of(unit, si_unit)


def zero_of(unit: str, si_unit: str) -> float:
    """Return what a reading of zero in `unit` is in `si_unit`."""
    return FREEZING if (unit, si_unit) == ("degC", "K") else 0.0


def interval(low: float, high: float, unit: str = "1") -> str:
    """Return an interval as text, ``[0, 40]`` or ``[0.1, 2] rad/s``, with all digits of an end that
    is a whole number.
    """
    ends = (
        f"{end:.0f}" if float(end).is_integer() and float(f"{end:g}") != end else f"{end:g}"
        for end in (low, high)
    )
    return f"[{', '.join(ends)}]" + ("" if unit == "1" else f" {unit}")


def quantity(given: str | float | int, si_unit: str) -> float:
    """Read a physical value such as ``"75 deg/s"`` or ``"5ms"`` and return it in `si_unit`.

    A bare number is accepted only for the unit ``1``.

    Raises
    ------
    BristleError
        If the number or the unit is missing, unknown, of another dimension, or not finite.
    """
    if isinstance(given, bool) or not isinstance(given, (str, float, int)):
        raise BristleError(
            f'{given!r} is not a quantity; write a number with a unit such as "1 {si_unit}"'
        )
    text = str(given).strip()
    glued = _GLUED.fullmatch(text)
    number, unit = glued.groups() if glued else text.partition(" ")[::2]
    try:
        value = float(number)
    except ValueError:
        raise BristleError(
            f"'{given}' is not a quantity; write a number with a unit such as \"1 {si_unit}\""
        ) from None
    if not math.isfinite(value):
        raise BristleError(
            f"'{given}' is not finite; write a number with a unit such as \"1 {si_unit}\""
        )
    if not unit.strip():
        if si_unit != "1":
            right = (
                f'"{number} {si_unit}"'
                if value >= 0
                else f'a unit behind the number, such as "1 {si_unit}"'
            )
            raise BristleError(f"'{given}' has no unit; write {right}")
        return value
    return convert(value, unit.strip(), si_unit)
