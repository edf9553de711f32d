"""A sampling rate that stands above the numbers: ``fs = 200 Hz``, ``Sampling interval (ms), 5``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from bristle.common.errors import BristleError
from bristle.common.unit_names import unit_symbol
from bristle.common.units import parse_unit

_GIVEN = re.compile(
    r"""^[^\w]*
    (?:(?P<rate>fs|f_s|(?:sampl\w*[ _-]*)?(?:rate|freq(?:uency)?))
      |(?:ts|t_s|dt|delta[ _-]?[tx]|(?:sampl\w*[ _-]*)?(?:time[ _-]*)?(?:interval|period|time)))
    \s*(?:[\[(](?P<before>[^\])]*)[\])])?
    [\s:=,;"]+
    (?P<number>[+-]?[\d.]+(?:e[+-]?\d+)?)
    \s*[\[(]?(?P<behind>[^\W\d]+)?[\])]?\s*(?:[,;\t"].*)?$""",
    re.IGNORECASE | re.VERBOSE,
)


def rate_in(lines: Sequence[str]) -> float | None:
    """Return the sampling rate [Hz] that one of some lines gives, or None; without a unit, a rate
    is in Hz and an interval in s.
    """
    for line in lines:
        if match := _GIVEN.match(line):
            usual = "Hz" if match["rate"] else "s"
            rate = _in_hertz(match["number"], match["before"] or match["behind"] or usual)
            if rate is not None:
                return rate
    return None


def _in_hertz(number: str, unit: str) -> float | None:
    """Return a rate or an interval as a rate [Hz]; None if it is neither."""
    try:
        given, value = parse_unit(unit_symbol(unit) or unit), float(number)
    except (BristleError, ValueError):
        return None
    if not 0.0 < value < float("inf"):
        return None
    if given.exponents == parse_unit("Hz").exponents:
        return value * given.factor
    return 1.0 / (value * given.factor) if given.exponents == parse_unit("s").exponents else None
