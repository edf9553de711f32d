"""Objects of MATLAB's classes in MAT files: timeseries and timetables, and the numbers that others
hold.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.columns import Columns, columns_of
from bristle.common.table import Array
from bristle.records.formats.structs import flat_structs
from bristle.records.logs.topics import needed

SERIES_TIME, SERIES_DATA = "Time", "Data"  # columns of a timeseries, by the names of its properties
# s: what one of the units of a timeseries is worth
TIME_UNITS = {
    "nanoseconds": 1e-9,
    "microseconds": 1e-6,
    "milliseconds": 1e-3,
    "seconds": 1.0,
    "minutes": 60.0,
    "hours": 3600.0,
    "days": 86400.0,
    "weeks": 604800.0,
}


def read_objects(path: Path) -> Columns:
    """Return the vectors of a MAT file with objects, each timeseries with a time of its own [s]."""
    with needed(path, "a MAT file with objects of MATLAB", "mat-io"):
        from matio import load_from_mat
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # classes that are not known are read as their properties
        found = load_from_mat(str(path))
    tree = {name: _plain(x) for name, x in found.items() if not name.startswith("__")}
    columns = columns_of(path, dict(flat_structs(tree)), "(:,{})")
    clocks = {f"{name}.{SERIES_DATA}": f"{name}.{SERIES_TIME}" for name in _series(tree)}
    for name in columns:
        data = name.partition("(:,")[0]
        if (clock := clocks.get(data, name)) in columns and clock in clocks.values():
            columns.times[name] = clock
            columns.units[clock] = "s"
    return columns


class _Series(dict[str, Any]):
    """Time and data of a timeseries."""


def _series(tree: Mapping[str, Any], prefix: str = "") -> Iterable[str]:
    for name, value in tree.items():
        if isinstance(value, _Series):
            yield prefix + name
        elif isinstance(value, Mapping):
            yield from _series(value, f"{prefix}{name}.")


def _plain(value: Any, inside: tuple[Any, ...] = ()) -> Any:
    """Return structs, objects and tables as dictionaries, cells as those of their elements; an
    object `inside` itself as nothing.
    """
    if any(value is each for each in inside):
        return None
    inside = (*inside, value)
    if isinstance(getattr(value, "properties", None), Mapping):
        own = {name: _plain(each, inside) for name, each in value.properties.items()}
        return _of_series(own) if value.classname == "timeseries" else own
    if hasattr(value, "to_dict") and hasattr(value, "index"):
        return _of_table(value)
    return _of_array(value, inside) if isinstance(value, np.ndarray) else value


def _of_table(table: Any) -> dict[str, Any]:
    """Return the columns of a table, with its index where that is a time."""
    index = {} if table.index.dtype.kind == "i" else {table.index.name or SERIES_TIME: table.index}
    return {str(name): _numbers(x) for name, x in (index | dict(table.items())).items()}


def _of_array(value: Any, inside: tuple[Any, ...]) -> Any:
    """Return an array of structs, a cell, a text or numbers."""
    if names := value.dtype.names:
        return _listed([{n: _plain(x[n], inside) for n in names} for x in value.ravel()])
    if value.dtype.kind == "O":
        return _listed([_plain(x, inside) for x in value.ravel()])
    if value.dtype.kind == "U" and value.size == 1:
        return str(value.ravel()[0])
    return _numbers(value)


def _listed(elements: list[Any]) -> Any:
    """Return a single element as it is, others by their names or numbers."""
    if len(elements) == 1:
        return elements[0]
    names = [each.get("Name") if isinstance(each, Mapping) else None for each in elements]
    named = all(isinstance(each, str) and each for each in names) and len(set(names)) == len(names)
    keys = names if named else range(1, len(elements) + 1)
    return {str(key): each for key, each in zip(keys, elements, strict=True)}


def _numbers(column: Any) -> Any:
    """Return a vector, or a column of a table; durations in s."""
    x = np.asarray(column)
    lasts = x.dtype.kind == "m" and np.datetime_data(x.dtype)[0] not in ("Y", "M")
    return x / np.timedelta64(1, "s") if lasts else x


def _of_series(own: Mapping[str, Any]) -> _Series:
    """Return time [s] and data of a timeseries, whose last or first axis is the time."""
    time, data = _time_of(own.get("TimeInfo", {}), own.get("Time_")), np.asarray(own.get("Data_"))
    if data.ndim > 2 and data.shape[-1] == len(time):
        data = data.reshape(-1, len(time)).T
    return _Series({SERIES_TIME: time, SERIES_DATA: data})


def _time_of(info: Any, beside: Any) -> Array:
    """Return a time [s] that was written sample by sample, or as start and interval."""
    info = info if isinstance(info, Mapping) else {}
    unit = TIME_UNITS.get(str(info.get("Units", "seconds")), 1.0)
    written = [
        np.asarray(x, dtype=float).ravel() for x in (info.get("Time_"), beside) if x is not None
    ]
    given = next((x for x in written if x.size), None)
    if given is None:
        start, step, count = (_number(info.get(key)) for key in ("Start_", "Increment_", "Length"))
        given = start + step * np.arange(0 if np.isnan(count) else int(count))
    return np.asarray(unit * given)


def _number(value: Any) -> float:
    x = np.asarray(np.nan if value is None else value, dtype=float).ravel()
    return float(x[0]) if x.size else float("nan")
