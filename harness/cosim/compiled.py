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


class LoopUnit(ctypes.Structure):
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
    units : array of LoopUnit
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

    units: ctypes.Array[LoopUnit]
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
        self.bus, self.control, self._memory, self._means = buses[0], control, memory, means
        self._width = len(self.bus.flags)
        self._connect(buses)
        self._record(range(len(buses)))
        self.master = self._master(len(buses))

    def _connect(self, buses: Sequence[Bus]) -> None:
        """Lay out what reaches inputs: links, events and recorded series, lane by lane."""
        bus, place, worth = self.bus, self._memory.address, self._memory.worth
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
        driven_to = [place(port, k) for k in lanes for port in bus.series]
        self._links = (_Link * len(links))(*links)
        self._events = (_Event * len(events))(*(each for *_, each in events))
        self._series = np.ascontiguousarray(np.column_stack(driven) if driven else np.empty((0, 0)))
        self._series_to = np.array(driven_to, dtype=np.uintp)

    def _record(self, lanes: range) -> None:
        """Lay out what is recorded at every step, looked at now and then, and watched."""
        bus, memory = self.bus, self._memory
        taps = [memory.address(port, k) for k in lanes for port in bus.record]
        flags = [self._flag(memory, port, k) for k in lanes for port in bus.flags]
        watched = [i for i, (unit, _) in enumerate(bus.record) if unit in bus.watch]
        self._taps = np.array(taps, dtype=np.uintp)
        self._factors = np.array([memory.worth(port) for port in bus.record], dtype=float)
        self._flags = (_Flag * len(flags))(*flags)
        self._looks = np.zeros((bus.steps // bus.chunk + 2, len(flags)))
        self._look_rows = np.zeros(len(self._looks), dtype=np.int64)
        self._watched = np.array(watched, dtype=np.int64)
        self._diverged = np.zeros(len(lanes), dtype=np.int64)

    def _master(self, lanes: int) -> _Master:
        """Return what the loop is given: addresses and sizes of all that, and where it begins."""
        bus, memory = self.bus, self._memory
        return _Master(
            units=ctypes.addressof(memory.units),
            links=ctypes.addressof(self._links),
            events=ctypes.addressof(self._events),
            series_to=pointer(self._series_to),
            series=pointer(self._series),
            taps=pointer(self._taps),
            factors=pointer(self._factors),
            mean=None if self._means is None else pointer(self._means),
            record=pointer(memory.values),
            control=pointer(self.control),
            n_units=len(bus.instances),
            n_links=len(self._links),
            n_events=len(self._events),
            n_series=len(self._series_to),
            n_taps=len(bus.record),
            n_lanes=lanes,
            split=bus.split,
            sequential=bus.sequential,
            h=bus.h,
            start=bus.start,
            failed_unit=-1,
            flags=ctypes.addressof(self._flags),
            looks=pointer(self._looks),
            look_rows=pointer(self._look_rows),
            watched=pointer(self._watched),
            diverged_lanes=pointer(self._diverged) if lanes > 1 else None,
            huge=HUGE,
            n_flags=len(self._flags),
            n_watched=len(self._watched),
            every=bus.chunk,
            steps=bus.steps,
            diverged_row=-1,
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
        """Return the flags read of a lane: rows (readings,) and values (readings, flags)."""
        n = self.master.n_looks
        return self._look_rows[:n], self._looks[:n, lane * self._width : (lane + 1) * self._width]
