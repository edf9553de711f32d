"""What the points of behaviour share: their registry, and runs of an instance."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.fmus.conformance.instance import (
    CO_SIMULATION,
    USUAL,
    CallFailed,
    Instance,
    Options,
    Subject,
)
from bristle.fmus.conformance.registry import Severity
from bristle.fmus.difference import USUAL_STEPS

Array = NDArray[np.float64]
Judge = Callable[[Subject], Iterator[str]]

POINT_SECONDS = 10.0  # s that a point may take
STEPS = 20  # steps that the points run
USUAL_STEP = 1e-3  # s, where the FMU states no time at all
INPUT_SHARE = 0.1  # of an input's nominal value or start, by which runs move it
# of a parameter's start, by which runs move it that ask whether parameters are kept apart
PARAMETER_SHARE = 1e-3
INPUT_TURN = 0.7  # rad a step, of the sine that moves the inputs


class NotApplicable(BristleError):
    """A point asks for what the FMU does not claim to do."""


@dataclass(frozen=True)
class BehaviourPoint:
    """One point: id, title, severity, the interface type that it runs, the function that gives what
    it finds.

    `step_seconds`: time [s] that a step may take, where that is less than the time of a point.
    """

    id: str
    title: str
    severity: Severity
    kind: str
    judge: Judge
    step_seconds: float | None


BEHAVIOUR: dict[str, BehaviourPoint] = {}


def behaviour(
    name: str,
    title: str,
    severity: Severity = Severity.error,
    *,
    kind: str = CO_SIMULATION,
    step_seconds: float | None = None,
) -> Callable[[Judge], Judge]:
    """Enter a function into the registry; `step_seconds` that a step may take, by default the whole
    time of the point.
    """

    def enter(judge: Judge) -> Judge:
        BEHAVIOUR[name] = BehaviourPoint(name, title, severity, kind, judge, step_seconds)
        return judge

    return enter


def ask(subject: Subject, *abilities: str, kind: str = CO_SIMULATION) -> None:
    """Raise NotApplicable if the description claims none of some abilities."""
    if not subject.claims(*abilities, kind=kind):
        raise NotApplicable(f"it does not claim {abilities[0]}")


def ask_several(subject: Subject, kind: str = CO_SIMULATION) -> None:
    """Raise NotApplicable if there may be one instance alone."""
    if subject.claims("canBeInstantiatedOnlyOncePerProcess", kind=kind):
        raise NotApplicable("it claims one instance a process")


def numbers(subject: Subject, causality: str = "output") -> list[str]:
    """Return the variables of a causality that are numbers or Booleans, readable at any time."""
    return [
        name
        for name in subject.names(causality)
        if subject.is_accessible(name) and subject.variables[name].type != "String"
    ]


def default_step(subject: Subject) -> float:
    """Return the step size [s] of runs: that of the default experiment, or the internal one, or a
    share of the experiment.
    """
    given = subject.description.defaultExperiment
    step = getattr(given, "stepSize", None) or getattr(
        subject.description.coSimulation, "fixedInternalStepSize", None
    )
    if step and float(step) > 0:
        return float(step)
    start, stop = times(subject)
    return USUAL_STEP if stop is None else (stop - start) / USUAL_STEPS


def times(subject: Subject) -> tuple[float, float | None]:
    """Return start and stop [s] of the default experiment; None where it states no later stop."""
    given = subject.description.defaultExperiment
    start = float(getattr(given, "startTime", None) or 0.0)
    stop = getattr(given, "stopTime", None)
    return start, float(stop) if stop is not None and float(stop) > start else None


def steps_within(subject: Subject, n: int) -> int:
    """Return a number of steps, or that of the default experiment if it has fewer."""
    start, stop = times(subject)
    return n if stop is None else max(1, min(n, int((stop - start) / default_step(subject))))


def within(subject: Subject, name: str, value: float) -> float:
    """Return a value moved into the range of a variable."""
    low, high = subject.interval(name)
    return min(max(value, low), high)


def moved_inputs(subject: Subject) -> dict[str, tuple[float, float]]:
    """Return for each real input its start value, and by how much runs move it."""
    found = {}
    for name in subject.scalars("input"):
        v = subject.variables[name]
        start = float(v.start) if v.start is not None else 0.0
        found[name] = start, INPUT_SHARE * float(v.nominal or abs(start) or 1.0)
    return found


def offset_inputs(instance: Instance) -> None:
    """Set real inputs apart from their start values; an FMU may refuse what it does not know as its
    range.
    """
    for name, (start, size) in moved_inputs(instance.subject).items():
        instance.write(name, [within(instance.subject, name, start + size)])


class Run:
    """An instance of Co-Simulation and the numbers that it gives, step by step.

    `moved`: its real inputs follow a sine about their start values; else they are left alone.
    """

    def __init__(self, subject: Subject, options: Options = USUAL, *, moved: bool = True) -> None:
        self.subject, self.h = subject, default_step(subject)
        self.instance = Instance(subject, options)
        self.names = numbers(subject)
        self.columns = [name for name in self.names for _ in range(subject.count(name))]
        self.inputs = moved_inputs(subject) if moved else {}
        self.event_mode = options.event_mode
        self.t, self.k = 0.0, 0

    def begin(self, start: float | None = None) -> None:
        """Initialise it, at the start [s] of the default experiment if none is given."""
        self.t, self.k = times(self.subject)[0] if start is None else start, 0
        self.instance.enter(self.t)
        self.instance.leave()

    def tune(self, *causalities: str) -> dict[str, float]:
        """Move real parameters a little, or variables of other causalities; return the values that
        were taken.
        """
        taken = {}
        for name in self.subject.scalars(*(causalities or ("parameter",))):
            v = self.subject.variables[name]
            if v.start is not None:
                start = float(v.start)
                value = within(
                    self.subject,
                    name,
                    start + PARAMETER_SHARE * (abs(start) or float(v.nominal or 1.0)),
                )
                if not refused(self.instance.write(name, [value])):
                    taken[name] = value
        return taken

    def outputs(self) -> list[float]:
        """Read its outputs."""
        return [float(value) for name in self.names for value in self.instance.get(name)]

    def input_values(self) -> dict[str, float]:
        """Read its real inputs."""
        return {name: self.instance.number(name) for name in self.subject.scalars("input")}

    def move(self) -> None:
        """Set the inputs of the next step; an FMU may refuse what it does not know as its range."""
        for name, (start, size) in self.inputs.items():
            value = start + size * float(np.sin(INPUT_TURN * self.k))
            self.instance.write(name, [within(self.subject, name, value)])
        self.k += 1

    def advance(self, h: float) -> None:
        """Do a step without moving inputs."""
        self.instance.step(self.t, h)
        self.t += h

    def step(self, h: float | None = None, parts: Sequence[float] = (1.0,)) -> list[float]:
        """Do a step, in parts that are shares of it, and read the outputs."""
        self.move()
        for part in parts:
            self.advance((self.h if h is None else h) * part)
        return self.outputs()

    def steps(self, n: int = STEPS) -> Array:
        """Return outputs, shape (n + 1, outputs), from now on."""
        return np.array([self.outputs(), *(self.step() for _ in range(n))], dtype=float)

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *error: object) -> None:
        if error[0] is None:
            self.instance.free()


def tuned(subject: Subject, options: Options = USUAL) -> Run:
    """Return a run, begun, whose real parameters differ a little from their start values, where the
    FMU takes that.
    """
    run = Run(subject, options)
    try:
        run.tune()
        run.begin()
    except CallFailed:
        run = Run(subject, options)
        run.begin()
    return run


def fresh(subject: Subject, options: Options = USUAL, n: int = STEPS) -> Array:
    """Return outputs, shape (n + 1, outputs), of a new instance."""
    with Run(subject, options) as run:
        run.begin()
        return run.steps(n)


def differing(names: Sequence[str], expected: Array, found: Array) -> Iterator[str]:
    """Give the outputs that differ in any bit, and where first."""
    for name, a, b in zip(names, expected.T, found.T, strict=True):
        k = np.flatnonzero(
            np.ascontiguousarray(a).view(np.int64) != np.ascontiguousarray(b).view(np.int64)
        )
        if len(k):
            yield f"{name}: {b[k[0]]:.17g} instead of {a[k[0]]:.17g} after {k[0]} steps"


def refused(status: int) -> bool:
    """Say whether a status says that a call was not done."""
    return status > 1
