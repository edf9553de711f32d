"""Timestamps written as text: ISO 8601, day.month.year, times of the day, and durations such as
``0.5 sec``, in seconds.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

from bristle.common.columns import Array

DAY = 86400.0  # s
_TIME = r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)"
_ISO = re.compile(rf"(\d{{4}})[-/](\d\d?)[-/](\d\d?)[T ]\s*{_TIME}\s*(Z|[+-]\d\d:?\d\d)?$")
_DOTTED = re.compile(rf"(\d\d?)\.(\d\d?)\.(\d{{4}})[T, ]\s*{_TIME}$")
_SPAN = re.compile(r"([+-]?\d+(?:[.,]\d+)?)\s*(s|sec|ms|us|µs|min)$")
_SPANS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0}  # s
_BARE = re.compile(rf"{_TIME}$")


def is_stamp(text: str) -> bool:
    """Return whether a text is a timestamp that `seconds` reads."""
    text = text.strip()
    return any(pattern.match(text) for pattern in (_ISO, _DOTTED, _BARE, _SPAN))


def seconds(texts: Sequence[str]) -> Array | None:
    """Return timestamps in s, shape (n,): since 1970 with a date, else since midnight of the first
    one's day.

    Empty texts are NaN; None if a text is no timestamp or has no valid date.
    """
    found = np.full(len(texts), np.nan)
    try:
        for k, text in enumerate(texts):
            if text := text.strip():
                found[k] = _stamp(text)
    except ValueError:
        return None
    if not np.isfinite(found).any():
        return None
    if found[np.isfinite(found)].max() < DAY and ":" in "".join(
        texts[:2]
    ):  # without a date: a time that falls by hours is that of the next day
        known = np.flatnonzero(np.isfinite(found))
        found[known] += DAY * np.cumsum(np.diff(found[known], prepend=found[known[0]]) < -DAY / 2)
    return found


def _stamp(text: str) -> float:
    """Return one timestamp in s; raise ValueError if it is none."""
    if match := _ISO.match(text):
        year, month, day, *clock, zone = match.groups()
    elif match := _DOTTED.match(text):
        day, month, year, *clock = match.groups()
        zone = None
    elif match := _BARE.match(text):
        hours, minutes, rest = match.groups()
        return 3600.0 * int(hours) + 60.0 * int(minutes) + float(rest.replace(",", "."))
    elif match := _SPAN.match(text):
        return float(match[1].replace(",", ".")) * _SPANS[match[2]]
    else:
        raise ValueError(text)
    hours, minutes, rest = clock
    whole = datetime(int(year), int(month), int(day), int(hours), int(minutes), tzinfo=UTC)
    return (whole - _offset(zone)).timestamp() + float(rest.replace(",", "."))


def _offset(zone: str | None) -> timedelta:
    """Return how far the clock of a time zone, such as +02:00, is ahead."""
    if zone in (None, "Z"):
        return timedelta(0)
    assert zone is not None
    ahead = timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
    return ahead if zone[0] == "+" else -ahead
