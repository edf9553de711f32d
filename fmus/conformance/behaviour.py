"""Points of behaviour: the FMU runs, each point in a process of its own with a time limit."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.fmus.calls import Control
from bristle.fmus.conformance.registry import Severity, Verdict
from bristle.fmus.host import Fmu, Slave
from bristle.fmus.isolate import isolated

Array = NDArray[np.float64]

POINT_SECONDS = 10.0  # s that a point may take
STEPS = 20  # steps that the points run
USUAL_STEP = 1e-3  # s, where the FMU states none
LIVES = 60  # of an instance, over which memory may not grow
ALLOWED_GROWTH = 4 << 20  # bytes, of the memory in use over these lives
FIRST_LIVES = 20  # after which memory in use is first looked at


class NotApplicable(BristleError):
    """A point asks for what the FMU does not claim to do."""


@dataclass(frozen=True)
class BehaviourPoint:
    """One point: id, title, severity, and the function that gives what it finds in a running FMU."""

    id: str
    title: str
    severity: Severity
    judge: Callable[[Fmu], Iterator[str]]


BEHAVIOUR: dict[str, BehaviourPoint] = {}


def behaviour(
    name: str, title: str, severity: Severity = Severity.error
) -> Callable[[Callable[[Fmu], Iterator[str]]], Callable[[Fmu], Iterator[str]]]:
    """Enter a function into the registry."""

    def enter(judge: Callable[[Fmu], Iterator[str]]) -> Callable[[Fmu], Iterator[str]]:
        BEHAVIOUR[name] = BehaviourPoint(name, title, severity, judge)
        return judge

    return enter


def judged(path: Path, name: str) -> tuple[Verdict, tuple[str, ...]]:
    """Return the verdict of a point with what it found, or why it does not apply; a crash or a hang is a finding."""
    try:
        verdict, findings = isolated(_judge, (path, name), [path], _verdict, None, POINT_SECONDS)
    except BristleError as error:
        return Verdict.failed, (str(error),)
    return verdict, findings


def _verdict(answer: Any) -> tuple[Verdict, tuple[str, ...]]:
    return Verdict(answer["verdict"]), tuple(map(str, answer["findings"]))


def _judge(work: tuple[Path, str], control: Control) -> dict[str, Any]:
    path, name = work
    try:
        findings = list(BEHAVIOUR[name].judge(Fmu(path, foreign=True)))
    except NotApplicable as reason:
        return {"verdict": Verdict.not_applicable, "findings": [str(reason)]}
    return {"verdict": Verdict.failed if findings else Verdict.passed, "findings": findings}


# -- what the points share -----------------------------------------------------------------------------------------------


class _Run:
    """An instance and the numbers that it gives, step by step."""

    def __init__(self, fmu: Fmu, beside: _Run | None = None) -> None:
        self.fmu = fmu
        self.slave: Slave = Slave(fmu, "one") if beside is None else Slave(fmu, "two", beside.slave)
        self.names = [name for name in fmu.names("output") if fmu.is_real(name)]
        step = getattr(fmu.description.defaultExperiment, "stepSize", None)
        self.h = float(step) if step else USUAL_STEP
        self.k = 0

    def begin(self) -> None:
        """Initialise it."""
        self.slave.initialise({})
        self.k = 0

    def outputs(self) -> list[float]:
        """Read its outputs."""
        vr, instance = [self.fmu.reference(name) for name in self.names], self.slave.instance
        if not vr:
            return []
        values: list[float] = (instance.getReal if self.fmu.fmi == 2 else instance.getFloat64)(vr)
        return values

    def step(self, h: float | None = None) -> list[float]:
        """Do a step and read its outputs."""
        self.slave.instance.doStep(self.k * self.h, self.h if h is None else h)
        self.k += 1
        return self.outputs()

    def steps(self, n: int = STEPS) -> Array:
        """Return outputs, shape (n + 1, outputs), from now on."""
        return np.array([self.outputs(), *(self.step() for _ in range(n))], dtype=float)

    def __enter__(self) -> _Run:
        return self

    def __exit__(self, *_: object) -> None:
        self.slave.close()


def _fresh(fmu: Fmu, beside: _Run | None = None) -> Array:
    with _Run(fmu, beside) as run:
        run.begin()
        return run.steps()


def _differing(names: list[str], expected: Array, found: Array) -> Iterator[str]:
    for name, a, b in zip(names, expected.T, found.T, strict=True):
        k = np.flatnonzero(a.view(np.int64) != b.view(np.int64))
        if len(k):
            yield f"{name}: {b[k[0]]:.17g} instead of {a[k[0]]:.17g} after {k[0]} steps"


def _claims(fmu: Fmu, *abilities: str) -> bool:
    return any(getattr(fmu.description.coSimulation, ability, None) for ability in abilities)


# -- the points ----------------------------------------------------------------------------------------------------------


@behaviour("run-starts", "parameters and inputs have the start values of the description")
def _starts(fmu: Fmu) -> Iterator[str]:
    with _Run(fmu) as run:
        if fmu.fmi == 2:
            run.slave.instance.setupExperiment()
        run.slave.instance.enterInitializationMode()  # before it, FMI 2 allows to read nothing
        for name in (*fmu.names("parameter"), *fmu.names("input")):
            v = fmu.variables[name]
            if fmu.is_real(name) and v.start is not None and not getattr(v, "dimensions", None):
                found = run.slave.get_value(name)
                if found != float(v.start):
                    yield f"{name}: {found:.17g} instead of {v.start}"


@behaviour("run-finite", "every output is finite, at the start and in the first steps")
def _finite(fmu: Fmu) -> Iterator[str]:
    with _Run(fmu) as run:
        run.begin()
        for name, values in zip(run.names, run.steps().T, strict=True):
            bad = np.flatnonzero(~np.isfinite(values))
            if len(bad):
                yield f"{name}: {values[bad[0]]} after {bad[0]} steps"


@behaviour("run-again", "a second instance gives the same digits")
def _again(fmu: Fmu) -> Iterator[str]:
    if _claims(fmu, "canBeInstantiatedOnlyOncePerProcess"):
        raise NotApplicable("it claims one instance a process")
    with _Run(fmu) as run:
        yield from _differing(run.names, _fresh(fmu, run), _fresh(fmu, run))


@behaviour("run-reset", "after a reset it is as new")
def _reset(fmu: Fmu) -> Iterator[str]:
    expected = _fresh(fmu)
    with _Run(fmu) as run:
        run.begin()
        run.steps()
        run.slave.instance.reset()
        run.begin()
        yield from _differing(run.names, expected, run.steps())


@behaviour("run-state", "a stored state continues as before")
def _state(fmu: Fmu) -> Iterator[str]:
    if not _claims(fmu, "canGetAndSetFMUstate", "canGetAndSetFMUState"):
        raise NotApplicable("it does not claim to store its state")
    with _Run(fmu) as run:
        run.begin()
        run.steps(STEPS // 2)
        instance, k = run.slave.instance, run.k
        state = instance.getFMUstate() if fmu.fmi == 2 else instance.getFMUState()
        expected = run.steps()
        (instance.setFMUstate if fmu.fmi == 2 else instance.setFMUState)(state)
        run.k = k
        yield from _differing(run.names, expected, run.steps())
        (instance.freeFMUstate if fmu.fmi == 2 else instance.freeFMUState)(state)


@behaviour("run-two", "two instances at once do not disturb each other")
def _two(fmu: Fmu) -> Iterator[str]:
    if _claims(fmu, "canBeInstantiatedOnlyOncePerProcess"):
        raise NotApplicable("it claims one instance a process")
    expected = _fresh(fmu)
    with ExitStack() as stack:
        first = stack.enter_context(_Run(fmu))
        second = stack.enter_context(_Run(fmu, first))
        first.begin()
        first.steps(STEPS // 2)
        second.begin()
        rows = [second.outputs()]
        for _ in range(STEPS):
            first.step()
            rows.append(second.step())
        yield from _differing(second.names, expected, np.array(rows, dtype=float))


@behaviour("run-nan", "an input that is no number is refused, or does no harm to the outputs")
def _nan(fmu: Fmu) -> Iterator[str]:
    inputs = [name for name in fmu.names("input") if fmu.is_real(name) and not getattr(fmu.variables[name], "dimensions", None)]
    if not inputs:
        raise NotApplicable("it has no real input")
    with _Run(fmu) as run:
        run.begin()
        try:
            run.slave.set_value(inputs[0], math.nan)
            values = run.step()
        except Exception:  # FMPy raises plain exceptions for a status other than OK
            return
        for name, value in zip(run.names, values, strict=True):
            if not math.isfinite(value):
                yield f"{inputs[0]} = NaN is taken, with status OK, and output {name} is {value}"


@behaviour("run-back", "a step back in time is refused", Severity.warning)
def _back(fmu: Fmu) -> Iterator[str]:
    with _Run(fmu) as run:
        run.begin()
        run.steps(2)
        try:
            run.step(-run.h)
        except Exception:  # FMPy raises plain exceptions for a status other than OK
            return
        yield f"a step of {-run.h:g} s has status OK"


@behaviour("run-token", "a wrong guid or instantiationToken is refused", Severity.warning)
def _token(fmu: Fmu) -> Iterator[str]:
    fmu.description.guid = fmu.description.instantiationToken = "{not-the-token-of-this-file}"
    try:
        Slave(fmu, "one").close()
    except BristleError:
        return
    yield "an instance was made"


@behaviour("run-quiet", "nothing is written to standard output or error", Severity.warning)
def _quiet(fmu: Fmu) -> Iterator[str]:
    with tempfile.TemporaryFile() as file:
        kept = [os.dup(1), os.dup(2)]
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        try:
            _fresh(fmu)
        finally:
            for number, old in enumerate(kept, start=1):
                os.dup2(old, number)
        file.seek(0)
        written = file.read(200)
    if written:
        yield f"it writes: {' '.join(written.decode('utf-8', 'replace').split())[:80]}"


@behaviour("run-memory", "memory in use does not grow from life to life", Severity.warning)
def _memory(fmu: Fmu) -> Iterator[str]:
    if not Path("/proc/self/statm").exists():
        raise NotApplicable("this system does not say how much memory is in use")
    if _claims(fmu, "canBeInstantiatedOnlyOncePerProcess"):
        raise NotApplicable("it claims one instance a process")
    with _Run(fmu) as run:  # keeps the library loaded
        instance, used = run.slave.instance, []
        for life in range(LIVES):
            run.begin()
            run.steps(2)
            instance.terminate()
            instance.reset()
            if life in (FIRST_LIVES, LIVES - 1):
                used.append(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"))
    if used[1] - used[0] > ALLOWED_GROWTH:
        yield f"{(used[1] - used[0]) / (LIVES - 1 - FIRST_LIVES) / 1024:.0f} KiB a life"
