"""Co-simulation of FMUs over a bus, step by step, and one FMU over a recorded input.

Timing: all units see the bus as it stood at the start of a step (Jacobi). What a unit publishes at
t_k+1 was computed from the bus of t_k. For comparison, `Bus.sequential` lets each unit see what
those before it have just published (Gauss-Seidel), and `Bus.split` makes several communication
steps of each row.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bristle.fmus.calls import CONTROL_SIZE, WATCH, Call
from bristle.fmus.host import Fmu, Slave, Value
from bristle.harness.cosim.compiled import (
    HUGE,
    Compiled,
    Lifecycle,
    Memory,
    Unit,
    library,
    native_available,
    pointer,
)

Array = NDArray[np.float64]
Port = tuple[str, str]  # (unit, variable)
Progress = Callable[[int], None]

CHUNK = 5_000  # steps between two looks at the flags, at most
LOOKS = 200  # such looks in a run, at least
STATUS = {2: "Discard", 3: "Error", 4: "Fatal", 5: "Pending"}  # of FMI; 0 and 1 are no failures
CALLED = ("setting its inputs", "doStep", "reading its outputs")


@dataclass(frozen=True)
class Instance:
    """One unit on the bus: an FMU and its start values."""

    name: str
    fmu: Fmu
    values: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class Bus:
    """What is co-simulated.

    `links` lead from outputs to inputs, `events` are (step, input, value) in order of time,
    `series` holds recorded inputs, a value for each step; `record` names the outputs kept at every
    step, `flags` what is read only now and then (Booleans, calculated parameters), and `watch` the
    units whose recorded outputs must stay below `HUGE`. Of a recorded input, row k + 1 holds what
    the unit got from t_k to t_k+1, its mean if that are several communication steps.
    """

    instances: tuple[Instance, ...]
    steps: int
    h: float
    links: tuple[tuple[Port, Port], ...] = ()
    events: tuple[tuple[int, Port, float], ...] = ()
    series: Mapping[Port, Array] = field(default_factory=dict)
    record: tuple[Port, ...] = ()
    flags: tuple[Port, ...] = ()
    watch: tuple[str, ...] = ()
    split: int = 1
    sequential: bool = False
    start: float = 0.0

    @property
    def chunk(self) -> int:
        """Steps between two looks at the flags."""
        return max(1, min(CHUNK, self.steps // LOOKS))

    @property
    def risky(self) -> bool:
        """Whether an FMU takes part whose library may harm its process."""
        return any(instance.fmu.risky for instance in self.instances)


@dataclass(frozen=True)
class Failure:
    """A run that ended early: which unit, when, why."""

    unit: str
    time: float
    message: str


@dataclass(frozen=True)
class Readings:
    """What was read of flags now and then: `values` (readings, ports) at `rows` (readings,), the
    first at row 0.
    """

    ports: tuple[Port, ...]
    rows: NDArray[np.int64]
    values: Array

    @classmethod
    def of(cls, ports: tuple[Port, ...], found: Sequence[tuple[int, Sequence[float]]]) -> Readings:
        """Return readings given one after the other, as row and values."""
        rows, values = (
            np.array([row for row, _ in found], dtype=np.int64),
            np.array([each for _, each in found], dtype=float),
        )
        return cls(ports, rows, values.reshape(len(rows), len(ports)))

    @cached_property
    def last(self) -> dict[Port, float]:
        """The last values, by port."""
        return dict(zip(self.ports, self.values[-1].tolist(), strict=True))

    def from_first_sample(self) -> Readings:
        """Return them as belongs to a record, which has no row for the start."""
        later = self.rows > 0
        return (
            Readings(self.ports, self.rows[later] - 1, self.values[later]) if later.any() else self
        )


@dataclass
class Trace:
    """What a run leaves behind: row k of `values` is the bus at start + k h."""

    record: tuple[Port, ...]
    values: Array
    h: float
    flags: Readings
    failure: Failure | None = None
    start: float = 0.0

    def __getitem__(self, port: Port) -> Array:
        return self.values[:, self.record.index(port)]

    def get(self, port: Port) -> Array | None:
        """Return what was recorded of a port, None if it was not."""
        return self[port] if port in self.record else None

    def says_something(self, port: Port) -> bool:
        """Say whether a number other than 0 was ever recorded of a port."""
        return self._not_zero.get(port, False) and bool(np.nan_to_num(self[port]).any())

    @cached_property
    def _not_zero(self) -> dict[Port, bool]:
        """Whether anything but 0 was recorded of each port: one pass over all, since most ports of
        an observer are 0 throughout.
        """
        return dict(zip(self.record, np.any(self.values, axis=0).tolist(), strict=True))

    def flag(self, port: Port) -> Array:
        """Return a flag for each row: what was read next, at that row or after it."""
        found = self.flags
        if port not in found.ports:
            return np.full(len(self.values), np.nan)
        return np.repeat(found.values[:, found.ports.index(port)], self._looked)

    @cached_property
    def _looked(self) -> NDArray[np.int64]:
        """Return how many rows each reading of the flags stands for."""
        ends = np.minimum(self.flags.rows + 1, len(self.values))
        ends[-1] = len(self.values)
        return np.diff(ends, prepend=0)

    def from_first_sample(self, factors: Mapping[Port, float]) -> Trace:
        """Return it as belongs to a record: row k is what was published after sample k, each column
        times its factor.
        """
        if not self.steps:
            return self
        scales = np.array([factors[port] for port in self.record])
        return Trace(
            self.record,
            self.values[1:] * scales,
            self.h,
            self.flags.from_first_sample(),
            self.failure,
        )

    @property
    def steps(self) -> int:
        """Steps done."""
        return len(self.values) - 1

    @property
    def time(self) -> Array:
        """Time of each row."""
        return np.asarray(self.start + np.arange(len(self.values)) * self.h)


class Node:
    """A slave with the memory its inputs and outputs live in: numbers, then Booleans as 0 and 1."""

    def __init__(self, slave: Slave, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        fmu = slave.fmu
        self.slave = slave
        self.inputs, self.outputs = (
            sorted(names, key=lambda name: not fmu.is_real(name)) for names in (inputs, outputs)
        )
        self.numbers = tuple(sum(map(fmu.is_real, names)) for names in (self.inputs, self.outputs))
        self.in_vr = np.array([fmu.reference(name) for name in self.inputs], dtype=np.uint32)
        self.out_vr = np.array([fmu.reference(name) for name in self.outputs], dtype=np.uint32)
        self.input = np.array(
            [fmu.start(name) / fmu.factor(name) for name in self.inputs], dtype=float
        )
        self.output = np.zeros(len(self.outputs))

    def structure(self) -> Unit:
        """Return what the compiled loop needs to know."""
        three, address = self.slave.fmu.fmi == 3, self.slave.address
        prefix, number = ("fmi3", "Float64") if three else ("fmi2", "Real")
        names = [
            f"{prefix}{each}"
            for each in (f"Set{number}", f"Get{number}", "SetBoolean", "GetBoolean", "DoStep")
        ]
        arrays = map(pointer, (self.in_vr, self.out_vr, self.input, self.output))
        component = ctypes.cast(self.slave.instance.component, ctypes.c_void_p)
        flags = [
            len(whole) - numbers
            for whole, numbers in zip((self.inputs, self.outputs), self.numbers, strict=True)
        ]
        return Unit(
            component, *map(address, names), 3 if three else 2, *self.numbers, *flags, *arrays
        )

    def place(self, name: str) -> tuple[Array, int]:
        """Return the array that holds a variable, and its index in it."""
        if name in self.inputs:
            return self.input, self.inputs.index(name)
        return self.output, self.outputs.index(name)

    # -- the same three calls through FMPy ---------------------------------------------------------

    def read(self) -> None:
        """Read the outputs."""
        instance, n = self.slave.instance, self.numbers[1]
        vr = self.out_vr.tolist()
        if n:
            self.output[:n] = (
                instance.getFloat64 if self.slave.fmu.fmi == 3 else instance.getReal
            )(vr[:n])
        if vr[n:]:
            self.output[n:] = instance.getBoolean(vr[n:])

    def _write(self) -> None:
        instance, n = self.slave.instance, self.numbers[0]
        vr, values = self.in_vr.tolist(), self.input.tolist()
        if n:
            (instance.setFloat64 if self.slave.fmu.fmi == 3 else instance.setReal)(
                vr[:n], values[:n]
            )
        if vr[n:]:
            instance.setBoolean(vr[n:], [value != 0.0 for value in values[n:]])

    def step(self, time: float, h: float) -> None:
        """Set the inputs, do a step, read the outputs."""
        instance = self.slave.instance
        self._write()
        if self.slave.fmu.fmi == 3:
            _, terminate, early, _ = instance.doStep(time, h)
            if terminate or early:
                raise RuntimeError("it asked to end the simulation")
        else:
            instance.doStep(time, h)
        self.read()


class Slaves:
    """FMUs that stay loaded from one run to the next, for one thread; a context manager that frees
    them.

    One of ours is reset between two runs, which leaves nothing of the first; what comes from
    elsewhere, or fails, is loaded anew.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[str, Path], Slave] = {}

    def take(self, instance: Instance) -> Slave:
        """Return the loaded FMU of an instance, not initialised yet; it must not be in use."""
        key = instance.name, instance.fmu.path
        slave = self._kept.pop(key, None)
        if slave is None:
            slave = Slave(instance.fmu, instance.name)
        else:
            slave.reset()
        return slave

    def give_back(self, slave: Slave, sound: bool) -> None:
        """Keep a loaded FMU for the next run, or free it."""
        if sound and not slave.fmu.risky:
            self._kept[slave.name, slave.fmu.path] = slave
        else:
            slave.close()

    def close(self) -> None:
        """Free all of them."""
        while self._kept:
            self._kept.popitem()[1].close()

    def __enter__(self) -> Slaves:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Session:
    """A bus with its FMUs loaded and initialised; a context manager. `slaves` keeps them loaded for
    the next session.
    """

    def __init__(
        self, bus: Bus, control: NDArray[np.int64] | None = None, slaves: Slaves | None = None
    ) -> None:
        self.bus, self._slaves = bus, slaves or Slaves()
        self._own, self._taken, self._sound = slaves is None, list[Slave](), False
        self.control = np.zeros(CONTROL_SIZE, dtype=np.int64) if control is None else control
        try:
            self.nodes = {instance.name: self._node(instance) for instance in bus.instances}
            self.values = np.zeros((bus.steps + 1, len(bus.record)))
            self.averaged = np.array(
                [name in self.nodes[unit].inputs for unit, name in bus.record], dtype=bool
            )
            self._looks: list[tuple[int, Sequence[float]]] = []
        except BaseException:
            self.close()
            raise

    def _node(self, instance: Instance) -> Node:
        bus, name = self.bus, instance.name
        slave = self._slaves.take(instance)
        self._taken.append(slave)
        slave.initialise(instance.values, bus.start)
        driven = [*(to for _, to in bus.links), *(to for _, to, _ in bus.events), *bus.series]
        read = [*(source for source, _ in bus.links), *bus.record]
        inputs = dict.fromkeys(variable for unit, variable in driven if unit == name)
        outputs = dict.fromkeys(
            variable for unit, variable in read if unit == name and variable not in inputs
        )
        return Node(slave, list(inputs), list(outputs))

    def _look(self, row: int) -> None:
        """Read the flags."""
        self._looks.append(
            (row, [self.nodes[unit].slave.get_value(name) for unit, name in self.bus.flags])
        )

    def _address(self, port: Port, _lane: int = 0) -> int:
        array, index = self.nodes[port[0]].place(port[1])
        return pointer(array) + 8 * index

    def _worth(self, port: Port) -> float:
        """Return how much one of the FMU's number is on the bus."""
        return self.nodes[port[0]].slave.fmu.factor(port[1])

    def close(self) -> None:
        """Free all FMUs, or give them back."""
        while self._taken:
            self._slaves.give_back(self._taken.pop(), self._sound)
        if self._own:
            self._slaves.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- compiled ----------------------------------------------------------------------------------

    def run(self, progress: Progress | None = None) -> Trace:
        """Run all steps in the compiled loop, in several calls, so that Python can look after the
        user between them.
        """
        bus, names = self.bus, list(self.nodes)
        units = (Unit * len(names))(*(node.structure() for node in self.nodes.values()))
        means = self.averaged.astype(np.int64) if self.averaged.any() else None
        memory = Memory(units, self._address, self._worth, self._flag, self.values[None])
        compiled = Compiled([bus], memory, self.control, means)
        done, master = compiled.run(progress), compiled.master
        self._looks = list(zip(*compiled.flags(0), strict=True))
        if master.diverged_row >= 0:
            early = self._beyond(master.diverged_row, master.diverged_tap)
            return self._trace(early.time - bus.start, early)
        if master.failed_unit < 0:
            return self._trace(done * bus.h)
        status = STATUS.get(master.failed_status, str(master.failed_status))
        why = f"{CALLED[master.failed_call]} returned {status}"
        return self._trace(done * bus.h, self._blame(names[master.failed_unit], done * bus.h, why))

    def _flag(self, port: Port, _lane: int) -> tuple[int, int, int]:
        """Return where a flag is read: unit, value reference, whether it is a Boolean."""
        unit, name = port
        fmu = self.nodes[unit].slave.fmu
        return list(self.nodes).index(unit), fmu.reference(name), int(not fmu.is_real(name))

    # -- FMPy's calls ------------------------------------------------------------------------------

    def run_fmpy(self, progress: Progress | None = None) -> Trace:
        """Do the same through FMPy's own calls: the fallback without a compiler, and the check on
        the compiled loop.
        """
        bus, nodes = self.bus, self.nodes
        places = {
            port: nodes[port[0]].place(port[1])
            for port in (*bus.record, *(p for link in bus.links for p in link))
        }
        events, k = list(bus.events), 0
        for node in nodes.values():
            node.read()
        self._write_row(0, places)
        self._look(0)
        while k < bus.steps and not self.control[1]:
            while events and events[0][0] <= k:
                _, (unit, name), value = events.pop(0)
                array, index = nodes[unit].place(name)
                array[index] = value / self._worth((unit, name))
            for (unit, name), values in bus.series.items():
                array, index = nodes[unit].place(name)
                array[index] = values[k] / self._worth((unit, name))
            for part in range(bus.split):
                failure = self._step_fmpy(k * bus.split + part, places)
                if failure is not None:
                    return self._trace(k * bus.h, failure)
                if self.averaged.any():
                    self.values[k + 1, self.averaged] += (
                        self._seen(places)[self.averaged] / bus.split
                    )
            k += 1
            self._write_row(k, places)
            self.control[0] = k
            if k % bus.chunk == 0 or k == bus.steps:
                early = self._diverged(max(1, k - bus.chunk + 1), k + 1)
                if early is not None:
                    return self._trace(early.time - bus.start, early)
                self._look(k)
                if progress:
                    progress(k)
        return self._trace(k * bus.h)

    def _step_fmpy(self, step: int, places: Mapping[Port, tuple[Array, int]]) -> Failure | None:
        """Do one communication step of all units; return why one failed."""
        bus, h = self.bus, self.bus.h / self.bus.split
        if not bus.sequential:
            self._transfer(list(self.nodes), places)
        for unit, node in self.nodes.items():
            if bus.sequential:
                self._transfer([unit], places)
            WATCH.begin(node.slave.fmu.path, Call.step)
            try:
                node.step(bus.start + step * h, h)
            except Exception as error:  # FMPy raises plain exceptions of several kinds
                return self._blame(unit, step * h, " ".join(str(error).split()))
        return None

    def _transfer(self, units: Sequence[str], places: Mapping[Port, tuple[Array, int]]) -> None:
        for source, to in self.bus.links:
            if to[0] in units:
                factor = self._worth(source) / self._worth(to)
                places[to][0][places[to][1]] = places[source][0][places[source][1]] * factor

    def _seen(self, places: Mapping[Port, tuple[Array, int]]) -> Array:
        """Return what is recorded as it stands, in the units of the bus."""
        return np.array(
            [places[port][0][places[port][1]] * self._worth(port) for port in self.bus.record],
            dtype=float,
        )

    def _write_row(self, k: int, places: Mapping[Port, tuple[Array, int]]) -> None:
        self.values[k, ~self.averaged] = self._seen(places)[~self.averaged]

    # -- the end -----------------------------------------------------------------------------------

    def _blame(self, unit: str, time: float, why: str) -> Failure:
        """Return why a unit failed so long after the start: what it said, or the unit that gave it
        a number which is none.
        """
        when = self.bus.start + time
        for (source, name), (to, variable) in self.bus.links:
            array, index = self.nodes[to].place(variable)
            if to == unit and not np.isfinite(array[index]):
                return Failure(
                    source, when, f"its output {name} is {array[index]}, which {unit} refused"
                )
        said = self.nodes[unit].slave.last_message()
        return Failure(unit, when, why if said == "no message" else f"{why}: {said}")

    def _diverged(self, first: int, last: int) -> Failure | None:
        """Look for an estimate beyond all bounds in rows first .. last - 1."""
        columns = [i for i, (unit, _) in enumerate(self.bus.record) if unit in self.bus.watch]
        if not columns or last <= first:
            return None
        beyond = np.abs(self.values[first:last, columns]) > HUGE
        rows = np.flatnonzero(beyond.any(axis=1))
        if not len(rows):
            return None
        return self._beyond(first + int(rows[0]), columns[int(np.argmax(beyond[rows[0]]))])

    def _beyond(self, row: int, column: int) -> Failure:
        unit, name = self.bus.record[column]
        return Failure(
            unit, float(self.bus.start + row * self.bus.h), f"|{name}| is beyond {HUGE:g}"
        )

    def _trace(self, time: float, failure: Failure | None = None) -> Trace:
        rows, self._sound = round(time / self.bus.h) + 1, failure is None
        flags = Readings.of(self.bus.flags, self._looks)
        return Trace(
            self.bus.record, self.values[:rows], self.bus.h, flags, failure, self.bus.start
        )


