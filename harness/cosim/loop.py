"""Co-simulation of FMUs over a bus, step by step, and one FMU over a recorded input.

Timing: all units see the bus as it stood at the start of a step (Jacobi). What a unit publishes at
t_k+1 was computed from the bus of t_k. For comparison, `Bus.sequential` lets each unit see what
those before it have just published (Gauss-Seidel), and `Bus.split` makes several communication
steps of each row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bristle.fmus.calls import CONTROL_SIZE, WATCH, Call
from bristle.fmus.host import Slave
from bristle.harness.cosim.bus import (
    Array,
    Bus,
    BusTrace,
    BusUnit,
    Failure,
    Port,
    Progress,
    Readings,
)
from bristle.harness.cosim.compiled import (
    HUGE,
    Compiled,
    LoopUnit,
    Memory,
    native_available,
    pointer,
)
from bristle.harness.cosim.node import Node, Slaves

STATUS = {2: "Discard", 3: "Error", 4: "Fatal", 5: "Pending"}  # of FMI; 0 and 1 are no failures
CALLED = ("setting its inputs", "doStep", "reading its outputs")


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

    def _node(self, instance: BusUnit) -> Node:
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

    def run(self, progress: Progress | None = None) -> BusTrace:
        """Run all steps in the compiled loop, in several calls, so that Python can look after the
        user between them.
        """
        bus, names = self.bus, list(self.nodes)
        units = (LoopUnit * len(names))(*(node.structure() for node in self.nodes.values()))
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

    def run_fmpy(self, progress: Progress | None = None) -> BusTrace:
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
            # what comes from outside, then the steps of the row, then what is recorded of it
            while events and events[0][0] <= k:
                _, port, value = events.pop(0)
                self._set(port, value)
            for port, values in bus.series.items():
                self._set(port, values[k])
            failure = self._row_fmpy(k, places)
            if failure is not None:
                return self._trace(k * bus.h, failure)
            k += 1
            self._write_row(k, places)
            self.control[0] = k
            # now and then: has an estimate diverged, what do the flags say
            if k % bus.chunk == 0 or k == bus.steps:
                early = self._diverged(max(1, k - bus.chunk + 1), k + 1)
                if early is not None:
                    return self._trace(early.time - bus.start, early)
                self._look(k)
                if progress:
                    progress(k)
        return self._trace(k * bus.h)

    def _set(self, port: Port, value: float) -> None:
        """Give an input a value in the unit of the bus."""
        array, index = self.nodes[port[0]].place(port[1])
        array[index] = value / self._worth(port)

    def _row_fmpy(self, k: int, places: Mapping[Port, tuple[Array, int]]) -> Failure | None:
        """Do the communication steps of one row, and take their means; return why one failed."""
        parts = self.bus.split
        for part in range(parts):
            failure = self._step_fmpy(k * parts + part, places)
            if failure is not None:
                return failure
            if self.averaged.any():
                self.values[k + 1, self.averaged] += self._seen(places)[self.averaged] / parts
        return None

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

    def _trace(self, time: float, failure: Failure | None = None) -> BusTrace:
        rows, self._sound = round(time / self.bus.h) + 1, failure is None
        flags = Readings.of(self.bus.flags, self._looks)
        return BusTrace(
            self.bus.record, self.values[:rows], self.bus.h, flags, failure, self.bus.start
        )


def simulate(
    bus: Bus,
    progress: Progress | None = None,
    *,
    engine: str | None = None,
    control: NDArray[np.int64] | None = None,
    slaves: Slaves | None = None,
) -> BusTrace:
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
