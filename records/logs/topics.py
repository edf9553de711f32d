"""Logs of messages: the fields of each topic as columns, beside the topic's own time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.columns import LONGEST_LIST, Columns, must_fit
from bristle.common.errors import BristleError
from bristle.records.formats.json_records import flat, from_rows

# fields that hold the names of the elements of the lists beside them
LABEL_FIELDS = ("name", "names", "joint_names")
STAMP = ("header.stamp.sec", "header.stamp.nanosec")
COUNTER = "header.seq"  # of ROS 1: no measurement
TIME = "time"

Message = tuple[str, float, Any]  # topic, time of the log [s], what was decoded


def from_messages(
    path: Path, messages: Iterable[Message], unusable: Mapping[str, str] | None = None
) -> Columns:
    """Return the columns ``topic.field`` of messages, each topic with its ``topic.time`` [s]: that
    of its headers if they have one, else that of the log. `unusable` may grow with the messages.
    """
    topics: dict[str, tuple[list[float], list[dict[str, Any]]]] = {}
    count = 0
    for topic, time, content in messages:
        times, rows = topics.setdefault(topic, ([], []))
        row = flat(_short(plain(content)))
        count += len(row)
        must_fit(path, 8 * count)
        times.append(time)
        rows.append(row)
    columns, held, own = dict[str, Any](), dict(unusable or {}), dict[str, str]()
    for topic, (times, rows) in topics.items():
        of = from_rows(path, rows)
        clock = f"{topic}.{TIME}"
        seconds = _stamps(of, np.array(times))
        order = np.argsort(seconds, kind="stable")
        found = {
            f"{topic}.{name}": x[order] for name, x in of.items() if name not in (*STAMP, COUNTER)
        }
        columns |= {clock: seconds[order], **found}
        own |= dict.fromkeys((clock, *found), clock)
        held |= {f"{topic}.{name}": what for name, what in of.unusable.items()}
    must_fit(path, 0, len(columns) + len(held))
    result = Columns(columns, held, units=dict.fromkeys(set(own.values()), "s"))
    result.times = own
    return result


def _stamps(of: Columns, times: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the times of the headers [s], or those of the log where a header has none."""
    if not all(name in of for name in STAMP):
        return times
    stamps = of[STAMP[0]] + 1e-9 * of[STAMP[1]]
    return stamps if np.isfinite(stamps).all() and stamps.min() > 0.0 else times


def plain(value: Any) -> Any:
    """Return a message of any library as dictionaries, lists and numbers."""
    if isinstance(value, str | bytes | bool | int | float) or value is None:
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    names = list(_fields(value))
    if names:
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, Iterable):
        return [plain(each) for each in value]
    return str(value)


def _fields(value: Any) -> Iterator[str]:
    """Give the names of the fields of a message object."""
    if hasattr(value, "DESCRIPTOR"):  # Protocol Buffers
        yield from (field.name for field in value.DESCRIPTOR.fields)
    elif hasattr(value, "__dataclass_fields__"):
        yield from (name for name in value.__dataclass_fields__ if not name.startswith("_"))
    elif slots := getattr(value, "__slots__", ()):
        yield from (name for name in slots if not name.startswith("_"))
    elif not isinstance(value, Iterable):
        yield from (name for name in getattr(value, "__dict__", {}) if not name.startswith("_"))


def _short(value: Any) -> Any:
    """Return a message without long lists; lists beside a list of names as tables by these."""
    if isinstance(value, list):
        return [_short(each) for each in value] if len(value) <= LONGEST_LIST else None
    if not isinstance(value, dict):
        return value
    names: Sequence[Any] = next(
        (value[key] for key in LABEL_FIELDS if _are_names(value.get(key))), ()
    )
    found = {}
    for key, each in value.items():
        if names and isinstance(each, list) and len(each) == len(names) and each is not names:
            found[key] = dict(zip(names, map(_short, each), strict=True))
        elif not (names and each is names):
            found[key] = _short(each)
    return found


def _are_names(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) > 0
        and all(isinstance(each, str) and each for each in value)
        and len(set(value)) == len(value)
    )


@contextmanager
def needed(path: Path, format_name: str, library: str) -> Iterator[None]:
    """Say what to install where the imports in this context fail."""
    try:
        yield
    except ImportError:
        raise BristleError(
            f"record {path}: {format_name} needs {library}; run: pip install 'bristle[logs]'"
        ) from None
