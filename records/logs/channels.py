"""Logs of channels, in groups that share a time: TDMS, MDF and ULog."""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.columns import Array, Columns, columns_of, must_fit
from bristle.common.errors import BristleError
from bristle.records.logs.topics import TIME, needed

# of a TDMS channel: the first sample [s], their distance [s], the unit
OFFSET, INCREMENT, UNIT = "wf_start_offset", "wf_increment", "unit_string"

Group = tuple[str, Array | None, Mapping[str, Any], Mapping[str, str]]  # name, time, values, units


def from_groups(path: Path, groups: Iterable[Group]) -> Columns:
    """Return the columns ``group.channel``, a group that has a time with ``group.time`` [s]."""
    columns, unusable, own = dict[str, Array](), dict[str, str](), dict[str, str]()
    units: dict[str, str] = {}
    for name, time, values, given in groups:
        found = columns_of(path, {f"{name}.{key}": x for key, x in values.items()})
        columns |= found
        unusable |= found.unusable
        units |= {f"{name}.{key}": unit for key, unit in given.items() if unit}
        if time is not None:
            clock = f"{name}.{TIME}"
            columns[clock], units[clock] = time, "s"
            own |= {each: clock for each in (clock, *found) if len(columns[each]) == len(time)}
        must_fit(path, 8 * sum(map(len, columns.values())), len(columns))
    result = Columns(columns, unusable, units=units)
    result.times = own
    return result


def read_tdms(path: Path) -> Columns:
    """Return the channels of a TDMS file."""
    with needed(path, "TDMS", "npTDMS"):
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    log_manager.set_level(logging.ERROR)  # what it warns of is read all the same

    def groups() -> Iterator[Group]:
        for group in TdmsFile.read(path).groups():
            values = {channel.name: channel[:] for channel in group.channels()}
            units = {c.name: str(c.properties.get(UNIT, "")) for c in group.channels()}
            steps = {
                (c.properties[INCREMENT], c.properties.get(OFFSET, 0.0), len(c))
                for c in group.channels()
                if INCREMENT in c.properties
            }
            time = None
            if len(steps) == 1:
                [(increment, offset, count)] = steps
                time = offset + increment * np.arange(count)
            yield group.name, time, values, units

    return from_groups(path, groups())


def _opened(
    path: Path, library: Callable[[Path], AbstractContextManager[Any]]
) -> AbstractContextManager[Any]:
    """Return an open file; what a library has half made of a broken one fails again when it is
    deleted, which nobody needs to see.
    """
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        try:
            return library(path)
        except Exception as error:  # the library has its own
            said = " ".join(str(error).split())
        gc.collect()
    finally:
        sys.unraisablehook = hook
    raise BristleError(f"record {path}: cannot be read: {said}; check the file")


def read_mdf(path: Path) -> Columns:
    """Return the channels of an MDF file of version 3 or 4."""
    with needed(path, "MDF", "asammdf"):
        from asammdf import MDF
    with path.open("rb") as stream:
        if stream.read(8).rstrip() not in (b"MDF", b"UnFinMF"):
            raise BristleError(f"record {path}: is no MDF file; check its name")

    def groups() -> Iterator[Group]:
        with _opened(path, MDF) as file:
            all_groups: list[Any] = file.groups
            for k, group in enumerate(all_groups):
                signals = [
                    file.get(group=k, index=index)
                    for index, channel in enumerate(group.channels)
                    if index != file.masters_db.get(k)
                ]
                name = group.channel_group.acq_name or f"group {k + 1}"
                time = np.asarray(file.get_master(k), dtype=float)
                values = {signal.name: signal.samples for signal in signals}
                yield name, time, values, {s.name: s.unit for s in signals}

    return from_groups(path, groups())


def read_ulog(path: Path) -> Columns:
    """Return the topics of a ULog file."""
    with needed(path, "ULog", "pyulog"):
        from pyulog import ULog

    def groups() -> Iterator[Group]:
        with path.open("rb") as stream:
            log = ULog(stream)
        several = {each.name for each in log.data_list if each.multi_id}
        for topic in log.data_list:
            name = f"{topic.name} {topic.multi_id}" if topic.name in several else topic.name
            values = {key: x for key, x in topic.data.items() if key != "timestamp"}
            yield name, 1e-6 * topic.data["timestamp"], values, {}

    return from_groups(path, groups())
