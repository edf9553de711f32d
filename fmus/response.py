"""One FMU alone over given inputs, in a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bristle.fmus.calls import Control
from bristle.fmus.host import Fmu, Slave
from bristle.fmus.isolate import isolated

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Task:
    fmu: Fmu
    h: float
    steps: int
    inputs: Mapping[str, Array]
    outputs: tuple[str, ...]
    start: float


def respond(
    fmu: Fmu,
    h: float,
    steps: int,
    inputs: Mapping[str, Array],
    outputs: Sequence[str],
    *,
    start: float = 0.0,
) -> Array:
    """Return the outputs of an FMU, shape (steps + 1, outputs): after initialisation, and after
    each step.

    Parameters
    ----------
    fmu : Fmu
        Co-Simulation.
    h, steps : float, int
        Communication step [s], and their number.
    inputs : mapping of str to ndarray, shape (steps,)
        Values of Real inputs from the start of each step; the others keep their start values.
    outputs : sequence of str
        Real outputs.
    start : float
        Time of the first step [s].

    Raises
    ------
    BristleError
        If it cannot be simulated; the message names the FMU.
    """
    task = _Task(fmu, h, steps, inputs, tuple(outputs), start)
    shown: Array = isolated(_simulated, task, [fmu.path], np.asarray)
    return shown


def _simulated(task: _Task, control: Control) -> Array:
    """Do it, in the child process."""
    three = task.fmu.fmi == 3
    with Slave(task.fmu, "alone") as slave:
        slave.initialise({}, task.start)
        instance = slave.instance
        put: Callable[[Sequence[int], list[float]], None] = (
            instance.setFloat64 if three else instance.setReal
        )
        get: Callable[[Sequence[int]], list[float]] = (
            instance.getFloat64 if three else instance.getReal
        )
        into, out = (
            [task.fmu.reference(name) for name in names] for names in (task.inputs, task.outputs)
        )
        rows = np.column_stack([*task.inputs.values()]).tolist() if task.inputs else []
        shown = np.empty((task.steps + 1, len(out)))
        shown[0] = get(out) if out else []
        for k in range(task.steps):
            if into:
                put(into, rows[k])
            instance.doStep(task.start + k * task.h, task.h)
            shown[k + 1] = get(out) if out else []
            control[0] = k
    return shown
