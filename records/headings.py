"""What the name of a column and its unit say: which quantity it holds, whether it is a setpoint."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

from bristle.common.unit_names import COUNTS, unit_symbol
from bristle.common.units import parse_unit

# of each quantity, in English and German; a compound such as Istwinkel ends with one, or begins
# with it
_QUANTITY_WORDS = {
    "time": (
        "t time zeit timestamp timestamps stamp zeitstempel uhrzeit datetime datum clock seconds"
        " sekunden elapsed x-axis"
    ),
    "torque": "torque moment drehmoment tau effort trq",
    "force": "force kraft f",
    "voltage": "voltage spannung volt volts vin uin pwm duty",
    "current": "current strom iq amps i",
    "position": (
        "position pos angle winkel theta phi encoder enc lage weg displacement rotation drehwinkel"
        " stellung q"
    ),
    "velocity": "velocity speed geschwindigkeit drehzahl omega vel w dtheta qd",
}
QUANTITIES = {
    word: quantity for quantity, words in _QUANTITY_WORDS.items() for word in words.split()
}
UNITS = {  # SI unit of each quantity, that of a linear axis second
    "time": ("s",),
    "torque": ("N.m",),
    "force": ("N",),
    "voltage": ("V",),
    "current": ("A",),
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
}
SETPOINTS = {
    "soll",
    "sollwert",
    "ref",
    "reference",
    "set",
    "setpoint",
    "cmd",
    "command",
    "commanded",
    "target",
    "action",
    "goal",
    "desired",
    "des",
    "demand",
    "req",
}
UNWANTED = {
    "error",
    "err",
    "fehler",
    "abweichung",
    "temp",
    "temperature",
    "temperatur",
    "status",
    "state",
    "index",
    "sample",
    "nr",
    "id",
    "seq",
}
TURNS_A_MINUTE = ("drehzahl", "rpm")  # words that are a unit, too
COMPOUND_LETTERS = 4  # least length of a word that is recognised within a compound
_BRACKETS = re.compile(r"^(?P<label>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]\s*$")
_BEHIND = re.compile(
    r"^(?P<label>.+?)(?:\s*/\s+|\s+in\s+|\s+/|[_ ])(?P<unit>[^\s_]+(?:_per_\w+)?)$"
)


@dataclass(frozen=True)
class Heading:
    """A column by its name.

    Attributes
    ----------
    name : str
        As in the file.
    unit : str or None
        As `parse_unit` reads it, `COUNTS` for steps of an encoder; None if it is not given or not
        known.
    quantity : str or None
        A key of `UNITS`; None if neither name nor unit says.
    named : bool
        Whether the name says which quantity it is, and not the unit alone.
    setpoint, unwanted : bool
        Whether it is what was asked for and not measured; whether it is neither input nor output of
        a servo.
    """

    name: str
    unit: str | None
    quantity: str | None
    named: bool
    setpoint: bool
    unwanted: bool

    @property
    def fits(self) -> bool:
        """Whether the unit is one of the quantity."""
        return (
            self.unit is not None
            and self.quantity is not None
            and self.quantity == quantity_of(self.unit)
        )


def heading(name: str, unit: str | None = None) -> Heading:
    """Return what a name says; `unit` is what the file says of it elsewhere."""
    label, symbol = name, None if unit is None else unit_symbol(unit)
    if symbol is None:
        label, symbol = _unit_in(name)
    words = _words(label)
    joined = "".join(words)  # i_q is one name
    found = _quantities([joined] if joined in QUANTITIES else words)
    by_unit = None if symbol is None else quantity_of(symbol)
    quantity = found[-1] if found else None  # the last word decides, "motor current"
    # a unit decides where a name says two things, "position speed"
    if by_unit and (not found or by_unit in found or len(label) == 1):
        quantity = by_unit
    turns = any(word.endswith(TURNS_A_MINUTE) for word in words)
    if symbol is None and quantity == "velocity" and turns:
        symbol = "rpm"
    setpoint, unwanted = any(map(_set, words)), any(map(_unwanted, words))
    return Heading(name, symbol, quantity, bool(found), setpoint, unwanted)


def _quantities(words: Sequence[str]) -> list[str]:
    """Return the quantities that words name."""
    return [quantity for word in words if (quantity := _quantity(word))]


def without_unit(name: str) -> str:
    """Return a name without the unit in brackets at its end, if it has one."""
    match = _BRACKETS.match(name)
    return match["label"] if match else name


def quantity_of(unit: str) -> str | None:
    """Return the quantity that a unit is one of."""
    if unit == COUNTS:
        return None
    exponents = parse_unit(unit).exponents
    return next(
        (
            name
            for name, units in UNITS.items()
            if exponents in [parse_unit(each).exponents for each in units]
        ),
        None,
    )


def _unit_in(name: str) -> tuple[str, str | None]:
    """Return the name without the unit that it ends with, and the unit: ``t [ms]``, ``speed /
    rpm``, ``angle_deg``.
    """
    if (match := _BRACKETS.match(name)) and match["label"]:
        return match["label"], unit_symbol(match["unit"])
    if match := _BEHIND.match(name):
        symbol = unit_symbol(match["unit"].replace("_per_", "/"))
        named = {quantity for word in _words(match["label"]) if (quantity := _quantity(word))}
        # a single letter may be the name of a phase or channel, unless it is a unit of what the
        # name says
        if symbol is not None and (symbol == COUNTS or quantity_of(symbol) in named):
            return match["label"], symbol
    symbol = unit_symbol(name) if len(name) > 1 else None
    return name, symbol if symbol and symbol != COUNTS and _quantity(name.lower()) is None else None


def _words(label: str) -> list[str]:
    """Return the words of a name in lower case: motorCurrent, motor_current and ``motor current 1``
    are alike.
    """
    spaced = re.sub(r"(?<=[a-zäöü])(?=[A-ZÄÖÜ])", " ", label)
    return [word.lower() for word in re.findall(r"[^\W\d_]+(?:-[^\W\d_]+)?", spaced)]


def _set(word: str) -> bool:
    return word in SETPOINTS or word.startswith("soll")


def _unwanted(word: str) -> bool:
    return word in UNWANTED or any(
        word.endswith(known) for known in UNWANTED if len(known) >= COMPOUND_LETTERS
    )


def _quantity(word: str) -> str | None:
    """Return the quantity that a word names."""
    if word in QUANTITIES:
        return QUANTITIES[word]
    long = sorted(
        (known for known in QUANTITIES if len(known) >= COMPOUND_LETTERS), key=len, reverse=True
    )
    ends = (known for known in long if word.endswith(known))
    begins = (known for known in long if word.startswith(known))
    return next((QUANTITIES[known] for known in chain(ends, begins)), None)
