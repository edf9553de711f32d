"""The body of a pythonfmu FMU: the twin of c/instance.c around the twin of the C core.

A copy of this file lies in every such FMU, beside a copy of model/runtime.py and the generated
tables.
"""

from __future__ import annotations

import ctypes
import functools
import json
import math
import zlib
from collections.abc import Callable, Sequence
from typing import Any

from pythonfmu import Fmi2Slave

from bristle.model.runtime import Core, CoreError

POINT_TOLERANCE = 1e-6  # of a step: how far a communication point may be from where the instance is
TIME_ROUNDING = 1e-13  # relative: what adding up steps costs


class RefusedError(RuntimeError):
    """A call, a value or a step is not acceptable; pythonfmu makes an FMI error of it."""


def _guarded(method: Callable[..., Any]) -> Callable[..., Any]:
    """Keep the instance alive when the method raises: pythonfmu 0.7 then drops it, and again when
    it is freed.
    """

    @functools.wraps(method)
    def call(self: PythonSlave, *arguments: Any) -> Any:
        try:
            return method(self, *arguments)
        except Exception:
            for dropped in (self, type(self), self.log_queue):
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(dropped))
            raise

    return call


class PythonSlave(Fmi2Slave):  # type: ignore[misc]  # pythonfmu has no types
    """One instance; a subclass names the FMU and gives the generated tables."""

    tables: Any = None  # START, CHOICE, VARIANTS, TOKEN, VARIABLES

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.core = Core(self.tables)
        self.mode = "instantiated"
        self.stop = math.inf
        self.stale = False

    # -- the state machine -------------------------------------------------------------------------

    def _require(self, *modes: str) -> None:
        if self.mode not in modes:
            raise RefusedError(f"not allowed while the instance is in mode '{self.mode}'")

    @_guarded
    def setup_experiment(
        self, start_time: float, stop_time: float | None, tolerance: float | None
    ) -> None:
        self._require("instantiated")
        if not math.isfinite(start_time):
            raise RefusedError("the start time must be finite")
        if stop_time is not None and not (math.isfinite(stop_time) and stop_time >= start_time):
            raise RefusedError("the stop time must be finite and not before the start")
        self.core.v[0] = start_time
        self.stop = math.inf if stop_time is None else stop_time

    @_guarded
    def enter_initialization_mode(self) -> None:
        self._require("instantiated")
        self.mode, self.stale = "initialization", True

    @_guarded
    def exit_initialization_mode(self) -> None:
        self._require("initialization")
        self._refresh()
        self.mode = "step"

    @_guarded
    def terminate(self) -> None:
        self._require("step")
        self.mode = "terminated"

    def _refresh(self) -> None:
        """Compute what waits for being asked for."""
        if self.stale and self.mode == "initialization":
            self._check_choice()
            self.core.initialise(self.core.v[0])
        elif self.stale:
            self.core.outputs()
        self.stale = False

    def _check_choice(self) -> None:
        """Refuse an index outside its interval, or one that contradicts the enumeration."""
        selector, place, _ = self.tables.CHOICE
        if selector < 0:
            return
        chosen, index, most = (
            int(self.core.v[selector]),
            int(self.core.v[place]),
            len(self.tables.VARIANTS),
        )
        name, enumeration = self._variable(place)[0], self._variable(selector)[0]
        if not 0 <= index <= most:
            raise RefusedError(f"{name} = {index} is outside [0, {most}]; 0: as {enumeration} says")
        if index and chosen not in (self.tables.START[selector], index):
            raise RefusedError(
                f"{name} = {index} contradicts {enumeration} = {chosen}; set one of the two"
            )

    # -- variables ---------------------------------------------------------------------------------

    def _get(self, references: Sequence[int], *kinds: str) -> list[float]:
        self._require("initialization", "step", "terminated", "failed")
        self._refresh()
        for reference in references:
            if self._variable(reference)[1] not in kinds:
                raise RefusedError(f"{self._variable(reference)[0]} is of another type")
        return [self.core.v[reference] for reference in references]

    def _variable(self, reference: int) -> tuple[str, str, str, float, float]:
        if reference not in self.tables.VARIABLES:
            raise RefusedError(f"no variable has value reference {reference}")
        found: tuple[str, str, str, float, float] = self.tables.VARIABLES[reference]
        return found

    def _check(self, reference: int, value: float, kinds: Sequence[str]) -> None:
        name, own_kind, settable, low, high = self._variable(reference)
        if own_kind not in kinds:
            raise RefusedError(f"{name} is of another type")
        if settable == "never":
            raise RefusedError(f"{name} is computed and cannot be set")
        if settable == "start" and self.mode == "step":
            raise RefusedError(f"{name} is a fixed parameter; set it before initialization ends")
        if not (math.isfinite(value) and low <= value <= high):
            raise RefusedError(f"{name} = {value!r} is outside [{low:g}, {high:g}]")

    def _set(self, references: Sequence[int], values: Sequence[float], *kinds: str) -> None:
        self._require("instantiated", "initialization", "step")
        for reference, value in zip(references, values, strict=True):
            self._check(reference, value, kinds)
        for reference, value in zip(references, values, strict=True):
            self.core.v[reference] = float(value)
        self.stale = True

    @_guarded
    def get_real(self, vrs: Sequence[int]) -> list[float]:
        return self._get(vrs, "Real")

    @_guarded
    def get_integer(self, vrs: Sequence[int]) -> list[int]:
        return [int(value) for value in self._get(vrs, "Enumeration", "Integer")]

    @_guarded
    def get_boolean(self, vrs: Sequence[int]) -> list[bool]:
        return [bool(value) for value in self._get(vrs, "Boolean")]

    @_guarded
    def get_string(self, vrs: Sequence[int]) -> list[str]:
        self._get(vrs, "String")
        return []

    @_guarded
    def set_real(self, vrs: Sequence[int], values: Sequence[float]) -> None:
        self._set(vrs, values, "Real")

    @_guarded
    def set_integer(self, vrs: Sequence[int], values: Sequence[int]) -> None:
        self._set(vrs, values, "Enumeration", "Integer")

    @_guarded
    def set_boolean(self, vrs: Sequence[int], values: Sequence[bool]) -> None:
        self._set(vrs, values, "Boolean")

    @_guarded
    def set_string(self, vrs: Sequence[int], values: Sequence[str]) -> None:
        for reference in vrs:
            self._check(reference, math.nan, ("String",))

    # -- steps -------------------------------------------------------------------------------------

    def _check_step(self, point: float, h: float) -> None:
        time, slack = self.core.v[0], POINT_TOLERANCE * h + TIME_ROUNDING * abs(self.core.v[0])
        self._require("step")
        if not (math.isfinite(h) and h > 0.0):
            raise RefusedError(f"the step size must be finite and greater than 0, not {h!r}")
        if not abs(point - time) <= slack:
            raise RefusedError(
                f"the communication point is {point!r} s, but the instance is at {time!r} s"
            )
        if not point + h > point:
            raise RefusedError(f"the step size {h!r} is too small to change the time {point!r}")
        if not point + h <= self.stop + slack:
            raise RefusedError(f"the step would go beyond the stop time {self.stop!r}")

    @_guarded
    def do_step(self, current_time: float, step_size: float) -> bool:
        self._check_step(current_time, step_size)
        before = self.core.snapshot()
        self.core.v[0] = current_time
        try:
            self.core.advance(step_size)
        # the last two: Python's own for overflow and NaN
        except (CoreError, ArithmeticError, ValueError) as error:
            self.core.restore(before)
            self.mode, self.stale = "failed", True
            raise RefusedError(
                f"{error} (at {current_time!r} s, step size {step_size!r} s)"
            ) from None
        self.stale = False
        return True

    # -- states of the whole instance --------------------------------------------------------------

    @_guarded
    def _get_fmu_state(self) -> dict[str, Any]:
        return {
            "token": self.tables.TOKEN,
            "core": self.core.snapshot(),
            "mode": self.mode,
            "stop": self.stop,
            "stale": self.stale,
        }

    @_guarded
    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        if state.get("token") != self.tables.TOKEN:
            raise RefusedError("the bytes are no state of this FMU, or damaged")
        self.core.restore(state["core"])
        self.mode, self.stop, self.stale = state["mode"], state["stop"], state["stale"]

    @staticmethod
    def _fmu_state_to_bytes(state: dict[str, Any]) -> bytes:
        text = json.dumps(state).encode()
        return b"%08x" % zlib.crc32(text) + text

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> dict[str, Any]:
        """Return the state; damaged bytes give one that cannot be set, for here is no instance that
        could refuse them.
        """
        if state[:8] != b"%08x" % zlib.crc32(state[8:]):
            return {}
        found: dict[str, Any] = json.loads(state[8:])
        return found
