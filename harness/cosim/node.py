"""Loaded FMUs: the memory of their inputs and outputs, and FMUs that stay loaded between runs."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bristle.fmus.host import Slave
from bristle.harness.cosim.bus import Array, BusUnit
from bristle.harness.cosim.compiled import (
    LoopUnit,
    pointer,
)


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

    def structure(self) -> LoopUnit:
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
        return LoopUnit(
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

    def take(self, instance: BusUnit) -> Slave:
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
