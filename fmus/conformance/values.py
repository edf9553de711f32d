"""Points of values: starts, access, ranges, declared dependencies and derivatives."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from ctypes import byref, c_double, c_uint
from typing import Any

import numpy as np

from bristle.fmus.conformance.instance import REALS, TAKEN, CallFailed, Instance, Subject
from bristle.fmus.conformance.registry import Severity
from bristle.fmus.conformance.running import (
    NotApplicable,
    Run,
    ask,
    behaviour,
    moved_inputs,
    numbers,
    refused,
    within,
)

SAME_START = 1e-9  # relative difference that writing a start value in decimals may make
LEAST_MANY = 2  # variables in one call
UNLIKELY = 1.2345e300  # a number that no variable has
NUDGE = 1e-3  # share by which a value is moved to see what depends on it
DIFFERENCE_SHARE = 1e-6  # share by which a value is moved for a difference quotient
SAME_SLOPE = 1e-3  # relative difference of a derivative and a difference quotient
TRUTHS = {"true": 1.0, "false": 0.0}


def starts(subject: Subject, name: str) -> list[Any]:
    """Return the start values of a variable: numbers, or text."""
    v = subject.variables[name]
    if v.type == "String":
        return [v.start]
    given = v.start if isinstance(v.start, list | tuple) else str(v.start).split()
    found = [TRUTHS[str(each)] if str(each) in TRUTHS else float(each) for each in given]
    return [float(np.float32(each)) for each in found] if v.type == "Float32" else found


def set_to_start(instance: Instance, name: str) -> int:
    """Set a variable to its own start value and return the status."""
    subject = instance.subject
    kind = subject.variables[name].type
    given = starts(subject, name)
    if kind == "String":
        return instance.write(name, [str(each).encode() for each in given])
    if kind == "Boolean":
        return instance.write(name, [bool(each) for each in given])
    return instance.write(name, given if kind in REALS else [int(each) for each in given])


def same(expected: Any, found: Any) -> bool:
    """Say whether a value that was read is the one of the description."""
    if isinstance(expected, str):
        return bool(found == expected.encode())
    return math.isclose(float(found), expected, rel_tol=SAME_START, abs_tol=0.0) or (
        math.isnan(expected) and math.isnan(found)
    )


def exact(subject: Subject) -> list[str]:
    """Return the variables whose value in initialisation mode is the declared start."""
    found = [
        name
        for name, v in subject.variables.items()
        if v.start is not None and subject.is_accessible(name)
    ]
    return [
        name
        for name in found
        if subject.variables[name].initial == "exact"
        or subject.variables[name].causality == "input"
    ]


@behaviour(
    "run-starts", "inputs, parameters and what is exact have the start values of the description"
)
def _starts(subject: Subject) -> Iterator[str]:
    with Instance(subject) as instance:
        instance.enter()  # before it, FMI 2 allows to read nothing
        for name in exact(subject):
            expected, found = starts(subject, name), instance.get(name)
            if len(expected) == len(found) and not all(map(same, expected, found)):
                yield (
                    f"{name}: {' '.join(map(str, found))} instead of"
                    f" {subject.variables[name].start}"
                )


@behaviour("run-finite", "every output is finite, at the start and in the first steps")
def _finite(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin()
        for name, values in zip(run.columns, run.steps().T, strict=True):
            bad = np.flatnonzero(~np.isfinite(values))
            if len(bad):
                yield f"{name}: {values[bad[0]]} after {bad[0]} steps"


@behaviour("run-range", "outputs stay within their min and max", Severity.warning)
def _range(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin()
        for name, values in zip(run.columns, run.steps().T, strict=True):
            low, high = subject.interval(name)
            bad = np.flatnonzero((values < low) | (values > high))
            if len(bad):
                yield f"{name}: {values[bad[0]]:g} outside {low:g} to {high:g} after {bad[0]} steps"


@behaviour("run-readable", "every variable can be read, in initialisation and between steps")
def _readable(subject: Subject) -> Iterator[str]:
    names = [name for name in subject.variables if subject.is_accessible(name)]
    if not names:
        raise NotApplicable("it has no variable that can be read at any time")
    with Run(subject) as run:
        run.instance.enter()
        yield from _unreadable(run.instance, names, "in initialisation mode")
        run.instance.leave()
        run.step()
        yield from _unreadable(run.instance, names, "after a step")


def _unreadable(instance: Instance, names: Sequence[str], when: str) -> Iterator[str]:
    for name in names:
        status, values = instance.read(name)
        if status > TAKEN:
            yield f"{name}: status {status} {when}"
        elif None in values:
            yield f"{name}: NULL in place of text {when}"


@behaviour(
    "run-settable",
    "parameters and inputs take their own start values, where the standard allows to set them",
)
def _settable(subject: Subject) -> Iterator[str]:
    given = [
        name
        for name in exact(subject)
        if subject.variables[name].causality in ("parameter", "input")
    ]
    if not given:
        raise NotApplicable("it has neither parameters nor inputs")
    with Run(subject) as run:
        yield from _not_set(run.instance, given, "before initialisation")
        run.instance.enter()
        yield from _not_set(run.instance, given, "in initialisation mode")
        run.instance.leave()
        run.advance(run.h)
        inputs = [name for name in given if subject.variables[name].causality == "input"]
        yield from _not_set(run.instance, inputs, "after a step")


def _not_set(instance: Instance, names: Sequence[str], when: str) -> Iterator[str]:
    for name in names:
        status = set_to_start(instance, name)
        if refused(status):
            yield f"{name}: status {status} {when}{instance.last_message()}"


@behaviour("run-kept", "parameters and inputs that are set before initialisation are kept")
def _kept(subject: Subject) -> Iterator[str]:
    with Run(subject, moved=False) as run:
        taken = run.tune("parameter", "input")
        if not taken:
            raise NotApplicable("it takes no other values of real parameters or inputs")
        try:
            run.begin()
        except CallFailed as error:
            raise NotApplicable(f"it does not run with other values: {error}") from None
        for name, value in taken.items():
            expected = (
                float(np.float32(value)) if subject.variables[name].type == "Float32" else value
            )
            found = run.instance.number(name)
            if found != expected:
                yield f"{name}: {found:.17g} instead of {expected:.17g}"


@behaviour("run-many", "several variables in one call are read and set as one by one")
def _many(subject: Subject) -> Iterator[str]:
    names = [
        name
        for name, v in subject.variables.items()
        if v.type in ("Real", "Float64") and subject.is_accessible(name)
    ]
    if len(names) < LEAST_MANY:
        raise NotApplicable("it has less than two real variables")
    with Run(subject) as run:
        run.begin()
        run.steps(2)
        one_by_one = [(name, value) for name in names for value in run.instance.get(name)]
        values = (c_double * len(one_by_one))()
        if refused(run.instance.many("Get", names, values)):
            yield "several real variables cannot be read in one call"
        for (name, expected), found in zip(one_by_one, values, strict=True):
            if found != expected and not math.isnan(expected):
                yield f"{name}: {found:.17g} instead of {expected:.17g}"
        yield from _set_many(run)


def _set_many(run: Run) -> Iterator[str]:
    """Give the inputs that are not set in one call as one by one."""
    names = [
        name
        for name in run.subject.scalars("input")
        if run.subject.variables[name].type in ("Real", "Float64")
    ]
    values = [
        within(run.subject, name, run.instance.number(name) * (1 + NUDGE) + NUDGE) for name in names
    ]
    if len(names) >= LEAST_MANY and not any(
        refused(run.instance.write(n, [x])) for n, x in zip(names, values, strict=True)
    ):
        run.move()
        if refused(run.instance.many("Set", names, (c_double * len(names))(*values))):
            yield "several inputs cannot be set in one call"
        for name, value in zip(names, values, strict=True):
            if run.instance.number(name) != value:
                yield f"{name}: {run.instance.number(name):.17g} instead of {value:.17g}"


@behaviour("run-sizes", "a getter writes no more numbers than there is room for", Severity.warning)
def _sizes(subject: Subject) -> Iterator[str]:
    if subject.fmi == 2:
        raise NotApplicable("FMI 2 does not tell the room")
    names = [
        name
        for name, v in subject.variables.items()
        if v.type == "Float64" and subject.is_accessible(name)
    ]
    with Run(subject) as run:
        run.begin()
        for name in names:
            room = (c_double * subject.count(name))(*([UNLIKELY] * subject.count(name)))
            run.instance.call(
                "GetFloat64", byref(c_uint(subject.reference(name))), 1, room, len(room) - 1
            )
            if room[len(room) - 1] != UNLIKELY:
                yield f"{name}: {len(room)} numbers are written into room for {len(room) - 1}"


# -- dependencies ----------------------------------------------------------------------------------


def undeclared(instance: Instance, unknowns: Sequence[Any], knowns: Sequence[str]) -> Iterator[str]:
    """Give the unknowns that change with a known value on which they are not declared to depend."""
    subject = instance.subject
    watched = [
        u for u in unknowns if u.dependencies is not None and subject.is_accessible(u.variable.name)
    ]
    before = {u.variable.name: instance.get(u.variable.name) for u in watched}
    for known in knowns:
        value = instance.number(known)
        moved = within(
            subject,
            known,
            value + NUDGE * (abs(value) + float(subject.variables[known].nominal or 1.0)),
        )
        if moved == value or refused(instance.write(known, [moved])):
            continue
        for u in watched:
            name, declared = u.variable.name, {v.name for v in u.dependencies}
            if known not in declared and name != known and instance.get(name) != before[name]:
                yield f"{name} changes with {known}, on which it is not declared to depend"
        instance.write(known, [value])


@behaviour(
    "run-dependencies",
    "in initialisation, unknowns depend on what they are declared to depend on alone",
)
def _dependencies(subject: Subject) -> Iterator[str]:
    unknowns = [u for u in subject.description.initialUnknowns if u.dependencies is not None]
    knowns = [name for name in subject.scalars("parameter", "input") if name in set(exact(subject))]
    if not unknowns or not knowns:
        raise NotApplicable(
            "it declares no dependencies of initial unknowns on numbers that can be set"
        )
    with Instance(subject) as instance:
        instance.enter()
        yield from undeclared(instance, unknowns, knowns)


@behaviour("run-feedthrough", "between steps, outputs depend directly on the declared inputs alone")
def _feedthrough(subject: Subject) -> Iterator[str]:
    unknowns = [u for u in subject.description.outputs if u.dependencies is not None]
    if not unknowns or not subject.scalars("input"):
        raise NotApplicable("it declares no dependencies of outputs, or has no real input")
    with Run(subject) as run:
        run.begin()
        run.steps(2)
        yield from undeclared(run.instance, unknowns, subject.scalars("input"))


# -- derivatives -----------------------------------------------------------------------------------


def slopes(
    instance: Instance, unknowns: Sequence[str], known: str, size: float
) -> tuple[Any, Any, Any]:
    """Return difference quotients of some variables by a known one: to the right, to the left, and
    their rounding errors.
    """
    value = instance.number(known)
    h = DIFFERENCE_SHARE * max(abs(value), size)
    rows = []
    for each in (value, value + h, value - h):
        if refused(instance.write(known, [each])):
            raise NotApplicable(f"{known} = {each:g} is refused")
        rows.append(np.array([instance.number(name) for name in unknowns]))
    instance.write(known, [value])
    middle, up, down = rows
    return (up - middle) / h, (middle - down) / h, np.spacing(np.abs(middle)) / h


def wrong_slopes(
    instance: Instance, unknowns: Sequence[str], known: str, size: float, *, quiet: bool = False
) -> Iterator[str]:
    """Give the variables whose directional derivative by a known one is no difference quotient.

    Where the quotients to both sides differ there is no derivative to compare. `quiet`: a variable
    that does not move is not judged, because it may be computed in the next step.
    """
    right, left, rounding = slopes(instance, unknowns, known, size)
    given = np.array(instance.directional(unknowns, [known], [1.0]))
    middle = (right + left) / 2
    allowed = SAME_SLOPE * np.maximum(np.abs(middle), np.abs(given)) + 100 * rounding
    smooth = np.abs(right - left) <= allowed
    for k in map(int, np.flatnonzero(smooth & ~(np.abs(given - middle) <= allowed))):
        if not quiet or middle[k] != 0:
            yield f"{unknowns[k]} by {known}: {given[k]:.6g} instead of {middle[k]:.6g}"


def not_linear(instance: Instance, unknowns: Sequence[str], knowns: Sequence[str]) -> Iterator[str]:
    """Give the variables whose directional derivative in a mixed direction is not the sum of those
    by each known one.
    """
    seed = [1.0 + k for k in range(len(knowns))]
    parts = np.array(
        [
            instance.directional(unknowns, [known], [share])
            for known, share in zip(knowns, seed, strict=True)
        ]
    )
    for name, terms, found in zip(
        unknowns, parts.T, instance.directional(unknowns, knowns, seed), strict=True
    ):
        if abs(found - terms.sum()) > SAME_START * np.abs(terms).sum():
            yield f"{name} in a mixed direction: {found:.6g} instead of {terms.sum():.6g}"


@behaviour(
    "run-derivatives", "directional derivatives of outputs by inputs are the difference quotients"
)
def _derivatives(subject: Subject) -> Iterator[str]:
    ask(subject, "providesDirectionalDerivative", "providesDirectionalDerivatives")
    inputs = {
        name: size
        for name, (_, size) in moved_inputs(subject).items()
        if subject.variables[name].variability == "continuous"
    }
    outputs = [name for name in numbers(subject) if name in set(subject.scalars("output"))]
    outputs = [name for name in outputs if subject.variables[name].variability == "continuous"]
    if not inputs or not outputs:
        raise NotApplicable("it has no continuous input or no continuous output")
    with Run(subject) as run:
        run.begin()
        run.steps(3)
        for known, size in inputs.items():
            try:
                yield from wrong_slopes(run.instance, outputs, known, size, quiet=True)
            except CallFailed as error:
                yield f"by {known}: {error}"
                return
        yield from not_linear(run.instance, outputs, list(inputs))
