"""A plant FMU played over measured inputs: stretch by stretch, each begun in a given state, or each record as it comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError, RestartError
from bristle.fmus.host import Fmu, Slave
from bristle.fmus.isolate import isolated

Array = NDArray[np.float64]

INPUT = "u"
TRIAL_STEPS = 8  # steps that must come out the same after a new beginning
REPEAT_TOLERANCE = 1e-9  # relative: how far they may be apart
START_TOLERANCE = 0.1  # a start value must move its output by itself, but for this fraction
RESTART_WAYS = {
    "reset": "reset",
    "snapshot": "restored to a snapshot of the state before initialisation",
    "again": "instantiated again",
}


@dataclass(frozen=True)
class Stretch:
    """Inputs (n,) held over n steps from a time [s] on, and the start values by variable name."""

    time: float
    u: Array
    start: Mapping[str, float]


@dataclass(frozen=True)
class Play:
    """What an FMU is asked: `outputs` by name, step h [s], stretches; `begins` maps outputs to the start values they obey."""

    fmu: Fmu
    h: float
    stretches: tuple[Stretch, ...]
    outputs: tuple[str, ...]
    begins: Mapping[str, str]


@dataclass(frozen=True)
class Played:
    """Outputs of each stretch (n, len(outputs)), before each step; and how the FMU was begun anew, in words."""

    outputs: tuple[Array, ...]
    way: str


def start_variable(fmu: Fmu, name: str) -> str | None:
    """Return the variable that sets where output `name` starts: a parameter name_start, or the output's own start value."""
    if fmu.has(f"{name}_start", "parameter") and fmu.is_real(f"{name}_start"):
        return f"{name}_start"
    own = fmu.variables.get(name)
    return name if own is not None and fmu.is_real(name) and own.initial in ("exact", "approx") else None


def play_stretches(play: Play, progress: Callable[[int], None] | None = None) -> Played:
    """Play all stretches in a process of their own, the FMU begun anew for each; `progress` is told how many are done.

    Raises
    ------
    RestartError
        If the FMU cannot be started from given states.
    BristleError
        If it crashes or refuses a step.
    """
    answer = isolated(_stretches, play, [play.fmu.path], progress)
    if isinstance(answer, str):
        raise RestartError(answer)
    return answer


def play_whole(play: Play) -> Played:
    """Play each stretch in a process of its own, so that nothing need be reset; errors as of `play_stretches`."""
    return Played(tuple(isolated(_whole, (play, stretch), [play.fmu.path]) for stretch in play.stretches), "")


# -- in the child ----------------------------------------------------------------------------------------------------


def _stretches(play: Play, control: NDArray[np.int64]) -> Played | str:
    player = _Player(play)
    try:
        player.rehearse()
        outputs = []
        for k, stretch in enumerate(play.stretches):
            player.begin(stretch.time, stretch.start)
            outputs.append(player.run(stretch))
            control[0] = k + 1
        return Played(tuple(outputs), RESTART_WAYS[player.way])
    except RestartError as error:
        return str(error)
    finally:
        player.close()


def _whole(asked: tuple[Play, Stretch], control: NDArray[np.int64]) -> Array:
    play, stretch = asked
    player = _Player(play)
    try:
        player.begin(stretch.time, stretch.start)
        return player.run(stretch)
    finally:
        player.close()


