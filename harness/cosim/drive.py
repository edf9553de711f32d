"""One FMU over a recorded input, for many sets of its parameters."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from bristle.fmus.host import Fmu, Slave
from bristle.harness.cosim.bus import Array
from bristle.harness.cosim.compiled import (
    Lifecycle,
    library,
    pointer,
)
from bristle.harness.cosim.node import Node


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
