"""Variables of a program as FMI exposes them: type, causality and limits, also as C tables."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from bristle.model.program import Program, Slot, Variant
from bristle.model.system import FRICTION_STEP, MAX_STEP, MAX_STEPS, SAMPLE_TIME, TOLERANCE
from bristle.model.variables import Parameter, State

SX = ca.SX

CAUSALITY = {
    "time": "independent",
    "selector": "parameter",
    "index": "parameter",
    "parameter": "parameter",
    "calculated": "calculatedParameter",
    "input": "input",
    "output": "output",
    "running": "output",
    "state": "local",
    "der": "local",
}
# when what is computed
SCHEDULE = tuple(each.name for each in (SAMPLE_TIME, TOLERANCE, MAX_STEP, MAX_STEPS, FRICTION_STEP))
INITIAL = {
    "parameter": "exact",
    "calculatedParameter": "calculated",
    "output": "calculated",
    "local": "calculated",
}


@dataclass(frozen=True)
class Exposed:
    """A variable of the FMU; value reference and start are those of its slot."""

    slot: Slot
    type: str  # Real, Enumeration, Integer or Boolean
    causality: str
    variability: str
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None

    @property
    def name(self) -> str:
        return self.slot.name

    @property
    def reference(self) -> int:
        return self.slot.index

    @property
    def initial(self) -> str | None:
        return INITIAL.get(self.causality)

    @property
    def checked(self) -> tuple[float | None, float | None]:
        """The limits that a call which sets it obeys; the index's are checked at initialisation.

        A host that ignores the status of the call then cannot run the default instead.
        """
        return (None, None) if self.slot.kind == "index" else (self.minimum, self.maximum)

    @property
    def settable(self) -> bool:
        return self.causality in ("parameter", "input")

    @property
    def settable_late(self) -> bool:
        """True if it may be set between steps as well."""
        return self.causality == "input" or self.variability == "tunable"


def symbols_in(expression: SX) -> set[str]:
    """Return the names of the symbols in an expression."""
    return {symbol.name() for symbol in ca.symvar(SX(expression))}


def tunable_parameters(program: Program) -> frozenset[str]:
    """Return the parameters that may change between steps: nothing that is computed only once, at
    the start, contains them.

    That leaves gains, limits, memories, and the sizes of effects. What says when something is
    computed stays as it is.
    """
    fixed = set(SCHEDULE)
    for system in (variant.system for variant in program.variants):
        once = [value for block in system.constants for value in block.values()]
        once += [value for _, value in system.calculated.values()] + [
            state.initial for state in system.carried.values()
        ]
        fixed = fixed.union(*map(symbols_in, once))
    return frozenset(
        slot.name for slot in program.slots if slot.kind == "parameter" and slot.name not in fixed
    )


class Interface:
    """The variables of a program as a host sees them.

    States and derivatives are shown only where Model Exchange is offered: native, one variant, and
    a smooth one.
    """

    def __init__(self, program: Program, native: bool = True) -> None:
        self.program, self.tunable = program, tunable_parameters(program)
        self.exchange = native and len(program.variants) == 1 and program.variants[0].system.smooth
        self.variables = [self._exposed(slot) for slot in program.slots if self._shown(slot)]

    def _shown(self, slot: Slot) -> bool:
        return slot.kind in CAUSALITY and (self.exchange or slot.kind not in ("state", "der"))

    def _exposed(self, slot: Slot) -> Exposed:
        variable, causality = slot.variable, CAUSALITY[slot.kind]
        if isinstance(variable, Parameter):
            variability = "tunable" if slot.name in self.tunable else "fixed"
            return Exposed(slot, "Real", causality, variability, variable.minimum, variable.maximum)
        if slot.kind == "selector":
            return Exposed(slot, "Enumeration", causality, "fixed", 1, len(self.program.variants))
        if slot.kind == "index":
            return Exposed(slot, "Integer", causality, "fixed", 0, len(self.program.variants))
        if slot.kind == "running":
            return Exposed(slot, "Integer", causality, "discrete", 1, len(self.program.variants))
        if slot.kind == "calculated":
            return Exposed(slot, "Boolean" if variable.boolean else "Real", causality, "fixed")
        if variable.boolean:
            return Exposed(slot, "Boolean", causality, "discrete")
        variability = (
            "discrete" if slot.kind == "output" and not self._moves(slot.name) else "continuous"
        )
        nominal = (
            self._size(slot.variable) if isinstance(slot.variable, State) else variable.nominal
        )
        return Exposed(
            slot, "Real", causality, variability, variable.minimum, variable.maximum, nominal
        )

    def _moves(self, output: str) -> bool:
        """True if an output can change between samples: by a continuous state, an input or time."""
        for variant in self.program.variants:
            system = variant.system
            if output in system.outputs and symbols_in(system.outputs[output][1]) & {
                *system.states,
                *system.inputs,
                "time",
            }:
                return True
        return False

    def _size(self, state: State) -> float:
        """Return the size of a state at the start values of the parameters: what its integration
        tolerance is relative to.
        """
        system = self.program.variants[0].system
        names = list(system.parameters)
        size = ca.Function("size", [system.vector(names)], [system.expand(SX(state.scale))])
        value = abs(float(size([self.program.starts[self.program.index[name]] for name in names])))
        return value if 0.0 < value < math.inf else 1.0

    @property
    def sample_time(self) -> float | None:
        """Start value of the sample time [s], None where nothing is sampled."""
        return next(
            (slot.start for slot in self.program.slots if slot.name == SAMPLE_TIME.name), None
        )

    @property
    def continuous(self) -> bool:
        """True if some variant has continuous states."""
        return any(variant.system.states for variant in self.program.variants)

    @property
    def items(self) -> list[str]:
        """The names behind the selector's values 1, 2, ..."""
        return [variant.system.name for variant in self.program.variants]

    def of(self, *causalities: str) -> list[Exposed]:
        """Return the variables of some causalities, in the order of their value references."""
        return [x for x in self.variables if x.causality in causalities]

    @cached_property
    def rates(self) -> list[tuple[Exposed, Exposed]]:
        """Pairs (derivative, state); empty without Model Exchange."""
        if not self.exchange:
            return []
        at = {x.reference: x for x in self.variables}
        variant = self.program.variants[0]
        return [
            (at[der], at[state]) for der, state in zip(variant.ders, variant.states, strict=True)
        ]


