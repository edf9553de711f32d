"""Units as loggers write them, in English and German (``Nm``, ``U/min``, ``Grad``), as
`bristle.common.units` has them.
"""

from __future__ import annotations

import re

from bristle.common.errors import BristleError
from bristle.common.units import parse_unit

COUNTS = "count"  # steps of an encoder: a unit of its own, whose value only the rig knows

_UNIT_WORDS = {
    "s": "s sec secs second seconds sekunde sekunden",
    "ms": "msec msecs millisecond milliseconds millisekunde millisekunden",
    "us": "µs μs usec usecs microsecond microseconds mikrosekunde mikrosekunden",
    "ns": "nsec nsecs nanosecond nanoseconds nanosekunde nanosekunden",
    "min": "minute minutes minuten",
    "rad": "radian radians",
    "deg": "° º degree degrees grad",
    "rev": "u umdr umdrehung umdrehungen revolution revolutions turn turns",
    "rpm": "u/min 1/min min-1 min^-1 r/min rev/min umdr/min rpm u/minute",
    "rev/s": "rps u/s r/s",
    "deg/s": "dps",
    "m": "meter metre meters metres",
    "mm": "millimeter millimetre millimeters millimetres",
    "um": "µm μm",
    "V": "volt volts",
    "mV": "millivolt millivolts",
    "A": "amp amps ampere amperes",
    "mA": "milliamp milliamps",
    "degC": "°c celsius",
    "N": "newton newtons",
    "N.m": "newtonmeter newtonmetre newton-meter newton-metre n-m",
    "%": "percent prozent pct",
    COUNTS: (
        "count counts cnt cnts inc incs increment increments inkr inkrement inkremente tick ticks"
        " step steps lsb digit digits"
    ),
}
_KNOWN = {word: unit for unit, words in _UNIT_WORDS.items() for word in words.split()}
_EXACT = {
    "Nm": "N.m",
    "mNm": "mN.m",
    "Ncm": "N.cm",
    "Nmm": "N.mm",
    "NM": "N.m",
    "U": "rev",
    "S": "s",
    "v": "V",
    "a": "A",
}
_PRODUCT = str.maketrans({"·": ".", "*": ".", "×": ".", "⋅": ".", "²": "2", "³": "3"})


def unit_symbol(text: str) -> str | None:
    """Return a unit as `parse_unit` reads it, `COUNTS` for steps of an encoder, None if unknown."""
    text = text.strip().strip("[](){}<> ").translate(_PRODUCT)
    if not text:
        return None
    for known in (_EXACT.get(text), _KNOWN.get(text.lower())):
        if known:
            return known
    over, slash, under = text.partition("/")
    parts = [_factor(over), *([_factor(under)] if slash else [])]
    return None if None in parts else "/".join(part for part in parts if part)


def _factor(text: str) -> str | None:
    """Return one side of a fraction as `parse_unit` reads it; m^2 and s**2 are m2 and s2."""
    text = re.sub(r"\^|\.\.", "", text.strip())
    for found in (_EXACT.get(text), _KNOWN.get(text.lower()), text):
        try:
            if found and found != COUNTS:
                parse_unit(found)
                return found
        except BristleError:
            continue
    return None
