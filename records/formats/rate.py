"""A sampling rate: with its unit, or in a line above the numbers, ``Sampling interval (ms), 5``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from bristle.common.errors import BristleError
from bristle.common.unit_names import unit_symbol
from bristle.common.units import quantity

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
            unit = match["before"] or match["behind"] or ("Hz" if match["rate"] else "s")
            try:
                return rate_of(f"{match['number']} {unit_symbol(unit) or unit}")
            except BristleError:  # a line on something else
                continue
    return None


def rate_of(given: str) -> float:
    """Return a sampling rate [Hz] that is given as one, ``200 Hz``, or as an interval, ``5 ms``."""
    try:
        period = quantity(given, "s")
    except BristleError:
        period = None
    value = quantity(given, "Hz") if period is None else period
    if value <= 0.0:
        raise BristleError("must be above 0")
    return value if period is None else 1.0 / period
