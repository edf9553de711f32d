"""The compiled loop, loop.c: the twins of its structures, and how it runs over the units and
variables that it is shown.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.cache import cached, digest
from bristle.common.errors import BristleError
from bristle.fmus.calls import Call, Control
from bristle.harness.cosim.bus import Array, Bus, Port, Progress
from bristle.model.compiler import FLAGS, SUFFIX, compile_shared, compiler_identity

# s; after a call of the compiled loop that takes less, the next does more before Python looks
# around
SHORT_CALL = 0.02
HUGE = 1e9  # an estimate beyond this has diverged


class Unit(ctypes.Structure):
    """What the compiled loop needs to know of a unit."""

    _fields_ = [
        ("instance", ctypes.c_void_p),
        *((name, ctypes.c_void_p) for name in ("set", "get", "set_flag", "get_flag", "step")),
        *((name, ctypes.c_int) for name in ("fmi", "n_in", "n_out", "n_in_flags", "n_out_flags")),
        ("in_vr", ctypes.c_void_p),
        ("out_vr", ctypes.c_void_p),
        ("in_", ctypes.c_void_p),
        ("out", ctypes.c_void_p),
    ]


class _Link(ctypes.Structure):
    _fields_ = [
        ("from_", ctypes.c_void_p),
        ("to", ctypes.c_void_p),
        ("factor", ctypes.c_double),
        ("unit", ctypes.c_longlong),
    ]


class _Event(ctypes.Structure):
    _fields_ = [("step", ctypes.c_longlong), ("to", ctypes.c_void_p), ("value", ctypes.c_double)]


class _Flag(ctypes.Structure):
    _fields_ = [
        ("unit", ctypes.c_void_p),
        ("vr", ctypes.c_uint),
        ("boolean", ctypes.c_int),
        ("factor", ctypes.c_double),
    ]


class _Master(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("units", "links", "events", "series_to", "series")),
        *((name, ctypes.c_void_p) for name in ("taps", "factors", "mean", "record", "control")),
        *(
            (name, ctypes.c_longlong)
            for name in ("next_event", "n_units", "n_links", "n_events", "n_series", "n_taps")
        ),
        ("n_lanes", ctypes.c_longlong),
        ("split", ctypes.c_longlong),
        ("sequential", ctypes.c_longlong),
        ("h", ctypes.c_double),
        ("start", ctypes.c_double),
        *((name, ctypes.c_longlong) for name in ("failed_unit", "failed_status", "failed_call")),
        *(
            (name, ctypes.c_void_p)
            for name in ("flags", "looks", "look_rows", "watched", "diverged_lanes")
        ),
        ("huge", ctypes.c_double),
        *(
            (name, ctypes.c_longlong)
            for name in ("n_flags", "n_watched", "n_looks", "every", "steps", "seen")
        ),
        ("diverged_row", ctypes.c_longlong),
        ("diverged_tap", ctypes.c_longlong),
    ]


class Lifecycle(ctypes.Structure):
    """What starts an instance of FMI 2 again."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("reset", "setup", "enter", "leave")]


@cache
def library() -> ctypes.CDLL:
    """Compile the loop (or take it from the cache) and load it."""
    text = (files("bristle.harness.cosim") / "loop.c").read_text(encoding="utf-8")
    key = digest(text, *FLAGS, compiler_identity())
    loaded = ctypes.CDLL(
        str(cached(f"loop-{key[:24]}{SUFFIX}", lambda out: compile_shared({"loop.c": text}, out)))
    )
    loaded.loop_run.restype = loaded.loop_drive.restype = ctypes.c_longlong
    return loaded


def native_available() -> bool:
    """Say whether the compiled loop can be had on this machine."""
    try:
        library()
    except BristleError:
        return False
    return True


def pointer(array: NDArray[Any]) -> int:
    """Return the address of an array's first element."""
    return int(array.ctypes.data)


@dataclass(frozen=True)
class Memory:
    """Where the compiled loop finds units and variables; of a port and a lane.

    Attributes
    ----------
    units : array of Unit
        In the order of the bus.
    address : function
        Where the variable is.
    worth : function
        How much one of its number is on the bus; of a port alone.
    flag : function
        Unit, value reference and whether it is a Boolean, of what is read now and then.
    values : ndarray, shape (lanes, steps + 1, recorded ports)
        What the loop records.
    """

    units: ctypes.Array[Unit]
    address: Callable[[Port, int], int]
    worth: Callable[[Port], float]
    flag: Callable[[Port, int], tuple[int, int, int]]
    values: Array


