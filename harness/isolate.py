"""Co-simulation in a process of its own, for FMUs from elsewhere: if one crashes, only that process ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bristle.fmus.isolate import isolated
from bristle.harness.loop import Bus, Progress, Trace, simulate


def simulate_isolated(bus: Bus, progress: Progress | None = None, *, engine: str | None = None) -> Trace:
    """Run a bus in a child process.

    Raises
    ------
    BristleError
        If the child dies (which FMU is not known, hence all foreign ones are named) or refuses the bus.
    """
    foreign = [instance.fmu.path for instance in bus.instances if instance.fmu.foreign]
    return isolated(_simulate, (bus, engine), foreign, progress)


def _simulate(asked: tuple[Bus, str | None], control: NDArray[np.int64]) -> Trace:
    bus, engine = asked
    return simulate(bus, engine=engine, control=control)
