"""Parquet files, those of LeRobot data sets among them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.columns import LONGEST_LIST, Array, Columns, in_seconds, must_fit
from bristle.common.errors import BristleError

# columns of a LeRobot data set
EPISODE, EPISODE_TIME = "episode_index", "timestamp"
EPISODE_GAP = 100.0  # s: set between episodes: a gap at any rate
DEEPEST_DATA = 3  # folders between a Parquet file and the data set that it is part of


def read_parquet(path: Path) -> Columns:
    """Return the columns of numbers and timestamps of a Parquet file; lists of one length, such as
    the state of a LeRobot data set, as one column an element.
    """
    try:
        import pyarrow.parquet as pq
    except ImportError:
        raise BristleError(
            f"record {path}: Parquet needs pyarrow; run: pip install 'bristle[parquet]', or save it"
            " as CSV"
        ) from None

    with path.open("rb") as stream:
        file = pq.ParquetFile(stream)
        types = {field.name: field.type for field in file.schema_arrow}
        numeric, clocks, lists, content = _readable(types, file.metadata)
        must_fit(path, 8 * content, len(types))
        table = file.read(columns=[*numeric, *clocks, *lists])
    other = {name: f"{types[name]} values" for name in types if name not in table.column_names}
    columns = {name: table[name].to_numpy().astype(float) for name in numeric}
    columns |= {name: in_seconds(table[name].to_numpy()) for name in clocks}
    labels = _labels(path)
    for name in lists:
        elements = _elements(name, table[name].to_pylist(), labels.get(name, []))
        columns |= elements
        other |= {} if elements else {name: "lists of several lengths, or long ones"}
    return Columns(columns, other, clocks=clocks, findings=_set_apart(columns))


def _readable(
    types: Mapping[str, Any], metadata: Any
) -> tuple[list[str], list[str], list[str], int]:
    """Return the columns of numbers, of timestamps and of short lists, and how many numbers they
    hold.
    """
    from pyarrow.types import is_timestamp

    rows, counts = metadata.num_rows, _counts(metadata)
    numeric = [name for name, kind in types.items() if _is_number(kind)]
    clocks = [name for name, kind in types.items() if is_timestamp(kind)]
    held = {name: counts.get(name, 0) for name, kind in types.items() if _is_list(kind)}
    short = {name: count for name, count in held.items() if count <= LONGEST_LIST * rows}
    content = rows * (len(numeric) + len(clocks)) + sum(short.values())
    return numeric, clocks, [*short], content


def _is_number(kind: Any) -> bool:
    from pyarrow import types as kinds

    return bool(kinds.is_integer(kind) or kinds.is_floating(kind))


def _is_list(kind: Any) -> bool:
    """Return whether values are lists of numbers."""
    from pyarrow import types as kinds

    return bool(kinds.is_list(kind) or kinds.is_fixed_size_list(kind)) and _is_number(
        kind.value_type
    )


def _counts(metadata: Any) -> dict[str, int]:
    """Return how many numbers each column holds, before any is read."""
    counts: dict[str, int] = {}
    for group in range(metadata.num_row_groups):
        for k in range(metadata.num_columns):
            column = metadata.row_group(group).column(k)
            name = column.path_in_schema.split(".list.")[0]
            counts[name] = counts.get(name, 0) + column.num_values
    return counts


def _elements(name: str, rows: list[list[float] | None], labels: list[str]) -> dict[str, Array]:
    """Return the elements of lists as columns, by their labels or numbers; none where they differ
    in length, or are long.
    """
    width = max((len(row) for row in rows if row), default=0)
    if not 0 < width <= LONGEST_LIST or any(row and len(row) != width for row in rows):
        return {}
    values = np.array([row or [math.nan] * width for row in rows], dtype=float)
    if len(labels) == width:
        return {f"{name}.{label}": values[:, k] for k, label in enumerate(labels)}
    return {f"{name}[{k}]": values[:, k] for k in range(width)}


def _set_apart(columns: dict[str, Array]) -> list[str]:
    """Set the episodes of a LeRobot data set, whose times all begin anew, one after the other with
    gaps between them; return what is said of it.
    """
    episode, time = columns.get(EPISODE), columns.get(EPISODE_TIME)
    if episode is None or time is None:
        return []
    begins = np.flatnonzero(np.diff(episode)) + 1
    restarts = begins[time[begins] <= time[begins - 1]]
    if not len(restarts):
        return []
    shift = np.zeros(len(time))
    for k in restarts:
        shift[k:] += time[k - 1] - time[k] + EPISODE_GAP
    columns[EPISODE_TIME] = time + shift
    count = len(restarts) + 1
    return [f"{count} episodes, each with a time of its own; set {EPISODE_GAP:g} s apart"]


def _labels(path: Path) -> dict[str, list[str]]:
    """Return the names of the elements of lists, by column, where the file is part of a LeRobot
    data set: they stand in the meta/info.json beside its data.
    """
    infos = (folder / "meta" / "info.json" for folder in [*path.resolve().parents][:DEEPEST_DATA])
    info = next((each for each in infos if each.is_file()), None)
    if info is None:
        return {}
    try:
        features = json.loads(info.read_text(encoding="utf-8")).get("features", {})
        found = {key: each.get("names") for key, each in features.items()}
    except (OSError, ValueError, AttributeError):
        return {}
    # an older version has them within {"motors": [...]}
    flat = {
        key: next(iter(names.values()), None) if isinstance(names, Mapping) else names
        for key, names in found.items()
    }
    return {key: [str(x) for x in names] for key, names in flat.items() if isinstance(names, list)}
