"""Values that vary over runs, as they are written on the command line: `PATH=SPEC`."""

from __future__ import annotations

import re
import tomllib

import numpy as np

from bristle.common.errors import BristleError

MOST_VALUES = 10_000
SPECS = "a:b:n (n values from a to b), or a list [v1, v2]"


def values_of(given: str, specs: str = SPECS) -> list[str]:
    """Return the overrides ``path=value`` that a `PATH=SPEC` stands for.

    Parameters
    ----------
    given : str
        The path of a scenario's key, and ``a:b:n`` for n values from a to b or a list ``[v1, v2]``; a and b may be followed by one
        unit, as in ``0.001:0.002:3 kg.m2``; in a list each value has its own, as in ``["1 ms", "2 ms"]`` or ``[1 ms, 2 ms]``.
    specs : str
        What an error says that a SPEC is.

    Raises
    ------
    BristleError
        If it is written in another way.
    """
    path, separator, spec = given.partition("=")
    path, spec = path.strip(), spec.strip()
    if not separator or not path or not spec:
        raise BristleError(f"vary '{given}': not PATH=SPEC; a SPEC is {specs}")
    if spec.startswith("["):
        return [f"{path}={value}" for value in _listed(given, spec)]
    found = re.fullmatch(r"([^:\s]+):([^:\s]+):(\d+)(?:\s+(\S+))?", spec)
    if found is None:
        raise BristleError(f"vary '{given}': '{spec}' is no SPEC; write {specs}")
    try:
        first, last, count = float(found[1]), float(found[2]), int(found[3])
    except ValueError:
        raise BristleError(f"vary '{given}': '{found[1]}' or '{found[2]}' is no number; write {specs}") from None
    if not (np.isfinite(first) and np.isfinite(last) and 1 <= count <= MOST_VALUES):
        raise BristleError(f"vary '{given}': the ends must be finite, and n from 1 to {MOST_VALUES}")
    numbers = [f"{value:.12g}" for value in np.linspace(first, last, count)]
    return [f"{path}={number} {found[4]}" if found[4] else f"{path}={number}" for number in numbers]


def seeds_of(given: str) -> list[int]:
    """Return seeds written as ``1-12`` or ``1,4,7-9``; raise `BristleError` for anything else."""
    found: list[int] = []
    for part in given.split(","):
        ends = re.fullmatch(r"\s*(\d{1,9})(?:-(\d{1,9}))?\s*", part)
        if ends is None:
            raise BristleError(f"seeds '{given}': '{part}' is neither a seed nor a range; write for example 1-12 or 1,4,7-9")
        first, last = int(ends[1]), int(ends[2] or ends[1])
        if first < 1 or last < first or last - first >= MOST_VALUES:
            raise BristleError(f"seeds '{given}': '{part}' must rise from 1 or more, over at most {MOST_VALUES} seeds")
        found += range(first, last + 1)
    return list(dict.fromkeys(found))


def _listed(given: str, spec: str) -> list[str]:
    try:
        values = [str(value).lower() if isinstance(value, bool) else str(value) for value in tomllib.loads(f"x = {spec}")["x"]]
    except (ValueError, TypeError, RecursionError):
        values = [part.strip() for part in spec.removeprefix("[").removesuffix("]").split(",")]
    if not values or not all(values) or not spec.endswith("]"):
        raise BristleError(f"vary '{given}': '{spec}' is no list; write [v1, v2]")
    return values
