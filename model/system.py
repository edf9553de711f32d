"""`System`: named variables and their equations, written once, from which all else follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from bristle.common.errors import EquationError
from bristle.model.variables import Namespace, Parameter, State, Variable

__all__ = ["DryRow", "System"]

SX = ca.SX

SAMPLE_TIME = Parameter(
    "sample_time", "Ts", "s", 1e-3, 1e-6, 1.0, "sampling period", "dixit2008 section IV-C"
)
TOLERANCE = Parameter(
    "solver.tolerance",
    "tol",
    "1",
    2e-8,
    1e-13,
    1e-2,
    "local error allowed in one internal step, relative to the size of each state",
    "hairer1996 section IV.7",
)
MAX_STEP = Parameter(
    "solver.max_step",
    "h_max",
    "s",
    1e-3,
    1e-7,
    1.0,
    "longest internal step",
    "hairer1996 section IV.7",
)
MAX_STEPS = Parameter(
    "solver.max_steps",
    "n_max",
    "1",
    1e5,
    1.0,
    1e9,
    "internal steps and samples allowed in one communication step",
    "hairer1996 section IV.7",
)
FRICTION_STEP = Parameter(
    "solver.friction_step",
    "h",
    "s",
    1e-4,
    1e-7,
    1e-2,
    "internal step of the set-valued friction (second-order accurate)",
    "moreau1988",
)


@dataclass(frozen=True)
class DryRow:
    """The one row J v' = T - f with f in bound * Sgn(v): state `row`, inertia J and friction bound
    N as expressions.

    `backward`, where given, is the bound against backward motion: f in [-backward, bound] at rest.
    `deflection`, where given, names the state z of bristles with a stiffness and a damping: f =
    stiffness z + damping z', where z' = v - stiffness |v| z / bound, so that f reaches the bound
    with the distance travelled.
    """

    row: str
    inertia: Any
    bound: Any
    backward: Any = None
    deflection: str | None = None
    stiffness: Any = None
    damping: Any = None


@dataclass(frozen=True)
class Directed:
    """How far a system is past a switching point if it moves forward, and if it moves backward; and
    its present speed.
    """

    forward: SX
    backward: SX
    speed: SX


@dataclass
class System:
    """A servo, an observer or a controller as equations over named symbols.

    Continuous states obey x' = f; sampled states change every `sample_time`, either *before* an
    interval is integrated (they use the inputs of its start: delay lines, observers, controllers)
    or *after* it (sensors, which see the states of its end); modes change at the end of an internal
    step; at most one row carries dry friction. A state that `follow`s others has no rate: its value
    at the end of an internal step is a function of theirs.
    """

    name: str
    description: str = ""
    parameters: dict[str, Parameter] = field(default_factory=dict)
    inputs: dict[str, Variable] = field(default_factory=dict)
    outputs: dict[str, tuple[Variable, SX]] = field(default_factory=dict)
    calculated: dict[str, tuple[Variable, SX]] = field(default_factory=dict)
    constants: list[dict[str, SX]] = field(default_factory=list)
    states: dict[str, State] = field(default_factory=dict)
    rates: dict[str, SX] = field(default_factory=dict)
    before: dict[str, State] = field(default_factory=dict)
    after: dict[str, State] = field(default_factory=dict)
    modes: dict[str, State] = field(default_factory=dict)
    updates: dict[str, SX] = field(default_factory=dict)
    margins: dict[str, SX] = field(default_factory=dict)
    directed: dict[str, Directed] = field(default_factory=dict)
    ends: dict[str, SX] = field(default_factory=dict)
    followed: dict[str, SX] = field(default_factory=dict)
    dry: DryRow | None = None
    symbols: dict[str, SX] = field(default_factory=dict)
    time: SX = field(default_factory=lambda: SX.sym("time"))

    # -- declarations; each returns the symbol to write equations with -----------------------------

    def _symbol(self, name: str) -> SX:
        if name in self.symbols:
            raise EquationError(f"system '{self.name}' declares '{name}' twice; rename one of them")
        self.symbols[name] = SX.sym(name)
        return self.symbols[name]

    def parameter(self, parameter: Parameter) -> SX:
        """Declare a parameter; declaring the same one again returns the same symbol."""
        if self.parameters.get(parameter.name) == parameter:
            return self.symbols[parameter.name]
        self.parameters[parameter.name] = parameter
        return self._symbol(parameter.name)

    def input(self, variable: Variable) -> SX:
        """Declare an input, held constant over a communication step."""
        self.inputs[variable.name] = variable
        return self._symbol(variable.name)

    def state(self, state: State) -> SX:
        """Declare a continuous state; give its equation with `rate`."""
        for parameter in (TOLERANCE, MAX_STEP, MAX_STEPS):
            self.parameter(parameter)
        self.states[state.name] = state
        return self._symbol(state.name)

    def sampled(self, state: State, *, after: bool = False) -> SX:
        """Declare a sampled state; give its next value with `update`."""
        for parameter in (SAMPLE_TIME, MAX_STEPS):
            self.parameter(parameter)
        (self.after if after else self.before)[state.name] = state
        return self._symbol(state.name)

    def mode(self, state: State) -> SX:
        """Declare a mode, switched at the end of a step; give its next value with `update`."""
        self.modes[state.name] = state
        return self._symbol(state.name)

    def constant(self, values: dict[str, SX]) -> Namespace:
        """Declare constants computed once, at the start, from parameters and earlier constants."""
        self.constants.append(values)
        return Namespace({name: self._symbol(name) for name in values})

    def calculate(self, variable: Variable, value: SX) -> None:
        """Declare a calculated parameter: public, a function of parameters and constants."""
        self.calculated[variable.name] = (variable, SX(value))

    # -- equations ---------------------------------------------------------------------------------

    def rate(self, name: str, expression: SX) -> None:
        """Set x' of a continuous state."""
        self.rates[name] = SX(expression)

    def end(self, name: str) -> SX:
        """Return the symbol of a continuous state at the end of an internal step, for `follow`."""
        return self.ends.setdefault(name, SX.sym(f"{name}_end"))

    def follow(self, name: str, expression: SX) -> None:
        """Set the value of a continuous state at the end of an internal step; other states may
        enter at both ends of the step.

        For memory that depends on a path and not on time, such as free play: no step then has to
        resolve where it switches.
        """
        self.rates[name] = SX(0)
        self.followed[name] = SX(expression)

    def update(self, name: str, expression: SX) -> None:
        """Set the next value of a sampled state or a mode."""
        self.updates[name] = SX(expression)

    def margin(self, name: str, past: SX, directed: Directed | None = None) -> None:
        """Set how far the system is past the switching point of a mode, relative to its size; at
        most 0 before the point.

        No internal step then overshoots it by more than the tolerance, and derivatives are right
        across it. `directed`: the same by direction, where `past` jumps when the motion reverses.
        """
        self.margins[name] = SX(past)
        if directed is not None:
            self.directed[name] = directed

    def output(self, variable: Variable, expression: SX) -> None:
        """Declare an output and its equation."""
        self.outputs[variable.name] = (variable, SX(expression))

    def dry_friction(
        self,
        row: str,
        inertia: SX,
        bound: SX,
        backward: SX | None = None,
        bristles: tuple[str, SX, SX] | None = None,
    ) -> None:
        """Put dry friction of a bound [N.m] on the rate of `row`, whose inertia is `inertia`.

        `backward` is the bound against backward motion, where it differs; `bristles` (name of the
        deflection's state, stiffness, damping) make it elastic before it slides.
        """
        if self.dry is not None:
            raise EquationError(
                f"system '{self.name}' already has a dry-friction row ('{self.dry.row}'); only one"
                " is allowed"
            )
        self.parameter(FRICTION_STEP)
        self.dry = DryRow(
            row,
            SX(inertia),
            SX(bound),
            None if backward is None else SX(backward),
            *(bristles or ()),
        )

    # -- views -------------------------------------------------------------------------------------

    @property
    def carried(self) -> dict[str, State]:
        """All that is carried from one step to the next."""
        return {**self.states, **self.before, **self.after, **self.modes}

    @property
    def smooth(self) -> bool:
        """True if x' = f(x, u) is all there is: no sampled states, modes, states that follow
        others, or dry friction.
        """
        return bool(self.states) and not (
            self.before or self.after or self.modes or self.followed or self.dry
        )

    def namespace(self, prefix: str = "") -> Namespace:
        """Return all symbols for attribute access."""
        return Namespace(self.symbols, prefix)

    def vector(self, names: Sequence[str]) -> SX:
        """Return the symbols of `names` as a column."""
        return ca.vertcat(*(self.symbols[name] for name in names)) if names else SX(0, 1)

    def rate_vector(self) -> SX:
        """Return x' as a column, in the order of `states` (without the dry friction)."""
        return ca.vertcat(*(self.rates[name] for name in self.states)) if self.states else SX(0, 1)

    def with_followers(self, end: SX) -> SX:
        """Return the states at the end of a step, in the order of `states`, with those that follow
        others put in place.
        """
        names, rows = list(self.states), ca.vertsplit(end) if self.states else []
        reached = [rows[names.index(name)] for name in self.ends]
        for name, expression in self.followed.items():
            [rows[names.index(name)]] = ca.substitute(
                [expression], list(self.ends.values()), reached
            )
        return ca.vertcat(*rows)

    def expand(self, expression: SX) -> SX:
        """Replace the constants in `expression` by their formulas, so that it can be differentiated
        by parameters.
        """
        for values in reversed(self.constants):
            names = list(values)
            [expression] = ca.substitute(
                [expression], [self.vector(names)], [ca.vertcat(*values.values())]
            )
        return expression

    def check(self) -> System:
        """Raise `EquationError` if an equation is missing or has no state; else return self."""
        sampled = {**self.before, **self.after, **self.modes}
        for what, declared, given in (
            ("rate", self.states, self.rates),
            ("update", sampled, self.updates),
        ):
            for name in declared.keys() ^ given.keys():
                raise EquationError(
                    f"system '{self.name}': '{name}' needs both a state and a {what}; add the"
                    " missing one"
                )
        for name in self.margins:
            if name not in self.modes or self.dry is not None:
                raise EquationError(
                    f"system '{self.name}': '{name}' has a margin; only a mode may, and only"
                    " without dry friction"
                )
        if self.dry is not None and self.dry.row not in self.states:
            raise EquationError(
                f"system '{self.name}': dry friction acts on '{self.dry.row}', which is not a state"
            )
        return self