# -- C tables --------------------------------------------------------------------------------------


def _moving(variant: Variant) -> tuple[int, int]:
    """Return the range of `v[]` that a step of a variant changes, without outputs: first index and
    length.
    """
    places = [*variant.states, *variant.ders, *variant.finite]
    return (min(places), max(places) - min(places) + 1) if places else (0, 0)


def _number(value: float | None, unlimited: str) -> str:
    return unlimited if value is None else repr(float(value))


def _table(declaration: str, values: Iterable[object]) -> str:
    return f"const {declaration} = {{{', '.join(map(str, values))}}};"


def _jacobian_places(interface: Interface) -> tuple[list[int], list[int]]:
    """Return the row of each variable as unknown and its column as known in the Jacobian, or -1."""
    program = interface.program
    row, column = [-1] * len(program.slots), [-1] * len(program.slots)
    if interface.exchange:
        variant = program.variants[0]
        system = variant.system
        for k, place in enumerate(
            [*variant.ders, *(program.index[name] for name in system.outputs)]
        ):
            row[place] = k
        for k, place in enumerate(
            [*variant.states, *(program.index[name] for name in system.inputs)]
        ):
            column[place] = k
    return row, column


def _seen(exposed: Exposed | None) -> tuple[str, ...]:
    """Return access, limits, nominal value, name and unit of a variable, as C."""
    if exposed is None:
        return "0", "-DBL_MAX", "DBL_MAX", "1.0", '""', '""'
    low, high = exposed.checked
    numbers = (low, "-DBL_MAX"), (high, "DBL_MAX"), (exposed.nominal, "1.0")
    texts = exposed.name, exposed.slot.variable.unit
    return _access(exposed), *(_number(*each) for each in numbers), *(f'"{each}"' for each in texts)


def _access(exposed: Exposed) -> str:
    bits = [exposed.type.upper()]
    if exposed.settable:
        bits.append("SET_EARLY")
    if exposed.settable_late:
        bits.append("SET_LATE")
    if exposed.slot.kind == "state":
        bits.append("SET_STATE")
    return " | ".join(bits)


def c_tables(interface: Interface, fmi: int) -> dict[str, str]:
    """Return interface.h and interface.c."""
    return {"interface.h": _header(interface), "interface.c": _tables(interface, fmi)}


def _header(interface: Interface) -> str:
    program = interface.program
    known = sum(1 for place in _jacobian_places(interface)[1] if place >= 0)
    salt = program.token.strip("{}").replace("-", "")[:16]
    return f"""/* What the host sees of {program.name} (generated) */
#ifndef BRISTLE_INTERFACE_H
#define BRISTLE_INTERFACE_H

#include "model.h"

#define TOKEN "{program.token}"
#define TOKEN_SALT 0x{salt}u
#define SMOOTH {int(interface.exchange)} /* Model Exchange and derivatives are offered */
#define N_KNOWN {known} /* columns of the Jacobian */

enum {{ REAL = 1, ENUMERATION = 2, BOOLEAN = 4, INTEGER = 8 }};
enum {{ SET_EARLY = 16, SET_LATE = 32, SET_STATE = 64 }}; /* before the end of initialization, after it, in Model Exchange */

extern const unsigned char ACCESS[N_V];
extern const double LOW[N_V], HIGH[N_V], NOMINAL[N_V];
extern const char *const NAME[N_V], *const UNIT[N_V];
extern const short ROW[N_V], COLUMN[N_V]; /* place in the Jacobian as unknown, as known; -1: none */
extern const int MOVING[N_VARIANTS][2];   /* first and number of the places in v[] that a step changes */

#endif
"""


def _tables(interface: Interface, fmi: int) -> str:
    program = interface.program
    by_place = {x.reference: x for x in interface.variables}
    if fmi == 2:
        by_place = {k: x for k, x in by_place.items() if x.causality != "independent"}
    each = [by_place.get(slot.index) for slot in program.slots]
    access, low, high, nominal, names, units = zip(*map(_seen, each), strict=True)
    row, column = _jacobian_places(interface)
    moving = [f"{{{first}, {number}}}" for first, number in map(_moving, program.variants)]
    body = [
        f"/* What the host sees of {program.name} (generated) */",
        '#include "interface.h"',
        "",
        "#include <float.h>",
        "",
        _table("unsigned char ACCESS[N_V]", access),
        _table("double LOW[N_V]", low),
        _table("double HIGH[N_V]", high),
        _table("double NOMINAL[N_V]", nominal),
        _table("char *const NAME[N_V]", names),
        _table("char *const UNIT[N_V]", units),
        _table("short ROW[N_V]", row),
        _table("short COLUMN[N_V]", column),
        _table("int MOVING[N_VARIANTS][2]", moving),
        "",
    ]
    return "\n".join(body)
