"""JSON: a table as a list of samples or as lists of values, and lines of one sample each."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.columns import Array, Columns, must_fit
from bristle.common.errors import BristleError
from bristle.records.formats.timestamps import seconds

PARSED_SIZE = 8  # bytes in memory for one of the text
Json = Any


def read_json(path: Path) -> Columns:
    """Return the columns of a JSON file: its longest list of samples, or its lists of values."""
    must_fit(path, PARSED_SIZE * path.stat().st_size)
    tree = json.loads(path.read_text(encoding="utf-8-sig"))
    samples = _longest(tree)
    if samples:
        return from_samples(path, samples)
    return from_lists(path, dict(_lists(tree)))


def read_json_lines(path: Path) -> Columns:
    """Return the columns of a file with one sample, a JSON object, in each line."""
    must_fit(path, PARSED_SIZE * path.stat().st_size)
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    found, findings = [], []
    filled = [k for k, line in enumerate(lines) if line.strip()]
    for k in filled:
        try:
            found.append(json.loads(lines[k]))
        except ValueError as error:
            if k == filled[-1] and found:
                findings.append("the last line breaks off; left out")
                break
            raise BristleError(
                f"record {path}: line {k + 1} is no JSON ({error}); correct that line"
            ) from None
    columns = from_samples(path, [each for each in found if isinstance(each, Mapping)])
    columns.findings = (*columns.findings, *findings)
    return columns


def _longest(tree: Json) -> list[Mapping[str, Json]]:
    """Return the longest list of objects within a tree."""
    if isinstance(tree, list):
        inside = [_longest(each) for each in tree if isinstance(each, list)]
        own = [each for each in tree if isinstance(each, Mapping)]
        return max([own, *inside], key=len)
    if isinstance(tree, Mapping):
        return max(map(_longest, tree.values()), key=len, default=[])
    return []


def _lists(tree: Json, prefix: str = "") -> list[tuple[str, list[Json]]]:
    """Return the lists of values within a tree of objects."""
    if not isinstance(tree, Mapping):
        return [(prefix.rstrip(".") or "array", tree)] if isinstance(tree, list) else []
    return [pair for key, value in tree.items() for pair in _lists(value, f"{prefix}{key}.")]


def flat(sample: Json, prefix: str = "") -> dict[str, Json]:
    """Return the values of a sample by name: those of an object inside as ``name.key``, those of a
    list as ``name[0]``.
    """
    if isinstance(sample, Mapping):
        pairs = [
            (f"{prefix}.{key}" if prefix else str(key), value) for key, value in sample.items()
        ]
    elif isinstance(sample, Sequence) and not isinstance(sample, str | bytes):
        pairs = [(f"{prefix}[{k}]", value) for k, value in enumerate(sample)]
    else:
        return {prefix: sample}
    return {name: value for key, each in pairs for name, value in flat(each, key).items()}


def from_samples(path: Path, samples: Sequence[Mapping[str, Json]]) -> Columns:
    """Return the columns of samples."""
    return from_rows(path, [flat(sample) for sample in samples])


def from_rows(path: Path, rows: Sequence[Mapping[str, Json]]) -> Columns:
    """Return the columns of rows of values by name; what one does not hold is NaN."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    must_fit(path, 8 * len(names) * len(rows), len(names))
    return from_lists(path, {name: [row.get(name) for row in rows] for name in names})


def from_lists(path: Path, lists: Mapping[str, Sequence[Json]]) -> Columns:
    """Return lists of values as columns."""
    must_fit(path, 8 * sum(map(len, lists.values())), len(lists))
    columns, unusable, clocks = {}, {}, []
    for name, values in lists.items():
        numbers = _numbers(values)
        if numbers is None and all(isinstance(each, str | None) for each in values):
            numbers = seconds([each or "" for each in values])
            clocks += [] if numbers is None else [name]
        if numbers is None:
            other = next((each for each in values if not _is_number(each)), None)
            unusable[name] = "booleans" if isinstance(other, bool) else f"{json.dumps(other)[:30]}"
        else:
            columns[name] = numbers
    return Columns(columns, unusable, clocks=clocks)


def _is_number(value: Json) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _numbers(values: Sequence[Json]) -> Array | None:
    """Return values as numbers, NaN in the place of null; None if one is no number."""
    if not all(map(_is_number, values)) or all(each is None for each in values):
        return None
    return np.array([np.nan if each is None else float(each) for each in values])