def simulate(
    bus: Bus,
    progress: Progress | None = None,
    *,
    engine: str | None = None,
    control: NDArray[np.int64] | None = None,
    slaves: Slaves | None = None,
) -> Trace:
    """Run a bus in this process.

    Parameters
    ----------
    bus : Bus
        What to run.
    progress : callable, optional
        Called with the number of steps done.
    engine : str, optional
        ``native`` for the compiled loop, ``fmpy`` for FMPy's calls; by default compiled if there is
        a compiler.
    control : ndarray of int64, shape (CONTROL_SIZE,), optional
        Shared memory: [0] counts the steps done, [1] not 0 stops the run, [2] and [3] tell which
        call is under way.
    slaves : Slaves, optional
        Loaded FMUs, which are used again and stay loaded.
    """
    with Session(bus, control, slaves) as session:
        return (
            session.run(progress)
            if (engine or default_engine()) == "native"
            else session.run_fmpy(progress)
        )


def default_engine() -> str:
    """Return ``native`` where the compiled loop can be had, else ``fmpy``."""
    return "native" if native_available() else "fmpy"


class Drive:
    """One FMI 2 instance of an FMU, run over the same recorded input for many sets of parameters.

    Parameters
    ----------
    fmu : Fmu
        FMI 2, Co-Simulation.
    inputs, outputs, parameters : sequence of str
        Names, all Real.
    """

    def __init__(
        self, fmu: Fmu, inputs: Sequence[str], outputs: Sequence[str], parameters: Sequence[str]
    ) -> None:
        self._slave = Slave(fmu, "drive")
        self.control = np.zeros(2, dtype=np.int64)
        try:
            self._node = Node(self._slave, inputs, outputs)
            self._slave.initialise({})
            self._unit = self._node.structure()
            functions = (
                "fmi2Reset",
                "fmi2SetupExperiment",
                "fmi2EnterInitializationMode",
                "fmi2ExitInitializationMode",
            )
            self._lifecycle = Lifecycle(*map(self._slave.address, functions))
            self._vr = np.array([fmu.reference(name) for name in parameters], dtype=np.uint32)
        except BaseException:
            self.close()
            raise

    def run(self, series: Array, sets: Array, h: float) -> Array:
        """Return the outputs, shape (sets, steps + 1, outputs), for input `series` of shape (steps,
        inputs).

        What could not be simulated is NaN. The interpreter lock is released, so threads share the
        processors.
        """
        series, sets = (
            np.ascontiguousarray(series, dtype=float),
            np.ascontiguousarray(sets, dtype=float),
        )
        if series.shape[1] != len(self._node.inputs) or sets.shape[1] != len(self._vr):
            raise ValueError(
                f"got {series.shape[1]} inputs and {sets.shape[1]} parameters, "
                f"expected {len(self._node.inputs)} and {len(self._vr)}"
            )
        out = np.empty((len(sets), len(series) + 1, len(self._node.outputs)))
        library().loop_drive(
            ctypes.byref(self._unit),
            ctypes.byref(self._lifecycle),
            ctypes.c_longlong(len(series)),
            ctypes.c_double(h),
            ctypes.c_void_p(pointer(series)),
            ctypes.c_longlong(len(sets)),
            ctypes.c_longlong(len(self._vr)),
            ctypes.c_void_p(pointer(self._vr)),
            ctypes.c_void_p(pointer(sets)),
            ctypes.c_void_p(pointer(out)),
            ctypes.c_void_p(pointer(self.control)),
        )
        return out

    def close(self) -> None:
        """Free the instance."""
        self._slave.close()