class _Player:
    """An instance at work, and the way in which it is begun anew."""

    def __init__(self, play: Play) -> None:
        self.play, fmu = play, play.fmu
        self._slave = Slave(fmu, "plant")
        self._fresh = True
        self._in = [fmu.reference(INPUT)]
        self._out = [fmu.reference(name) for name in play.outputs]
        self._snapshot = self._take() if fmu.description.coSimulation.canGetAndSetFMUstate else None
        self.way = "reset"

    def _take(self) -> Any:
        with suppress(Exception):  # FMPy raises plain exceptions for what an FMU refuses
            instance = self._slave.instance
            return instance.getFMUState() if self.play.fmu.fmi == 3 else instance.getFMUstate()
        return None

    def ways(self) -> Iterator[str]:
        """Give the ways to begin anew, the cheapest first."""
        yield "reset"
        if self._snapshot is not None:
            yield "snapshot"
        if not self.play.fmu.description.coSimulation.canBeInstantiatedOnlyOncePerProcess:
            yield "again"

    def _renew(self) -> None:
        instance = self._slave.instance
        if self.way == "reset":
            instance.reset()
        elif self.way == "snapshot":
            (instance.setFMUState if self.play.fmu.fmi == 3 else instance.setFMUstate)(self._snapshot)
        else:
            self._snapshot = None  # it goes with its instance
            self._slave.close()
            self._slave = Slave(self.play.fmu, "plant")

    def begin(self, time: float, start: Mapping[str, float]) -> None:
        """Begin in a state, at a time [s]."""
        if not self._fresh:
            self._renew()
        self._fresh = False
        self._slave.initialise(start, time)

    def run(self, stretch: Stretch) -> Array:
        """Return the outputs (n, len(outputs)) before each step."""
        outputs = np.array([self._shown(), *self._steps(stretch, len(stretch.u) - 1)])
        bad = np.argwhere(~np.isfinite(outputs))
        if len(bad):
            k, j = bad[0]
            shown, time = f"{self.play.outputs[j]} is {outputs[k, j]}", stretch.time + k * self.play.h
            raise BristleError(
                f"FMU {self.play.fmu.path}: output {shown} at {time:.6g} s, not a finite number; check how it treats its inputs"
            )
        return outputs

    def _steps(self, stretch: Stretch, n: int) -> Iterator[list[float]]:
        instance, h, three = self._slave.instance, self.play.h, self.play.fmu.fmi == 3
        put = instance.setFloat64 if three else instance.setReal
        for k, u in enumerate(stretch.u[:n].tolist()):
            time = stretch.time + k * h
            try:
                put(self._in, [u])
                ended = instance.doStep(time, h)
                if three and any(ended[1:3]):
                    raise RuntimeError("it asked to end the simulation")
                yield self._shown()
            except Exception as error:  # FMPy raises plain exceptions of several kinds
                said = self._slave.last_message()
                why = " ".join(str(error).split()) if said == "no message" else said
                raise BristleError(
                    f"FMU {self.play.fmu.path}: refused the step of {h:g} s at {time:.6g} s: {why}; "
                    "check what it says of steps and inputs, or resample the record"
                ) from None

    def _shown(self) -> list[float]:
        instance = self._slave.instance
        values: list[float] = (instance.getFloat64 if self.play.fmu.fmi == 3 else instance.getReal)(self._out)
        return values

    def close(self) -> None:
        """Free the instance."""
        self._slave.close()

    # -- can it be begun anew? -----------------------------------------------------------------------------------------

    def rehearse(self) -> None:
        """Choose a way to begin anew that works: the same start gives the same steps, and start values are obeyed."""
        stretch = max(self.play.stretches, key=lambda s: sum(map(abs, s.start.values())))
        plain = self._tried(Stretch(stretch.time, stretch.u, {}))
        reasons = []
        for way in self.ways():
            self.way = way
            try:
                first, second = self._tried(stretch), self._tried(stretch)
            except Exception as error:  # FMPy raises plain exceptions for what an FMU refuses
                reasons.append(f"it cannot be {RESTART_WAYS[way]} ({' '.join(str(error).split())})")
                continue
            if not np.allclose(first, second, rtol=REPEAT_TOLERANCE, atol=REPEAT_TOLERANCE):
                reasons.append(f"{RESTART_WAYS[way]}, it does not repeat itself")
            elif ignored := self._ignored(stretch, plain[0], first[0]):
                reasons.append(f"its output {ignored} does not start where {self.play.begins[ignored]} says")
            else:
                return
        raise RestartError("; ".join(reasons))

    def _tried(self, stretch: Stretch) -> Array:
        self.begin(stretch.time, stretch.start)
        return np.array([self._shown(), *self._steps(stretch, TRIAL_STEPS)])

    def _ignored(self, stretch: Stretch, plain: Array, begun: Array) -> str | None:
        for name, variable in self.play.begins.items():
            asked = stretch.start[variable] - self.play.fmu.start(variable)
            place = self.play.outputs.index(name)
            if abs(begun[place] - plain[place] - asked) > START_TOLERANCE * abs(asked) + REPEAT_TOLERANCE:
                return name
        return None
