"""Several runs of one scenario in step, each in a lane of the processor's vectors: the compiled
loop over the programs of the FMUs.

The digits are those of the FMUs. A run in which anything is out of the ordinary (a step that an FMU
would refuse, an estimate beyond all bounds) gives no trace here: it is made again alone, with its
FMUs, which say what happened.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from bristle.common.errors import BristleError
from bristle.fmus.calls import Control
from bristle.fmus.lanes import TIMING, Lanes, lanes_of
from bristle.harness.cosim.bus import Array, Bus, BusTrace, Port, Readings
from bristle.harness.cosim.compiled import Compiled, LoopUnit, Memory, library
from bristle.harness.cosim.ports import PORTS
from bristle.harness.scenario.plan import RunSetup

MOST_LANES = 8  # of the processors that are known
RUNS_WORTH_IT = 100  # fewer runs take less time than the programs, which are made once a process


def alike(bus: Bus) -> tuple[object, ...]:
    """Return what the buses of runs in step have in common."""
    timing = tuple(instance.values.get(name) for instance in bus.instances for name in TIMING)
    return bus.steps, bus.h, bus.start, bus.links, tuple(bus.series), bus.record, bus.flags, timing


class Together:
    """The programs behind the FMUs of a scenario, in lanes, for one thread: `run` may be called
    again and again.

    Parameters
    ----------
    setup : RunSetup
        Whose FMUs are bristle's own, compiled ones.

    Raises
    ------
    BristleError
        If one is not, or this machine has no compiler.
    """

    def __init__(self, setup: RunSetup) -> None:
        if any(fmu.risky for fmu in setup.fmus.values()):
            raise BristleError("an FMU from elsewhere, or in Python, runs alone")
        library()
        self.lanes = {name: _lanes(setup, name) for name in setup.fmus}
        self.width = next(iter(self.lanes.values())).width
        self._values: Array = np.empty((0, 0, 0))

    def run(self, buses: Sequence[Bus], control: Control) -> list[BusTrace | None]:
        """Run buses that are `alike`, at most as many as there are lanes.

        Returns
        -------
        list of Trace or None
            Of each bus, None where it must be run alone. Their values hold until the next call.
        """
        # lanes left over repeat the last run
        bus, full = buses[0], [*buses, *[buses[-1]] * (self.width - len(buses))]
        for instance in bus.instances:
            self._start(instance.name, full)
        shape = (len(full), bus.steps + 1, len(bus.record))
        if self._values.shape != shape:
            self._values = np.empty(shape)
        units = [instance.name for instance in bus.instances]
        structures = (LoopUnit * len(units))(*(_unit(self.lanes[name]) for name in units))

        def flag(port: Port, lane: int) -> tuple[int, int, int]:
            return units.index(port[0]), self.lanes[port[0]].reference(port[1], lane), 0

        # all lanes in one loop; a lane that failed is left to a run of its own
        compiled = Compiled(
            full, Memory(structures, self._address, lambda _port: 1.0, flag, self._values), control
        )
        rows = compiled.run() + 1
        sound = [
            all(self.lanes[name].alive(k) for name in units) and not compiled.diverged(k)
            for k in range(len(buses))
        ]
        return [
            BusTrace(
                bus.record,
                self._values[k, :rows],
                bus.h,
                Readings(bus.flags, *compiled.flags(k)),
                None,
                bus.start,
            )
            if sound[k]
            else None
            for k in range(len(buses))
        ]

    def _start(self, name: str, buses: Sequence[Bus]) -> None:
        """Initialise the lanes of a unit."""
        bus, lanes = buses[0], self.lanes[name]
        instances = [next(each for each in bus.instances if each.name == name) for bus in buses]
        driven = [
            *(to for _, to in bus.links),
            *(to for each in buses for _, to, _ in each.events),
            *bus.series,
        ]
        inputs = dict.fromkeys(variable for unit, variable in driven if unit == name)
        limits = {variable: _finite(instances[0].fmu.interval(variable)) for variable in inputs}
        values = [
            {key: float(value) for key, value in each.values.items() if key in lanes.program.index}
            for each in instances
        ]
        lanes.initialise(values, bus.start, limits)

    def _address(self, port: Port, lane: int) -> int:
        return self.lanes[port[0]].place(port[1], lane)


def _lanes(setup: RunSetup, name: str) -> Lanes:
    """Return lanes of the program of one FMU, of the chosen law or method alone."""
    part = getattr(setup.scenario, name)
    variant = getattr(part, PORTS[name].selector, None)
    return lanes_of(name, variant, getattr(part, "effects", ()))


def _unit(lanes: Lanes) -> LoopUnit:
    """Return what the compiled loop needs: its variables are read and set where they are, so a step
    is all it calls.
    """
    get, step = lanes.function("lanes_get"), lanes.function("lanes_step")
    return LoopUnit(lanes.address, 0, get, 0, 0, step, 2, 0, 0, 0, 0, 0, 0, 0, 0)


def _finite(interval: tuple[float, float]) -> tuple[float, float]:
    return max(interval[0], -sys.float_info.max), min(interval[1], sys.float_info.max)
