"""Dependencies of the unknowns of an FMU, derived from the equations."""

from __future__ import annotations

from collections.abc import Iterable

from casadi import SX

from bristle.fmus.interface import Exposed, Interface, symbols_in
from bristle.model.system import System


def _union(sets: Iterable[set[str]]) -> set[str]:
    return set().union(*sets)


def _origins(system: System) -> dict[str, set[str]]:
    """Return, for each symbol, the parameters and inputs it follows from at initialisation."""
    origins = {name: {name} for name in (*system.parameters, *system.inputs, "time")}
    for block in system.constants:
        origins |= {
            name: _union(origins[s] for s in symbols_in(value)) for name, value in block.items()
        }
    return origins | {
        name: _union(origins[s] for s in symbols_in(state.initial))
        for name, state in system.carried.items()
    }


def _expressions(interface: Interface, system: System) -> dict[str, SX]:
    """Return the expression of each unknown: outputs, calculated parameters and, for Model
    Exchange, states and rates.
    """
    found = {
        name: value for name, (_, value) in (*system.outputs.items(), *system.calculated.items())
    }
    for (der, state), name in zip(interface.rates, system.states, strict=False):
        found |= {der.name: system.rates[name], state.name: system.symbols[name]}
    return found


def _select(interface: Interface, names: set[str]) -> list[Exposed]:
    return [x for x in interface.variables if x.name in names]


def structural(interface: Interface) -> dict[str, list[Exposed]]:
    """Return the inputs and shown states that outputs and derivatives depend on at one instant."""
    # own name -> public name
    shown = {state.name.partition(".")[2]: state.name for _, state in interface.rates}
    result: dict[str, set[str]] = {
        x.name: set() for x in (*interface.of("output"), *(der for der, _ in interface.rates))
    }
    for variant in interface.program.variants:
        knowns = {name: name for name in variant.system.inputs} | shown | {"time": "time"}
        for name, expression in _expressions(interface, variant.system).items():
            if name in result:
                result[name] |= {knowns[s] for s in symbols_in(expression) & knowns.keys()}
    return {name: _select(interface, found) for name, found in result.items()}


def initial(interface: Interface) -> dict[str, list[Exposed]]:
    """Return the parameters and inputs that each unknown depends on in initialisation mode."""
    always = {slot.name for slot in interface.program.slots if slot.kind in ("selector", "index")}
    result = {x.name: set(always) for x in interface.of("calculatedParameter", "output", "local")}
    for variant in interface.program.variants:
        origins = _origins(variant.system)
        for name, expression in _expressions(interface, variant.system).items():
            result[name] |= _union(origins[s] for s in symbols_in(expression))
    return {name: _select(interface, found) for name, found in result.items()}
