"""Definition of an observer method, and its composition into a sampled System with the inputs u and
y only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from bristle.common.plugins import naming_plugins
from bristle.model.normalised import OBSERVED
from bristle.model.system import SAMPLE_TIME, System
from bristle.model.variables import Namespace, Parameter, State, Variable

__all__ = [
    "EquationContext",
    "Method",
    "Sample",
    "Update",
    "delayed",
    "observer",
    "stack",
    "stack_symmetric",
    "symmetric_states",
    "unstack",
    "unstack_symmetric",
    "vector_states",
]

SX = ca.SX

SIGNALS = {
    "theta": ("rad", "position"),
    "v": ("rad/s", "velocity"),
    "w": ("rad/s2", "friction acceleration without the viscous part"),
    "F": ("rad/s2", "friction acceleration, viscous part included"),
}
CONVERGENCE_TIME = 1.0  # s, over which the convergence measure averages
LONGEST_DELAY = 8  # samples
LARGEST_SD = 1e9  # what is published of a standard deviation at most: nothing is known
LARGEST_INPUT = 1e9  # V, rad or rad/s; what is larger counts as this, so that no square overflows
DELAY = Parameter(
    "delay",
    "d",
    "1",
    0.0,
    0.0,
    float(LONGEST_DELAY),
    "known delay of the measurement behind the input, in samples",
    "ljung1999 section 4.2",
)


@dataclass(frozen=True)
class Sample:
    """Inputs of a method in a step from k-1 to k: u_(k-1) held between, the outputs y_(k-1) and
    y_k, the period.
    """

    u: SX
    y0: SX
    y1: SX
    period: SX


@dataclass
class Update:
    """The result of a step: next values of all states, and what to publish as expressions of the
    *next* states.

    `first` gives the values of states at the very first sample, where there is no step yet (others
    keep their start); an estimate named in `valid` counts only where its expression is not zero.
    `sd`: standard deviations, of those estimates that have one. `adapted`: whether the estimates
    have been adapted since the start. `innovation`: recent mean squared innovation relative to the
    value that the method expects.
    """

    next: dict[str, SX]
    estimates: dict[str, SX]
    signals: dict[str, SX] = field(default_factory=dict)
    first: dict[str, SX] = field(default_factory=dict)
    valid: dict[str, SX] = field(default_factory=dict)
    sd: dict[str, SX] = field(default_factory=dict)
    adapted: SX = field(default_factory=lambda: SX(1))
    innovation: SX = field(default_factory=lambda: SX(0))


def never_valid(names: Iterable[str]) -> dict[str, Any]:
    """Return the fields of an `Update` that say that no estimate can be relied on, of a method that
    is kept to show it.
    """
    return {"valid": {name: SX(0) for name in names}, "adapted": SX(0)}


class EquationContext:
    """Symbols for the equations of a method: symbols of parameters and states, and constants made
    once.
    """

    def __init__(self, system: System, p: Namespace) -> None:
        self._system, self.p = system, p

    def constant(self, name: str, value: SX) -> SX:
        """Compute a matrix once, at initialisation, and return symbols of the same shape for it."""
        rows, columns = value.shape
        entries = {f"{name}_{i}_{j}": value[i, j] for i in range(rows) for j in range(columns)}
        symbols = self._system.constant(entries)
        return SX(ca.reshape(ca.vertcat(*(symbols[entry] for entry in entries)), columns, rows).T)


@dataclass(frozen=True)
class Method:
    """An observer by name; `reads` is the one output it uses, y_v or y_theta.

    `file` is that of a plug-in, for errors in its equations.
    """

    name: str
    description: str
    source: str
    reads: str
    parameters: tuple[Parameter, ...]
    states: tuple[State, ...]
    equations: Callable[[EquationContext, Sample], Update]
    file: str = field(default="", compare=False)


def vector_states(
    name: str, unit: str, description: str, count: int, initial: object = 0.0
) -> tuple[State, ...]:
    """Return `count` states called name0, name1, ...; read them back with `stack`."""
    return tuple(
        State(f"{name}{i}", unit, f"{description} ({i})", initial=initial) for i in range(count)
    )


def stack(p: Namespace, name: str, rows: int, columns: int = 1) -> SX:
    """Return the states name0, name1, ... as a matrix, filled row by row."""
    flat = ca.vertcat(*(p[f"{name}{i}"] for i in range(rows * columns)))
    return SX(ca.reshape(flat, columns, rows).T) if columns > 1 else SX(flat)


def unstack(name: str, values: SX) -> dict[str, SX]:
    """Return the entries of a matrix as states name0, name1, ..., row by row."""
    flat = ca.vec(values.T) if values.shape[1] > 1 else values
    return {f"{name}{i}": flat[i] for i in range(flat.numel())}


def _triangle(order: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(order) for j in range(i + 1)]


def symmetric_states(
    name: str, unit: str, description: str, order: int, diagonal: Sequence[float] = ()
) -> tuple[State, ...]:
    """Return the states of a symmetric matrix, its lower triangle row by row; read it back with
    `stack_symmetric`.

    It starts as a diagonal matrix, from zero where no diagonal is given.
    """
    starts = [diagonal[i] if diagonal and i == j else 0.0 for i, j in _triangle(order)]
    return tuple(
        State(f"{name}{n}", unit, f"{description} ({n})", initial=start)
        for n, start in enumerate(starts)
    )


def stack_symmetric(p: Namespace, name: str, order: int) -> SX:
    """Return the states name0, name1, ... as the symmetric matrix whose lower triangle they are."""
    matrix = SX(order, order)
    for n, (i, j) in enumerate(_triangle(order)):
        matrix[i, j] = matrix[j, i] = p[f"{name}{n}"]
    return matrix


def unstack_symmetric(name: str, matrix: SX) -> dict[str, SX]:
    """Return the lower triangle of a symmetric matrix as states name0, name1, ..., row by row."""
    return {f"{name}{n}": matrix[i, j] for n, (i, j) in enumerate(_triangle(matrix.shape[0]))}


def observer(method: Method) -> System:
    """Compose a method into a System that ticks once a period on the values its inputs then have.

    Its outputs come from sampled states alone: what is published at t_(k+1) is the estimate for
    t_k.
    """
    with naming_plugins([method]):
        return _observer(method)


def _observer(method: Method) -> System:
    system = System(method.name, method.description)
    period, delay = system.parameter(SAMPLE_TIME), system.parameter(DELAY)
    for parameter in method.parameters:
        system.parameter(parameter)
    inputs = {
        "u": system.input(Variable("u", "V", "voltage of the drive")),
        "y_theta": system.input(Variable("y_theta", "rad", "measured position")),
        "y_v": system.input(Variable("y_v", "rad/s", "measured velocity")),
    }
    inputs = {
        name: ca.fmax(ca.fmin(value, LARGEST_INPUT), -LARGEST_INPUT)
        for name, value in inputs.items()
    }
    p = system.namespace(f"{method.name}.")
    for state in method.states:
        system.sampled(_with_start(state, p))
    inputs_before = [system.sampled(State("last_u", "V", "input at the last sample"))]
    inputs_before += [
        system.sampled(State(f"last_u{i}", "V", f"input {i} samples before that"))
        for i in range(1, LONGEST_DELAY + 1)
    ]
    last_y = system.sampled(State("last_y", "1", "output at the last sample"))
    count = system.sampled(State("samples", "1", "samples seen so far"))
    y = inputs[method.reads]
    update = method.equations(
        EquationContext(system, p), Sample(delayed(inputs_before, delay), last_y, y, period)
    )
    started = count > 0
    for state in method.states:
        held = update.first.get(state.name, system.symbols[state.name])
        system.update(state.name, ca.if_else(started, update.next[state.name], held))
    system.update("last_u", inputs["u"])
    for i in range(1, LONGEST_DELAY + 1):
        system.update(f"last_u{i}", inputs_before[i - 1])
    system.update("last_y", y)
    system.update("samples", count + 1)
    _publish(system, method, update, started, period)
    return system.check()


def delayed(inputs: Sequence[SX], delay: SX) -> SX:
    """Return the input that acts on a sample of a measurement that is late by `delay` samples;
    `inputs` have the latest first.

    Between whole samples an earlier and a later input act for a part of the time each; returned is
    the mean, which the servo answers to up to terms of second order in the sampling period.
    """
    u = inputs[0]
    for i in range(1, len(inputs)):
        u = u + ca.fmin(ca.fmax(delay - (i - 1), 0), 1) * (inputs[i] - inputs[i - 1])
    return SX(u)


def _with_start(state: State, p: Namespace) -> State:
    """Return the states with start values that are functions of the parameters."""
    initial = state.initial(p) if callable(state.initial) else state.initial
    return State(state.name, state.unit, state.description, initial=initial)


def _publish(system: System, method: Method, update: Update, started: SX, period: SX) -> None:
    """Declare the outputs: every signal and estimate; 0 and not valid where the method has none, so
    that no output is ever NaN.
    """

    def flag(name: str, meaning: str, value: SX) -> None:
        system.output(Variable(name, "1", meaning, boolean=True), value)

    for name, (unit, description) in SIGNALS.items():
        system.output(
            Variable(f"{name}_hat", unit, f"estimate of {description}"),
            update.signals.get(name, SX(0)),
        )
        flag(
            f"{name}_hat_valid",
            f"the method estimates {name}; how well is not said",
            SX(float(name in update.signals)),
        )
    for name, (unit, description) in OBSERVED.items():
        known = name in update.estimates
        system.output(
            Variable(f"{name}_hat", unit, f"estimate of {description}"),
            update.estimates.get(name, SX(0)),
        )
        valid = update.valid.get(name, SX(float(known)))
        if name in update.sd:
            valid = ca.logic_and(valid, update.sd[name] > 0)  # nothing is known exactly
        flag(f"{name}_valid", f"{name}_hat is an estimate that counts", valid)
        spread = Variable(
            f"{name}_sd", unit, f"standard deviation of {name}_hat; 0: the method gives none"
        )
        system.output(spread, ca.fmin(update.sd.get(name, SX(0)), LARGEST_SD))
    flag("adapted", "the estimates have been adapted since the start", update.adapted)
    ratio = Variable(
        "innovation",
        "1",
        "recent mean squared innovation relative to the value expected; 0: the method gives none",
    )
    system.output(ratio, update.innovation)
    system.output(
        Variable(
            "convergence",
            "1/s",
            "fastest relative change of an estimate, averaged over 1 s; small when settled",
        ),
        _convergence(system, update, started, period),
    )


def _convergence(system: System, update: Update, started: SX, period: SX) -> SX:
    """Average the largest |d theta_i/dt| / |theta_i| with a first-order filter."""
    measure = system.sampled(
        State("convergence_state", "1/s", "average relative change of the estimates")
    )
    names = [name for name in system.updates if name in system.before]
    before = ca.vertcat(*update.estimates.values())
    [after] = ca.substitute(
        [before], [system.vector(names)], [ca.vertcat(*(system.updates[n] for n in names))]
    )
    change = ca.fabs(after - before) / ca.fmax(ca.fabs(after), 1e-9)
    fastest = change[0]
    for i in range(1, change.numel()):
        fastest = ca.fmax(fastest, change[i])
    average = measure + period / CONVERGENCE_TIME * (ca.fmin(fastest / period, 1e6) - measure)
    system.update("convergence_state", ca.if_else(started, average, measure))
    return measure
