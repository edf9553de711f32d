"""A program compiled and simulated inside this process."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from bristle.common.cache import cached, digest
from bristle.common.errors import BristleError, SimulationError
from bristle.model.compiler import FLAGS, SUFFIX, compile_shared, compiler_identity
from bristle.model.program import Program
from bristle.model.sources import c_sources, fingerprint

__all__ = ["Native"]

Array = NDArray[np.float64]


def pointer(array: NDArray[np.generic] | None) -> ctypes.c_void_p | None:
    """Return the address of an array's first element, as C functions take it."""
    return None if array is None else array.ctypes.data_as(ctypes.c_void_p)


def compile_program(program: Program) -> ctypes.CDLL:
    """Compile a program (or take it from the cache) and load it."""
    batch = (files("bristle.model") / "c" / "batch.c").read_text(encoding="utf-8")
    key = digest(*FLAGS, compiler_identity(), batch, *fingerprint(program))
    name = f"{program.name}-{key[:24]}{SUFFIX}"
    path = cached(name, lambda out: compile_shared(c_sources(program) | {"batch.c": batch}, out))
    library = ctypes.CDLL(str(path))
    library.batch_run.restype = library.batch_steps.restype = ctypes.c_longlong
    library.batch_message.restype = ctypes.c_char_p
    return library


class Native:
    """One instance of a compiled program.

    Parameters
    ----------
    program : Program
        What to simulate.
    variant : str, optional
        Name of the system; by default the one that the program chooses.
    parameters : mapping of str to float
        Values of parameters and start values of inputs, SI; checked against their intervals.
    """

    def __init__(
        self,
        program: Program,
        parameters: Mapping[str, float] | None = None,
        variant: str | None = None,
    ) -> None:
        self.program, self.library = program, compile_program(program)
        self.core = ctypes.create_string_buffer(self.library.batch_size() + 64)
        names = [a.system.name for a in program.variants]
        if variant is not None and variant not in names:
            raise BristleError(
                f"'{variant}' is no variant of {program.name}; known: {', '.join(names)}"
            )
        self.variant = program.variants[names.index(variant) if variant else program.chosen]
        self._v = np.array(program.starts)
        if program.selector:
            self._v[program.index[program.selector]] = names.index(self.variant.system.name) + 1
        for name, value in (parameters or {}).items():
            if name in self.variant.system.parameters:
                self.variant.system.parameters[name].check(value)
            elif name not in self.variant.system.inputs:
                known = ", ".join([*self.variant.system.parameters, *self.variant.system.inputs])
                raise BristleError(
                    f"'{name}' is no parameter of {program.name} ({self.variant.system.name});"
                    f" known: {known}"
                )
            self._v[program.index[name]] = value
        self.reset()

    def twin(self) -> Native:
        """Return another instance of the same compiled program, with its own state: both may run at
        the same time.
        """
        other = copy(self)
        other.core = ctypes.create_string_buffer(len(self.core))
        other.reset()
        return other

    def reset(self, time: float = 0.0) -> None:
        """Set all states to their start values."""
        self.initialise(self._v, time)

    def initialise(self, values: Array, time: float = 0.0) -> None:
        """Replace parameters, inputs and time by those of a variable table and set all states to
        their start values.
        """
        self._check(
            self.library.batch_initialise(self.core, pointer(values), ctypes.c_double(time)), time
        )

    def _check(self, code: int, time: float) -> None:
        if code:
            raise SimulationError(
                f"{self.program.name} at {time:g} s: {self.library.batch_message(code).decode()}",
                time,
            )

    @property
    def steps(self) -> int:
        """Internal steps taken since the last reset."""
        return int(self.library.batch_steps(self.core))

    @property
    def values(self) -> Array:
        """The whole variable table."""
        v = np.empty(len(self.program.slots))
        self.library.batch_read(self.core, pointer(v))
        return v

    def write(self, values: Array) -> None:
        """Replace the whole variable table."""
        self.library.batch_write(self.core, pointer(np.ascontiguousarray(values, dtype=float)))

    def advance(self, h: float) -> None:
        """Do one communication step."""
        self._check(
            self.library.batch_advance(self.core, ctypes.c_double(h)), float(self.values[0])
        )

    @cached_property
    def _sensitivity_shape(self) -> tuple[int, int]:
        return len(self.variant.states), len(self.program.sensitivities)

    def run(
        self,
        h: float,
        inputs: Mapping[str, Array],
        record: Sequence[str],
        sensitivities: bool = False,
    ) -> tuple[Array, Array | None]:
        """Simulate as many steps of length h as the inputs have values, from the present state.

        Returns
        -------
        record : ndarray, shape (n + 1, len(record))
            The named variables at the start of each step and at the end.
        sensitivities : ndarray, shape (n + 1, states, parameters), or None
            Derivatives of the continuous states by the program's chosen parameters, exact for the
            steps taken where no mode switches. A switch is located to `solver.tolerance` and its
            derivative taken as if the step ended there: those of gms and leuven hold to about 1e-6
            at the default tolerance, and are off by tens of percent at 1e-2. Start values are taken
            as independent of the parameters.

        Raises
        ------
        SimulationError
            If the simulation cannot go on; its `time` is where it stopped.
        """
        table = (
            np.column_stack([np.asarray(x, dtype=float) for x in inputs.values()])
            if inputs
            else np.empty((0, 0))
        )
        n, index = len(table), self.program.index
        places = np.array([index[name] for name in inputs], dtype=np.int32)
        recorded = np.array([index[name] for name in record], dtype=np.int32)
        out = np.empty((n + 1, len(record)))
        sens = np.empty((n + 1, *self._sensitivity_shape)) if sensitivities else None
        code = ctypes.c_int(0)
        done = self.library.batch_run(
            self.core,
            ctypes.c_longlong(n),
            ctypes.c_double(h),
            len(places),
            pointer(places),
            pointer(np.ascontiguousarray(table)),
            len(recorded),
            pointer(recorded),
            pointer(out),
            pointer(sens),
            ctypes.byref(code),
        )
        self._check(code.value, done * h)
        return out, sens

    def rates(self) -> Array:
        """Return x' at the present state, for smooth systems."""
        dx = np.empty(len(self.variant.states))
        self._check(self.library.batch_rates(self.core, pointer(dx)), float(self.values[0]))
        return dx
