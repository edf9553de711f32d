"""Simulate a plant FMU over measured inputs: segment by segment, each from a given state, or over
whole records.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError, RestartError
from bristle.fmus.calls import WATCH, Call, Control
from bristle.fmus.host import Fmu, Slave
from bristle.fmus.isolate import isolated

Array = NDArray[np.float64]

INPUT = "u"
TRIAL_STEPS = 8  # steps that must be equal after a restart
REPEAT_TOLERANCE = 1e-9  # largest relative difference between these repetitions
START_TOLERANCE = 0.1  # largest relative error with which a start value may set its output
RESTART_WAYS = {
    "reset": "reset",
    "snapshot": "restored to a snapshot of the state before initialisation",
    "again": "instantiated again",
}


@dataclass(frozen=True)
class ReplaySegment:
    """Inputs (n,) held over n steps from a time [s] on, and the start values by variable name."""

    time: float
    u: Array
    start: Mapping[str, float]


@dataclass(frozen=True)
class Replay:
    """A simulation task: `outputs` by name, step h [s], segments; `start_variables` are those that
    set the start of outputs.
    """

    fmu: Fmu
    h: float
    segments: tuple[ReplaySegment, ...]
    outputs: tuple[str, ...]
    start_variables: Mapping[str, str]


@dataclass(frozen=True)
class ReplayResult:
    """Outputs of each segment (n, len(outputs)) before each step, and the way of restarting."""

    outputs: tuple[Array, ...]
    way: str


def start_variable(fmu: Fmu, name: str) -> str | None:
    """Return the variable that sets where output `name` starts: a parameter name_start, or the
    output's own start value.
    """
    if fmu.has(f"{name}_start", "parameter") and fmu.is_real(f"{name}_start"):
        return f"{name}_start"
    own = fmu.variables.get(name)
    return (
        name
        if own is not None and fmu.is_real(name) and own.initial in ("exact", "approx")
        else None
    )


def replay_segments(
    task: Replay, progress: Callable[[int], None] | None = None, timeout: float | None = None
) -> ReplayResult:
    """Replay all segments in a child process, the FMU restarted for each; `progress` is called with
    the number done.

    It may take `timeout` seconds.

    Raises
    ------
    RestartError
        If the FMU cannot be started from given states.
    BristleError
        If it crashes, takes too long or refuses a step.
    """
    answer = isolated(_segments, task, [task.fmu.path], _replayed, progress, timeout)
    if isinstance(answer, str):
        raise RestartError(answer)
    return answer


def _replayed(answer: Any) -> ReplayResult | str:
    return (
        str(answer["reason"])
        if "reason" in answer
        else ReplayResult(tuple(map(_series, answer["outputs"])), str(answer["way"]))
    )


def _series(answer: Any) -> Array:
    return np.asarray(answer, dtype=float)


def replay_records(task: Replay, timeout: float | None = None) -> ReplayResult:
    """Replay each segment in a process of its own, so that no restart is needed; each may take
    `timeout` seconds.

    Errors are those of `replay_segments`.
    """
    paths = [task.fmu.path]
    return ReplayResult(
        tuple(
            isolated(_whole, (task, segment), paths, _series, None, timeout)
            for segment in task.segments
        ),
        "",
    )


# -- in the child process --------------------------------------------------------------------------


def _segments(task: Replay, control: Control) -> dict[str, Any]:
    player = _Replayer(task)
    try:
        player.choose_restart()
        outputs = []
        for k, segment in enumerate(task.segments):
            player.begin(segment.time, segment.start)
            outputs.append(player.run(segment))
            control[0] = k + 1
        return {"outputs": outputs, "way": RESTART_WAYS[player.way]}
    except RestartError as error:
        return {"reason": str(error)}
    finally:
        player.close()


def _whole(work: tuple[Replay, ReplaySegment], control: Control) -> Array:
    task, segment = work
    player = _Replayer(task)
    try:
        player.begin(segment.time, segment.start)
        return player.run(segment)
    finally:
        player.close()


class _Replayer:
    """An instance of the FMU, and the way in which it is restarted."""

    def __init__(self, task: Replay) -> None:
        self.task, fmu = task, task.fmu
        self._slave = Slave(fmu, "plant")
        self._fresh = True
        self._in = [fmu.reference(INPUT)]
        self._out = [fmu.reference(name) for name in task.outputs]
        self._snapshot = self._take() if fmu.description.coSimulation.canGetAndSetFMUstate else None
        self.way = "reset"

    def _take(self) -> Any:
        with suppress(Exception):  # FMPy raises plain exceptions for an error status of the FMU
            instance = self._slave.instance
            return instance.getFMUState() if self.task.fmu.fmi == 3 else instance.getFMUstate()
        return None

    def ways(self) -> Iterator[str]:
        """Give the ways to restart, the cheapest first."""
        yield "reset"
        if self._snapshot is not None:
            yield "snapshot"
        if not self.task.fmu.description.coSimulation.canBeInstantiatedOnlyOncePerProcess:
            yield "again"

    def _renew(self) -> None:
        instance = self._slave.instance
        if self.way == "reset":
            instance.reset()
        elif self.way == "snapshot":
            (instance.setFMUState if self.task.fmu.fmi == 3 else instance.setFMUstate)(
                self._snapshot
            )
        else:
            self._snapshot = None  # it belongs to the old instance
            self._slave.close()
            self._slave = Slave(self.task.fmu, "plant")

    def begin(self, time: float, start: Mapping[str, float]) -> None:
        """Initialise with start values, at a time [s]."""
        if not self._fresh:
            self._renew()
        self._fresh = False
        self._slave.initialise(start, time)

    def run(self, segment: ReplaySegment) -> Array:
        """Return the outputs (n, len(outputs)) before each step."""
        outputs = np.array([self._shown(), *self._steps(segment, len(segment.u) - 1)])
        bad = np.argwhere(~np.isfinite(outputs))
        if len(bad):
            k, j = bad[0]
            shown, time = (
                f"{self.task.outputs[j]} is {outputs[k, j]}",
                segment.time + k * self.task.h,
            )
            raise BristleError(
                f"FMU {self.task.fmu.path}: output {shown} at {time:.6g} s, not a finite number;"
                " check how it treats its inputs"
            )
        return outputs

    def _steps(self, segment: ReplaySegment, n: int) -> Iterator[list[float]]:
        instance, h, three = self._slave.instance, self.task.h, self.task.fmu.fmi == 3
        put, worth = instance.setFloat64 if three else instance.setReal, self.task.fmu.factor(INPUT)
        for k, u in enumerate(segment.u[:n].tolist()):
            time = segment.time + k * h
            WATCH.begin(self.task.fmu.path, Call.step)
            try:
                put(self._in, [u / worth])
                ended = instance.doStep(time, h)
                if three and any(ended[1:3]):
                    raise RuntimeError("it requested the end of the simulation")
                yield self._shown()
            except Exception as error:  # FMPy raises plain exceptions of several kinds
                said = self._slave.last_message()
                why = " ".join(str(error).split()) if said == "no message" else said
                raise BristleError(
                    f"FMU {self.task.fmu.path}: refused the step of {h:g} s at {time:.6g} s: {why};"
                    " check its step sizes and input ranges, or resample the record"
                ) from None

    def _shown(self) -> list[float]:
        instance = self._slave.instance
        values = (instance.getFloat64 if self.task.fmu.fmi == 3 else instance.getReal)(self._out)
        return [
            value * self.task.fmu.factor(name)
            for value, name in zip(values, self.task.outputs, strict=True)
        ]

    def close(self) -> None:
        """Free the instance."""
        self._slave.close()

    # -- can it be restarted? ----------------------------------------------------------------------

    def choose_restart(self) -> None:
        """Choose a way to restart that works: equal starts give equal steps, and outputs start from
        their start values.
        """
        segment = max(self.task.segments, key=lambda s: sum(map(abs, s.start.values())))
        plain = self._trial(ReplaySegment(segment.time, segment.u, {}))
        reasons = []
        for way in self.ways():
            self.way = way
            try:
                first, second = self._trial(segment), self._trial(segment)
            # FMPy raises plain exceptions for an error status of the FMU
            except Exception as error:
                reasons.append(f"it cannot be {RESTART_WAYS[way]} ({' '.join(str(error).split())})")
                continue
            if not np.allclose(first, second, rtol=REPEAT_TOLERANCE, atol=REPEAT_TOLERANCE):
                reasons.append(f"{RESTART_WAYS[way]}, it gives other outputs")
            elif ignored := self._ignored(segment, plain[0], first[0]):
                reasons.append(
                    f"its output {ignored} does not start at the value of"
                    f" {self.task.start_variables[ignored]}"
                )
            else:
                return
        raise RestartError("; ".join(reasons))

    def _trial(self, segment: ReplaySegment) -> Array:
        self.begin(segment.time, segment.start)
        return np.array([self._shown(), *self._steps(segment, TRIAL_STEPS)])

    def _ignored(self, segment: ReplaySegment, plain: Array, begun: Array) -> str | None:
        for name, variable in self.task.start_variables.items():
            asked = segment.start[variable] - self.task.fmu.start(variable)
            place = self.task.outputs.index(name)
            if (
                abs(begun[place] - plain[place] - asked)
                > START_TOLERANCE * abs(asked) + REPEAT_TOLERANCE
            ):
                return name
        return None
