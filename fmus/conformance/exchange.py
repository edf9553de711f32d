"""Points of Model Exchange: states, derivatives, event indicators, events."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from ctypes import byref, c_bool, c_double, c_int, c_size_t
from functools import partial
from typing import Any

import numpy as np

from bristle.fmus.conformance.instance import (
    MODEL_EXCHANGE,
    CallFailed,
    Ended,
    Events2,
    Instance,
    Options,
    Subject,
)
from bristle.fmus.conformance.registry import Severity
from bristle.fmus.conformance.running import (
    STEPS,
    Array,
    NotApplicable,
    Run,
    ask,
    ask_several,
    behaviour,
    default_step,
    differing,
    numbers,
    offset_inputs,
    times,
)
from bristle.fmus.conformance.states import STORE
from bristle.fmus.conformance.values import NUDGE, not_linear, undeclared, wrong_slopes

MOST_EVENTS = 100  # iterations that events at one time may take
SUBSTEPS = 10  # steps of the integration for each step of Co-Simulation
SAME_VALUE = 1e-9  # relative difference of what is computed twice
AGREEMENT = 0.1  # share of an output's range by which both interface types may differ
AGREEMENT_FLOOR = 1e-6  # share of an output's largest value that is not judged

exchange = partial(behaviour, kind=MODEL_EXCHANGE)


def settle(instance: Instance) -> bool:
    """Iterate the events of this time until none is left; say whether a time event is due later.

    Raises
    ------
    CallFailed
        If they do not come to an end.
    Ended
        If it asks to end the simulation.
    """
    for _ in range(MOST_EVENTS):
        if instance.fmi == 2:
            events = Events2()
            instance.do("NewDiscreteStates", byref(events))
            again, terminate, due = events.again, events.terminate, bool(events.next_defined)
        else:
            flags, time = (c_bool * 5)(), c_double()
            instance.do("UpdateDiscreteStates", *(byref(flags, k) for k in range(5)), byref(time))
            again, terminate, due = flags[0], flags[1], bool(flags[4])
        if terminate:
            raise Ended("it asks to end the simulation in an event")
        if not again:
            return due
    raise CallFailed(f"events do not come to an end in {MOST_EVENTS} iterations")


class ContinuousInstance:
    """An instance of Model Exchange in continuous-time mode."""

    def __init__(self, subject: Subject, library: Any = None) -> None:
        self.subject = subject
        self.library = library or subject.load(MODEL_EXCHANGE)
        self.instance = Instance(subject, Options(kind=MODEL_EXCHANGE), self.library)
        self.columns = [name for name in numbers(subject) for _ in range(subject.count(name))]
        self.h, self.t, self.events = default_step(subject), 0.0, False

    def begin(self) -> None:
        """Go to continuous-time mode at the start of the default experiment."""
        self.t = times(self.subject)[0]
        self.instance.enter(self.t)
        self.instance.leave()
        offset_inputs(self.instance)
        self.events = settle(self.instance)
        self.instance.do("EnterContinuousTimeMode")
        if self.subject.fmi == 2:
            self.n, self.m = (
                len(self.subject.description.derivatives),
                int(self.subject.description.numberOfEventIndicators or 0),
            )
        else:
            self.n, self.m = (
                self._counted("GetNumberOfContinuousStates"),
                self._counted("GetNumberOfEventIndicators"),
            )

    def _counted(self, name: str) -> int:
        number = c_size_t()
        self.instance.do(name, byref(number))
        return number.value

    def states(self) -> Array:
        """Return its states."""
        return np.array(self.instance.vector("GetContinuousStates", self.n))

    def derivatives(self) -> Array:
        """Return the derivatives of its states."""
        name = "GetDerivatives" if self.subject.fmi == 2 else "GetContinuousStateDerivatives"
        return np.array(self.instance.vector(name, self.n))

    def indicators(self) -> Array:
        """Return its event indicators."""
        return np.array(self.instance.vector("GetEventIndicators", self.m))

    def outputs(self) -> list[float]:
        """Return its outputs."""
        return [float(value) for name in numbers(self.subject) for value in self.instance.get(name)]

    def go(self, t: float, x: Array) -> None:
        """Set time and states."""
        self.instance.do("SetTime", float(t))
        if self.n:
            self.instance.do("SetContinuousStates", (c_double * self.n)(*x), self.n)

    def slope(self, t: float, x: Array) -> Array:
        """Return the derivatives at a time for some states."""
        self.go(t, x)
        return self.derivatives() if self.n else np.zeros(0)

    def step(self, h: float) -> None:
        """Integrate over a step, by the midpoint rule, and complete it, with its events."""
        x = self.states() if self.n else np.zeros(0)
        middle = x + h / 2 * self.slope(self.t, x)
        after = x + h * self.slope(self.t + h / 2, middle)
        self.t += h
        self.go(self.t, after)
        kind = c_int if self.subject.fmi == 2 else c_bool
        enter, terminate = kind(), kind()
        self.instance.do("CompletedIntegratorStep", True, byref(enter), byref(terminate))
        if enter.value:
            self.events = True
            self.instance.do("EnterEventMode")
            settle(self.instance)
            self.instance.do("EnterContinuousTimeMode")

    def steps(self, n: int = STEPS) -> Array:
        """Return outputs and derivatives, shape (n + 1, outputs + states), from now on."""
        rows = [self._row()]
        for _ in range(n):
            self.step(self.h / SUBSTEPS)
            rows.append(self._row())
        return np.array(rows, dtype=float)

    def _row(self) -> list[float]:
        return [*self.outputs(), *(self.derivatives() if self.n else ())]

    def __enter__(self) -> ContinuousInstance:
        return self

    def __exit__(self, *error: object) -> None:
        if error[0] is None:
            self.instance.free()


def _begun(subject: Subject, library: Any = None) -> ContinuousInstance:
    model = ContinuousInstance(subject, library)
    model.begin()
    return model


def _with_states(subject: Subject) -> ContinuousInstance:
    model = _begun(subject)
    if not model.n:
        raise NotApplicable("it has no continuous states")
    return model


def _beside(x: Array) -> Array:
    """Return states a little apart, each by another step."""
    return x * (1 + NUDGE) + NUDGE * (1 + np.arange(len(x)))


def _names(model: ContinuousInstance) -> list[str]:
    return [*model.columns, *(f"derivative {k}" for k in range(1, model.n + 1))]


@exchange("exchange-life", "its modes are gone through, events come to an end, and it is freed")
def _life(subject: Subject) -> Iterator[str]:
    with _begun(subject) as model:
        model.steps(3)
        model.instance.do("EnterEventMode")
        settle(model.instance)
        model.instance.do("EnterContinuousTimeMode")
        model.steps(3)
        model.instance.do("Terminate")
    yield from ()


@exchange("exchange-counts", "states and event indicators are as many as in the description")
def _counts(subject: Subject) -> Iterator[str]:
    if subject.fmi == 2:
        raise NotApplicable("FMI 2 has the numbers in the description alone")

    def width(unknowns: Sequence[Any]) -> int:
        return sum(subject.count(u.variable.name) for u in unknowns)

    given = subject.description
    with _begun(subject) as model:
        for what, number, expected in (
            ("states", model.n, width(given.derivatives)),
            ("event indicators", model.m, width(given.eventIndicators)),
        ):
            if number != expected:
                yield f"{number} {what} instead of {expected}"


@exchange("exchange-finite", "derivatives, event indicators and outputs are finite")
def _finite(subject: Subject) -> Iterator[str]:
    with _begun(subject) as model:
        for _ in range(STEPS):
            values = {**dict(zip(_names(model), model._row(), strict=True))}
            values |= {
                f"event indicator {k}": z
                for k, z in enumerate(model.indicators() if model.m else (), start=1)
            }
            bad = [name for name, value in values.items() if not math.isfinite(value)]
            if bad:
                yield from (f"{name} is {values[name]} at {model.t:g} s" for name in bad)
                return
            model.step(model.h / SUBSTEPS)


@exchange("exchange-states", "states are read as they were set")
def _states(subject: Subject) -> Iterator[str]:
    with _with_states(subject) as model:
        x = _beside(model.states())
        model.go(model.t, x)
        found = model.states()
    yield from (
        f"state {k + 1}: {found[k]:.17g} instead of {x[k]:.17g}" for k in np.flatnonzero(found != x)
    )


@exchange("exchange-nominals", "nominal values of states are positive and finite")
def _nominals(subject: Subject) -> Iterator[str]:
    with _with_states(subject) as model:
        found = model.instance.vector("GetNominalsOfContinuousStates", model.n)
    yield from (
        f"state {k}: {value:g}"
        for k, value in enumerate(found, start=1)
        if not 0 < value < math.inf
    )


@exchange(
    "exchange-order",
    "states and derivatives are those of their variables, in the order of the description",
)
def _order(subject: Subject) -> Iterator[str]:
    with _with_states(subject) as model:
        model.steps(3)
        model.go(model.t, _beside(model.states()))
        derivatives = [u.variable for u in subject.description.derivatives]
        states = [v.derivative for v in derivatives if v.derivative is not None]
        for variables, vector in ((derivatives, model.derivatives()), (states, model.states())):
            named = [(v.name, value) for v in variables for value in model.instance.get(v.name)]
            for (name, value), entry in zip(named, vector, strict=False):
                if not math.isclose(value, entry, rel_tol=SAME_VALUE, abs_tol=0.0):
                    yield f"{name} is {value:.17g}, its entry {entry:.17g}"


@exchange(
    "exchange-pure",
    "derivatives and event indicators depend on time, states and inputs alone, not on what was"
    " asked before",
)
def _pure(subject: Subject) -> Iterator[str]:
    with _with_states(subject) as model:
        model.steps(3)
        t, x = model.t, model.states()
        model.go(t, x)
        before = np.concatenate([model.derivatives(), model.indicators()])
        for share in (1.0, -2.0):
            model.go(t + model.h / SUBSTEPS, x + share * NUDGE * (1 + np.abs(x)))
            model.derivatives()
            model.go(t, x)
            after = np.concatenate([model.derivatives(), model.indicators()])
            yield from (
                f"value {k + 1}: {after[k]:.17g} instead of {before[k]:.17g}"
                for k in np.flatnonzero(after != before)
            )


@exchange("exchange-again", "a second instance, and one that was reset, give the same digits")
def _again(subject: Subject) -> Iterator[str]:
    with _begun(subject) as model:
        expected, names = model.steps(), _names(model)
        model.instance.do("Reset")
        model.begin()
        yield from differing(names, expected, model.steps())
    ask_several(subject, MODEL_EXCHANGE)
    with _begun(subject, model.library) as second:
        yield from differing(names, expected, second.steps())


@exchange("exchange-state", "a stored state continues as before")
def _state(subject: Subject) -> Iterator[str]:
    ask(subject, *STORE, kind=MODEL_EXCHANGE)
    with _begun(subject) as model:
        model.steps(3)
        t, state = model.t, model.instance.get_state()
        expected = model.steps()
        model.instance.set_state(state)
        model.t = t
        yield from differing(_names(model), expected, model.steps())
        model.instance.free_state(state)


# -- dependencies and derivatives ------------------------------------------------------------------


def _knowns(subject: Subject) -> list[str]:
    """Return states, and inputs that are continuous."""
    states = [
        u.variable.derivative.name
        for u in subject.description.derivatives
        if u.variable.derivative is not None
    ]
    scalar = subject.scalars("input", "output", "local")
    inputs = [
        name
        for name in subject.scalars("input")
        if subject.variables[name].variability == "continuous"
    ]
    return [name for name in (*states, *inputs) if name in set(scalar)]


class _Settable:
    """An instance of Model Exchange whose states can be set by the names of their variables."""

    def __init__(self, model: ContinuousInstance) -> None:
        self.model, self.subject = model, model.subject
        derivatives = model.subject.description.derivatives
        self.places = {
            u.variable.derivative.name: k
            for k, u in enumerate(derivatives)
            if u.variable.derivative is not None
        }

    def __getattr__(self, name: str) -> Any:
        return getattr(self.model.instance, name)

    def write(self, name: str, given: Sequence[float]) -> int:
        """Set a state or an input and return the status."""
        if name not in self.places:
            return self.model.instance.write(name, given)
        x = self.model.states()
        x[self.places[name]] = given[0]
        return self.model.instance.call("SetContinuousStates", (c_double * len(x))(*x), len(x))


def _unknowns(subject: Subject) -> list[Any]:
    """Return derivatives and continuous outputs that are single numbers."""
    given = [*subject.description.derivatives, *subject.description.outputs]
    scalar = set(subject.scalars("local", "output"))
    return [
        u for u in given if u.variable.name in scalar and u.variable.variability == "continuous"
    ]


def _scalar_model(subject: Subject) -> ContinuousInstance:
    if not _unknowns(subject) or not _knowns(subject):
        raise NotApplicable(
            "it has no derivative or output, or no state or input, that is a single number"
        )
    if len(subject.description.derivatives) != sum(
        subject.count(u.variable.name) for u in subject.description.derivatives
    ):
        raise NotApplicable("its states are arrays")
    model = _begun(subject)
    model.steps(3)
    return model


@exchange(
    "exchange-dependencies",
    "derivatives and outputs depend on what they are declared to depend on alone",
)
def _dependencies(subject: Subject) -> Iterator[str]:
    unknowns = [u for u in _unknowns(subject) if u.dependencies is not None]
    if not unknowns:
        raise NotApplicable("it declares no dependencies")
    with _scalar_model(subject) as model:
        yield from undeclared(_Settable(model), unknowns, _knowns(subject))  # type: ignore[arg-type]  # it does what an Instance does


@exchange("exchange-derivatives", "directional derivatives are the difference quotients")
def _derivatives(subject: Subject) -> Iterator[str]:
    ask(
        subject,
        "providesDirectionalDerivative",
        "providesDirectionalDerivatives",
        kind=MODEL_EXCHANGE,
    )
    with _scalar_model(subject) as model:
        names = list(dict.fromkeys(u.variable.name for u in _unknowns(subject)))
        for known in _knowns(subject):
            own = [name for name in names if name != known]
            nominal = float(subject.variables[known].nominal or 1.0)
            yield from wrong_slopes(_Settable(model), own, known, nominal)  # type: ignore[arg-type]  # as above
        knowns = _knowns(subject)
        yield from not_linear(
            model.instance, [name for name in names if name not in knowns], knowns
        )


@exchange("exchange-adjoint", "adjoint derivatives are the transpose of the directional ones")
def _adjoint(subject: Subject) -> Iterator[str]:
    ask(subject, "providesAdjointDerivatives", kind=MODEL_EXCHANGE)
    ask(subject, "providesDirectionalDerivatives", kind=MODEL_EXCHANGE)
    with _scalar_model(subject) as model:
        knowns = _knowns(subject)
        unknowns = [
            name
            for name in dict.fromkeys(u.variable.name for u in _unknowns(subject))
            if name not in knowns
        ]
        columns = np.array(
            [model.instance.directional(unknowns, [known], [1.0]) for known in knowns]
        )
        for name, row in zip(unknowns, columns.T, strict=True):
            found = model.instance.adjoint([name], knowns, [1.0])
            for known, a, b in zip(knowns, row, found, strict=True):
                if not math.isclose(a, b, rel_tol=SAME_VALUE, abs_tol=SAME_VALUE):
                    yield f"{name} by {known}: {b:.6g} instead of {a:.6g}"


@exchange("exchange-agrees", "both interface types give the same outputs", Severity.warning)
def _agrees(subject: Subject) -> Iterator[str]:
    if subject.description.coSimulation is None:
        raise NotApplicable("it offers no CoSimulation")
    with _begun(subject) as model:
        signs = np.sign(model.indicators()) if model.m else np.zeros(0)
        rows = []
        for _ in range(STEPS):
            for _ in range(SUBSTEPS):
                model.step(model.h / SUBSTEPS)
            rows.append(model.outputs())
            if model.events or (model.m and np.any(np.sign(model.indicators()) != signs)):
                raise NotApplicable("it has events in the first steps")
    with Run(subject, moved=False) as run:
        run.begin()
        offset_inputs(run.instance)
        other = run.steps()[1:]
    table = np.array(rows)
    scale = AGREEMENT * np.maximum(
        np.ptp(table, axis=0), np.ptp(other, axis=0)
    ) + AGREEMENT_FLOOR * np.max(np.abs(table), axis=0)
    for k in np.flatnonzero(np.max(np.abs(table - other), axis=0) > scale):
        yield (
            f"{model.columns[k]}: {other[-1, k]:.6g} in Co-Simulation, {table[-1, k]:.6g} in Model"
            " Exchange"
        )
