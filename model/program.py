"""`Program`: one table of variables `v[]` for one or several systems, and its functions.

The index of a variable in `v[]` is its value reference in an FMU. Several variants (friction laws,
observer methods) share the table; each has its own functions, and a selector parameter chooses the
variant at initialisation. For hosts that cannot set an enumeration there is an integer beside it
(0: as the selector says), and an output tells which variant runs.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import casadi as ca

from bristle.common.errors import BristleError
from bristle.common.units import per_second
from bristle.model.proximal import Unknown, proximal
from bristle.model.rosenbrock import rodas
from bristle.model.switching import at_the_point
from bristle.model.system import FRICTION_STEP, MAX_STEP, MAX_STEPS, SAMPLE_TIME, System
from bristle.model.variables import Parameter, Variable

__all__ = ["Program"]

SX = ca.SX
Block = tuple[Any, Sequence[int]]  # an expression, and where its entries are written to

# functions that are present even where they have nothing to do
ALWAYS = ("derive", "start", "outputs")


@dataclass(frozen=True)
class Slot:
    """One place of `v[]`.

    Its kind is time, selector, index, running, parameter, calculated, hidden, input, output, state,
    der, sampled or mode.
    """

    index: int
    name: str
    kind: str
    variable: Variable | Parameter
    start: float


@dataclass(frozen=True)
class Kernel:
    """A generated function of `v[]` and the step length h.

    `blocks` are evaluated one after another; each writes its results to `targets`: indices of
    `v[]`, or of a separate result array where `to_output` is set.
    """

    name: str
    blocks: tuple[tuple[ca.Function, tuple[int, ...]], ...]
    reads: tuple[int, ...]  # index in v[] of each entry of the functions' first argument
    to_output: bool = False


@dataclass
class Variant:
    """What the core needs of one system: its functions (`make`) and the places of its states."""

    system: System
    make: Callable[[], dict[str, Kernel]]
    states: tuple[int, ...] = ()
    ders: tuple[int, ...] = ()
    finite: tuple[int, ...] = ()  # places that must stay finite
    sample_time: int = -1
    max_step: int = -1
    max_steps: int = -1
    friction_step: int = -1

    @cached_property
    def kernels(self) -> dict[str, Kernel]:
        """All functions by name, made when the first is asked for: a program whose library is at
        hand needs none.
        """
        return self.make()

    def kept(self) -> dict[str, Kernel]:
        """Return the functions the core can call: those with something to do, and those it calls
        always.
        """
        return {
            name: kernel for name, kernel in self.kernels.items() if kernel.blocks or name in ALWAYS
        }


def _solved(values: SX, unknowns: Sequence[Unknown]) -> SX:
    """Put the solutions in place of the unknowns; later ones may contain earlier ones."""
    for unknown in reversed(unknowns):
        [values] = ca.substitute([values], [unknown.symbol], [unknown.solution])
    return values


def _own(system: System, name: str) -> str:
    """A state or constant belongs to its system, so that an output or a parameter may carry the
    same short name.
    """
    return f"{system.name}.{name}"


def _numbered(systems: Sequence[System]) -> str:
    return ", ".join(f"{number} {system.name}" for number, system in enumerate(systems, start=1))


class Program:
    """A named set of systems over one variable table.

    Parameters
    ----------
    name : str
        Model name, such as ``ServoPlant``.
    systems : sequence of System
        The variants; inputs and outputs must agree.
    selector : str, optional
        Name of the parameter that chooses the variant; needed for more than one.
    sensitivities : sequence of str, optional
        Parameters for which the derivative of the internal step is generated too.
    observed : str, optional
        Output whose derivative by states and these parameters is generated too.
    """

    def __init__(
        self,
        name: str,
        systems: Sequence[System],
        selector: str | None = None,
        description: str = "",
        sensitivities: Sequence[str] = (),
        observed: str | None = None,
    ) -> None:
        if len(systems) > 1 and selector is None:
            raise BristleError(
                f"program '{name}' has {len(systems)} variants and needs a selector name"
            )
        self.name, self.description = name, description or systems[0].description
        self.selector = selector if len(systems) > 1 else None
        self.sensitivities, self.observed = tuple(sensitivities), observed
        self.chosen = 0  # number of the variant that is chosen where nothing else is said
        self.slots: list[Slot] = []
        self.index: dict[str, int] = {}
        self._layout(systems)
        self.variants = [self._variant(system.check()) for system in systems]

    # -- layout ------------------------------------------------------------------------------------

    def _add(
        self, name: str, kind: str, variable: Variable | Parameter, start: float = 0.0
    ) -> None:
        if name in self.index:
            known = self.slots[self.index[name]]
            if known.kind != kind or known.variable != variable:
                raise BristleError(
                    f"program '{self.name}': '{name}' is declared in two different ways; make them"
                    " equal"
                )
            return
        self.index[name] = len(self.slots)
        self.slots.append(Slot(len(self.slots), name, kind, variable, start))

    def _layout(self, systems: Sequence[System]) -> None:
        self._add("time", "time", Variable("time", "s", "simulation time"))
        if self.selector:
            index = Variable(f"{self.selector}_index", "1", self._index_text(systems))
            self._add(self.selector, "selector", Variable(self.selector, "1", "variant"), 1.0)
            self._add(index.name, "index", index)
        for system in systems:
            for parameter in system.parameters.values():
                self._add(parameter.name, "parameter", parameter, parameter.default)
        for system in systems:
            for variable, _ in system.calculated.values():
                self._add(variable.name, "calculated", variable)
        for system in systems:
            for variable in system.inputs.values():
                self._add(variable.name, "input", variable, variable.start)
        for system in systems:
            for variable, _ in system.outputs.values():
                self._add(variable.name, "output", variable)
        if self.selector:
            running = Variable(
                f"{self.selector}_running",
                "1",
                f"number of the {self.selector} that runs: {_numbered(systems)}",
            )
            self._add(running.name, "running", running, 1.0)
        for system in systems:
            self._add_own(system)

    def _add_own(self, system: System) -> None:
        """Add what no other system shares: constants, states and their rates."""
        for name in (name for block in system.constants for name in block):
            self._add(_own(system, name), "hidden", Variable(name, "1", "constant"))
        for state in system.states.values():
            self._add(_own(system, state.name), "state", state)
            if system.smooth:
                unit, meaning = per_second(state.unit), f"rate of {state.description}"
                rate = Variable(state.name, unit, meaning)
                self._add(f"der({_own(system, state.name)})", "der", rate)
        groups = (("sampled", {**system.before, **system.after}), ("mode", system.modes))
        for kind, group in groups:
            for state in group.values():
                self._add(_own(system, state.name), kind, state)

    def _index_text(self, systems: Sequence[System]) -> str:
        return (
            f"number of the {self.selector}, for hosts that set no enumeration; 0: as"
            f" {self.selector} says; {_numbered(systems)}"
        )

    @property
    def choice(self) -> tuple[int, int, int]:
        """The places of the selector, its integer twin and the output that tells which variant
        runs; -1 for a single variant.
        """
        places = [
            slot.index for slot in self.slots if slot.kind in ("selector", "index", "running")
        ]
        return (places[0], places[1], places[2]) if places else (-1, -1, -1)

    def place(self, system: System, name: str) -> int:
        """Return the place in `v[]` of a symbol of a system."""
        shared = name in system.parameters or name in system.inputs
        return self.index[name if shared else _own(system, name)]

    def _places(self, system: System, names: Iterable[str]) -> tuple[int, ...]:
        return tuple(self.place(system, name) for name in names)

    # -- kernels -----------------------------------------------------------------------------------

    def _kernel(
        self, system: System, name: str, blocks: Iterable[Block], h: SX, to_output: bool = False
    ) -> Kernel:
        names = list(system.symbols)
        arguments = ca.vertcat(system.time, system.vector(names))
        reads = (0, *(self.place(system, n) for n in names))
        made = []
        for expression, targets in blocks:
            [dense] = ca.cse([ca.densify(SX(expression))])
            made.append((ca.Function(name, [arguments, h], [dense]), tuple(targets)))
        return Kernel(f"{system.name}_{name}", tuple(made), reads, to_output)

    def _variant(self, system: System) -> Variant:
        def parameter(declared: Parameter) -> int:
            return self.index[declared.name] if declared.name in system.parameters else -1

        for name in self.sensitivities:
            if name not in system.parameters:
                raise BristleError(
                    f"'{name}' is no parameter of '{system.name}'; known:"
                    f" {', '.join(system.parameters)}"
                )
        return Variant(
            system,
            partial(self._kernels, system),
            states=self._places(system, system.states),
            ders=(
                tuple(self.index[f"der({_own(system, n)})"] for n in system.states)
                if system.smooth
                else ()
            ),
            finite=self._places(system, system.carried),
            sample_time=parameter(SAMPLE_TIME) if system.before or system.after else -1,
            max_step=parameter(MAX_STEP),
            max_steps=parameter(MAX_STEPS),
            friction_step=parameter(FRICTION_STEP),
        )

    def _kernels(self, system: System) -> dict[str, Kernel]:
        h = SX.sym("h")

        def values(pairs: dict[str, SX]) -> Block:
            return ca.vertcat(*pairs.values()), self._places(system, pairs)

        def public(pairs: dict[str, tuple[Variable, SX]]) -> list[Block]:
            if not pairs:
                return []
            shown = ca.vertcat(*(expression for _, expression in pairs.values()))
            return [(shown, tuple(self.index[name] for name in pairs))]

        constants = [values(block) for block in system.constants]
        initial = {name: SX(state.initial) for name, state in system.carried.items()}
        blocks: dict[str, list[Block]] = {
            "derive": [*constants, *public(system.calculated)],
            "start": [values(initial)],
            "outputs": public(system.outputs),
        }
        groups = {"before": system.before, "after": system.after, "modes": system.modes}
        for name, sampled in groups.items():
            blocks[name] = [values({n: system.updates[n] for n in sampled})] if sampled else []
        # what is written to `v[]`, then what is handed out
        made = {name: self._kernel(system, name, each, h) for name, each in blocks.items()}
        for name, each in (self._step(system, h) | self._smooth(system)).items():
            made[name] = self._kernel(system, name, [each], h, to_output=True)
        return made

    def _step(self, system: System, h: SX) -> dict[str, Block]:
        """Return the internal step of length h, and the derivatives that are asked for."""
        if not system.states:
            return {}
        n = len(system.states)
        unknowns: list[Unknown] = []
        if system.dry:
            end, unknowns = proximal(system, h)
            error = SX(0)
        else:
            end, error = rodas(system, h)
        step = ca.vertcat(system.with_followers(end), error)
        found: dict[str, Block] = {"step": (_solved(step, unknowns), range(n + 1))}
        if self.sensitivities:
            # the step itself beside: both share most of their work
            slopes = self._derivative(system, at_the_point(system, step[:n], h), unknowns)[0]
            both = ca.vertcat(slopes, _solved(step[:n], unknowns))
            found["step_jacobian"] = both, range(both.numel())
        if self.sensitivities and self.observed:
            found["seen_jacobian"] = self._derivative(system, system.outputs[self.observed][1])
        return found

    def _smooth(self, system: System) -> dict[str, Block]:
        """Return the rates of a smooth system, and the Jacobian of rates and outputs by states and
        inputs.
        """
        if not system.smooth:
            return {}
        outputs = (expression for _, expression in system.outputs.values())
        found = ca.vertcat(system.rate_vector(), *outputs)
        knowns = system.vector([*system.states, *system.inputs])
        jacobian = ca.vec(ca.jacobian(found, knowns).T)
        return {
            "rates": (system.rate_vector(), range(len(system.states))),
            "jacobian": (jacobian, range(jacobian.numel())),
        }

    def _derivative(self, system: System, values: SX, unknowns: Sequence[Unknown] = ()) -> Block:
        """Return d(values)/d(x, chosen parameters), row-major; constants and what is solved for are
        differentiated too.
        """
        knowns = system.vector([*system.states, *self.sensitivities])
        jacobian = ca.jacobian(system.expand(values), knowns)
        slopes: list[tuple[SX, SX]] = []  # of the unknowns by the knowns: implicit function theorem
        for unknown in unknowns:
            equation = system.expand(unknown.equation)
            by_known = ca.jacobian(equation, knowns)
            for symbol, slope in slopes:
                by_known += ca.jacobian(equation, symbol) @ slope
            slopes.append((unknown.symbol, -by_known / ca.jacobian(equation, unknown.symbol)))
            jacobian += ca.jacobian(system.expand(values), unknown.symbol) @ slopes[-1][1]
        jacobian = _solved(
            jacobian, [replace(u, solution=system.expand(u.solution)) for u in unknowns]
        )
        return ca.vec(jacobian.T), range(jacobian.numel())

    # -- identity ----------------------------------------------------------------------------------

    @property
    def starts(self) -> list[float]:
        """The content of `v[]` before anything is set."""
        return [slot.start for slot in self.slots]

    def preset(self, values: Mapping[str, float]) -> Program:
        """Return the same program with other start values of parameters [SI].

        Raises
        ------
        BristleError
            If one is no parameter of this program, or outside its interval.
        """
        known = [slot.name for slot in self.slots if slot.kind == "parameter"]
        for name in values:
            if name not in known:
                raise BristleError(
                    f"'{name}' is no parameter of {self.name}; known: {', '.join(known)}"
                )
        made = copy.copy(self)
        made.slots = [
            (
                replace(slot, start=float(slot.variable.check(values[slot.name])))
                if isinstance(slot.variable, Parameter) and slot.name in values
                else slot
            )
            for slot in self.slots
        ]
        return made

    def choosing(self, variant: str) -> Program:
        """Return the same program, which runs another variant where nothing else is said."""
        made = copy.copy(self)
        made.chosen = [each.system.name for each in self.variants].index(variant)
        made.slots = [
            replace(slot, start=made.chosen + 1.0) if slot.kind in ("selector", "running") else slot
            for slot in self.slots
        ]
        return made

    def in_units(self, of: Callable[[str, str], str]) -> Program:
        """Return the same program with other units declared; `of` gives that of a variable, from
        its name and its unit now.

        Numbers stay what they are: equations hold in any consistent set of units.
        """
        made = copy.copy(self)
        made.slots = [
            replace(slot, variable=replace(slot.variable, unit=of(slot.name, slot.variable.unit)))
            for slot in self.slots
        ]
        return made

    @property
    def token(self) -> str:
        """A GUID / instantiation token that follows from the interface alone."""
        lines = [f"{s.index} {s.name} {s.kind} {s.variable.unit} {s.start!r}" for s in self.slots]
        digest = hashlib.sha256("\n".join([self.name, *lines]).encode()).hexdigest()
        return f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"