class Compiled:
    """The compiled loop over one bus, or over several that are alike, in lanes; `means`: what is
    averaged over a row.
    """

    def __init__(
        self,
        buses: Sequence[Bus],
        memory: Memory,
        control: Control,
        means: NDArray[np.int64] | None = None,
    ) -> None:
        bus, place, worth = buses[0], memory.address, memory.worth
        lanes, names = range(len(buses)), [instance.name for instance in bus.instances]
        links = [
            _Link(place(a, k), place(b, k), worth(a) / worth(b), names.index(b[0]))
            for k in lanes
            for a, b in bus.links
        ]
        events = sorted(
            (step, k, n, _Event(step, place(to, k), value / worth(to)))
            for k in lanes
            for n, (step, to, value) in enumerate(buses[k].events)
        )
        driven = [values / worth(port) for each in buses for port, values in each.series.items()]
        flags = [self._flag(memory, port, k) for k in lanes for port in bus.flags]
        watched = [i for i, (unit, _) in enumerate(bus.record) if unit in bus.watch]
        self.bus, self.control, self._width, self._memory = bus, control, len(bus.flags), memory
        self._links, self._events = (
            (_Link * len(links))(*links),
            (_Event * len(events))(*(each for *_, each in events)),
        )
        self._flags, self._means = (_Flag * len(flags))(*flags), means
        self._series = np.ascontiguousarray(np.column_stack(driven) if driven else np.empty((0, 0)))
        self._series_to = np.array(
            [place(port, k) for k in lanes for port in bus.series], dtype=np.uintp
        )
        self._taps = np.array(
            [place(port, k) for k in lanes for port in bus.record], dtype=np.uintp
        )
        self._factors = np.array([worth(port) for port in bus.record], dtype=float)
        self._looks = np.zeros((bus.steps // bus.chunk + 2, len(flags)))
        self._look_rows = np.zeros(len(self._looks), dtype=np.int64)
        self._watched = np.array(watched, dtype=np.int64)
        self._diverged = np.zeros(len(lanes), dtype=np.int64)
        self.master = _Master(
            ctypes.addressof(memory.units),
            ctypes.addressof(self._links),
            ctypes.addressof(self._events),
            pointer(self._series_to),
            pointer(self._series),
            pointer(self._taps),
            pointer(self._factors),
            None if means is None else pointer(means),
            pointer(memory.values),
            pointer(control),
            0,
            len(names),
            len(links),
            len(events),
            len(self._series_to),
            len(bus.record),
            len(lanes),
            bus.split,
            bus.sequential,
            bus.h,
            bus.start,
            -1,
            0,
            0,
            ctypes.addressof(self._flags),
            pointer(self._looks),
            pointer(self._look_rows),
            pointer(self._watched),
            pointer(self._diverged) if len(lanes) > 1 else None,
            HUGE,
            len(flags),
            len(watched),
            0,
            bus.chunk,
            bus.steps,
            0,
            -1,
            0,
        )

    @staticmethod
    def _flag(memory: Memory, port: Port, lane: int) -> _Flag:
        unit, reference, boolean = memory.flag(port, lane)
        return _Flag(ctypes.addressof(memory.units[unit]), reference, boolean, memory.worth(port))

    def run(self, progress: Progress | None = None) -> int:
        """Run all steps, or up to a failure; return how many rows were done."""
        bus, lib, master = self.bus, library(), self.master
        lib.loop_start(ctypes.byref(master))
        done, stride = 0, bus.chunk
        while (
            done < bus.steps
            and master.failed_unit < 0
            and master.diverged_row < 0
            and not self.control[1]
        ):
            count, begun = min(stride, bus.steps - done), perf_counter()
            self.control[2] = Call.step
            done += lib.loop_run(
                ctypes.byref(master), ctypes.c_longlong(done), ctypes.c_longlong(count)
            )
            if progress:
                progress(done)
            if perf_counter() - begun < SHORT_CALL:
                stride *= 2
        self.control[2] = Call.none
        return done

    def diverged(self, lane: int) -> bool:
        """Say whether a watched value of one of several lanes went beyond `HUGE`."""
        return bool(self._diverged[lane])

    def flags(self, lane: int) -> tuple[NDArray[np.int64], Array]:
        """Return what was read of the flags of a lane: rows (readings,) and values (readings,
        flags).
        """
        n = self.master.n_looks
        return self._look_rows[:n], self._looks[:n, lane * self._width : (lane + 1) * self._width]
