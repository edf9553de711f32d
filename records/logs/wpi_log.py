"""WPILOG: the entries of a robot's data log, each with a time of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bristle.common.columns import Columns
from bristle.records.logs.topics import Message, from_messages, needed

GETTERS = {
    "double": "getDouble",
    "float": "getFloat",
    "int64": "getInteger",
    "double[]": "getDoubleArray",
    "float[]": "getFloatArray",
    "int64[]": "getIntegerArray",
}


def read_wpi_log(path: Path) -> Columns:
    """Return the entries of numbers as ``name.value``."""
    with needed(path, "WPILOG", "robotpy-wpiutil"):
        from wpiutil.log import DataLogReader
    unusable: dict[str, str] = {}

    def messages() -> Iterator[Message]:
        kinds: dict[int, tuple[str, str]] = {}
        for record in DataLogReader(str(path)):
            if record.isStart():
                start = record.getStartData()
                kinds[start.entry] = start.name, start.type
            elif not record.isControl() and record.getEntry() in kinds:
                name, kind = kinds[record.getEntry()]
                if kind in GETTERS:
                    value = getattr(record, GETTERS[kind])()
                    yield name, 1e-6 * record.getTimestamp(), {"value": value}
                else:
                    unusable[name] = f"values of type '{kind}'"

    return from_messages(path, messages(), unusable)
