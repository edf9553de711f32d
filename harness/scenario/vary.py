"""Values that vary over runs, as they are written on the command line: `PATH=SPEC`."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence

import numpy as np

from bristle.common.errors import BristleError
from bristle.harness.scenario.reading import keys_of

MOST_VALUES = 10_000
SEED_PATH = "controller.parameters.seed"  # of a scenario: what seeds stand for
SPECS = "a:b:n (n values from a to b), or a list [v1, v2]"


def values_of(given: str, specs: str = SPECS) -> list[str]:
    """Return the overrides ``path=value`` that a `PATH=SPEC` stands for.

    Parameters
    ----------
    given : str
        The path of a scenario's key, and ``a:b:n`` for n values from a to b or a list ``[v1, v2]``;
        a and b may be followed by one unit, as in ``0.001:0.002:3 kg.m2``; in a list each value has
        its own, as in ``["1 ms", "2 ms"]`` or ``[1 ms, 2 ms]``.
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
        values = _listed(given, spec)
        for value in values:
            if values.count(value) > 1:
                raise BristleError(f"vary '{given}': {value} is in the list twice; leave one out")
        return [f"{path}={value}" for value in values]
    return [f"{path}={value}" for value in _spread(given, spec, specs)]


def _spread(given: str, spec: str, specs: str) -> list[str]:
    """Return the values, with their unit, of ``a:b:n unit``."""
    match = re.fullmatch(r"([^:\s]+):([^:\s]+):(\d+)(?:\s+(\S+))?", spec)
    if match is None:
        raise BristleError(f"vary '{given}': '{spec}' is no SPEC; write {specs}")
    try:
        first, last, count = float(match[1]), float(match[2]), int(match[3])
    except ValueError:
        raise BristleError(
            f"vary '{given}': '{match[1]}' or '{match[2]}' is no number; write {specs}"
        ) from None
    if not (np.isfinite(first) and np.isfinite(last) and 1 <= count <= MOST_VALUES):
        raise BristleError(
            f"vary '{given}': the ends must be finite, and n from 1 to {MOST_VALUES}"
        )
    numbers = [f"{value:.12g}" for value in np.linspace(first, last, count)]
    return [f"{number} {match[4]}" if match[4] else number for number in numbers]


def refuse_conflicts(vary: Sequence[str], seeds: Sequence[int], overrides: Sequence[str]) -> None:
    """Raise `BristleError` if a key would get two values at once: from two of `vary`, from a seed,
    or from an override.
    """
    names = [".".join(keys_of(given.partition("=")[0])) for given in vary]
    for given, name in zip(vary, names, strict=True):
        if names.count(name) > 1:
            raise BristleError(
                f"vary '{given}': {name} is given twice; put all its values into one SPEC"
            )
        if name == SEED_PATH and seeds:
            raise BristleError(
                f"vary '{given}': seeds are given as well, and are the same key; leave one of"
                " them out"
            )
        if name in [".".join(keys_of(each.partition("=")[0])) for each in overrides]:
            raise BristleError(
                f"vary '{given}': {name} is set for all runs as well; leave one of them out"
            )


def seeds_of(given: str) -> list[int]:
    """Return seeds written as ``1-12`` or ``1,4,7-9``; raise `BristleError` for anything else."""
    seeds: list[int] = []
    for part in given.split(","):
        ends = re.fullmatch(r"\s*(\d{1,18})(?:-(\d{1,18}))?\s*", part)
        if ends is None:
            raise BristleError(
                f"seeds '{given}': '{part}' is neither a seed nor a range; write for example 1-12"
                " or 1,4,7-9"
            )
        first, last = int(ends[1]), int(ends[2] or ends[1])
        if first < 1 or last < first:
            raise BristleError(f"seeds '{given}': '{part}' must begin at 1 or more, and rise")
        if last - first >= MOST_VALUES:
            raise BristleError(
                f"seeds '{given}': '{part}' is more than {MOST_VALUES} seeds at once; write several"
                " ranges"
            )
        seeds += range(first, last + 1)
    return list(dict.fromkeys(seeds))


def _listed(given: str, spec: str) -> list[str]:
    try:
        values = [
            str(value).lower() if isinstance(value, bool) else str(value)
            for value in tomllib.loads(f"x = {spec}")["x"]
        ]
    except (ValueError, TypeError, RecursionError):
        if '"' in spec or "'" in spec or "[" in spec[1:]:
            raise BristleError(
                f"vary '{given}': '{spec}' is no list of TOML; put quotes around each text in it"
            ) from None
        values = [part.strip() for part in spec.removeprefix("[").removesuffix("]").split(",")]
    if not values or not all(values) or not spec.endswith("]"):
        raise BristleError(f"vary '{given}': '{spec}' is no list; write [v1, v2]")
    return values
