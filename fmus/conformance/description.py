"""Points of modelDescription.xml."""

from __future__ import annotations

import math
from collections.abc import Iterator

from bristle.fmus.conformance.registry import Package, Severity, point
from bristle.fmus.host import IDENTIFIER

REAL = ("Real", "Float64", "Float32")
INTEGERS = {
    "Integer": (-(2**31), 2**31 - 1),
    **{f"Int{n}": (-(2 ** (n - 1)), 2 ** (n - 1) - 1) for n in (8, 16, 32, 64)},
    **{f"UInt{n}": (0, 2**n - 1) for n in (8, 16, 32, 64)},
}
TRUE = ("true", "1")


@point("description-validator", "FMPy's validator and the XML schema have no objection")
def _validator(package: Package) -> Iterator[str]:
    from fmpy.validation import validate_fmu

    try:
        yield from (" ".join(str(each).split()) for each in validate_fmu(str(package.path)))
    except Exception as error:  # FMPy passes on the exceptions of its parser
        yield " ".join(str(error).split()) or type(error).__name__


def _number(text: str | None, default: float) -> float:
    """Return a number, NaN for what is none."""
    try:
        return default if text is None else float(text)
    except ValueError:
        return math.nan


@point("description-identifier", "modelIdentifier is a C identifier")
def _identifier(package: Package) -> Iterator[str]:
    yield from (f"'{name}'" for name in package.identifiers if IDENTIFIER.fullmatch(name) is None)


@point("description-token", "guid or instantiationToken is given")
def _token(package: Package) -> Iterator[str]:
    if not (package.root.get("guid") or package.root.get("instantiationToken")):
        yield "it is missing or empty"


@point("description-names", "names of variables are unique")
def _names(package: Package) -> Iterator[str]:
    names = [v.get("name") for v, _ in package.variables]
    yield from sorted({str(name) for name in names if names.count(name) > 1})


@point("description-range", "finite starts within min and max")
def _range(package: Package) -> Iterator[str]:
    for v, typed in package.variables:
        if typed.tag in REAL and typed.get("start"):
            low, high = _number(typed.get("min"), -math.inf), _number(typed.get("max"), math.inf)
            for text in typed.get("start").split():
                if not (math.isfinite(_number(text, 0.0)) and low <= _number(text, 0.0) <= high):
                    yield f"{v.get('name')}: {text} outside {low:g} to {high:g}"


@point("description-units", "each unit that is used is defined")
def _units(package: Package) -> Iterator[str]:
    defined = {u.get("name") for u in package.root.iterfind("UnitDefinitions/Unit")}
    for v, typed in package.variables:
        if typed.get("unit") and typed.get("unit") not in defined:
            yield f"{v.get('name')}: {typed.get('unit')}"


@point("description-si", "each unit states what it is in SI units", Severity.note)
def _si(package: Package) -> Iterator[str]:
    for unit in package.root.iterfind("UnitDefinitions/Unit"):
        if unit.find("BaseUnit") is None and unit.get("name") != "1":
            yield str(unit.get("name"))


@point("description-limits", "min not above max, nominal values positive")
def _limits(package: Package) -> Iterator[str]:
    for v, typed in package.variables:
        low, high = _number(typed.get("min"), -math.inf), _number(typed.get("max"), math.inf)
        if not low <= high:
            yield f"{v.get('name')}: min {low:g}, max {high:g}"
        if not 0 < _number(typed.get("nominal"), 1.0) < math.inf:
            yield f"{v.get('name')}: nominal {typed.get('nominal')}"


@point("description-integers", "whole starts, within what their type can hold")
def _integers(package: Package) -> Iterator[str]:
    for v, typed in package.variables:
        for text in (typed.get("start") or "").split() if typed.tag in INTEGERS else ():
            low, high = INTEGERS[typed.tag]
            value = _number(text, 0.0)
            if not (low <= value <= high and value == math.floor(value)):
                yield f"{v.get('name')}: {text} is no {typed.tag}"


@point("description-items", "items of enumerations are unique, and starts are among them")
def _items(package: Package) -> Iterator[str]:
    types = {}
    for each in package.root.iterfind("TypeDefinitions/*"):
        items = list(each.iterfind("Enumeration/Item" if package.fmi == 2 else "Item"))
        values = [item.get("value") for item in items]
        if len(set(values)) < len(values) or len({item.get("name") for item in items}) < len(items):
            yield f"{each.get('name')}: an item stands there twice"
        if items:
            types[each.get("name")] = set(values)
    for v, typed in package.variables:
        known = types.get(typed.get("declaredType")) if typed.tag == "Enumeration" else None
        if known is not None:
            yield from (
                f"{v.get('name')}: {text}"
                for text in (typed.get("start") or "").split()
                if text not in known
            )


@point("description-references", "no two variables that can be set share a value reference")
def _references(package: Package) -> Iterator[str]:
    seen: dict[tuple[str, str], str] = {}
    for v, typed in package.variables:
        if v.get("causality") in ("input", "parameter"):
            kind = "Integer" if typed.tag == "Enumeration" and package.fmi == 2 else str(typed.tag)
            name = seen.setdefault((kind, str(v.get("valueReference"))), str(v.get("name")))
            if name != v.get("name"):
                yield f"{name} and {v.get('name')}"


@point("description-states", "derivatives are those of continuous real variables")
def _states(package: Package) -> Iterator[str]:
    variables = package.variables
    known = {str(v.get("valueReference")): (v, typed) for v, typed in variables}
    for name, typed in (
        (v.get("name"), typed) for v, typed in variables if typed.get("derivative")
    ):
        reference = str(typed.get("derivative"))
        if package.fmi == 3:
            state = known.get(reference)
        else:
            place = int(reference) - 1 if reference.isdigit() else -1
            state = variables[place] if 0 <= place < len(variables) else None
        if state is None:
            yield f"{name}: derivative of {reference}, which does not exist"
        elif state[1].tag not in REAL or state[0].get("variability", "continuous") != "continuous":
            yield f"{name}: derivative of {state[0].get('name')}, which is not continuous"


@point("description-abilities", "what stores states as bytes can also get and set them")
def _abilities(package: Package) -> Iterator[str]:
    word = "FMUstate" if package.fmi == 2 else "FMUState"
    for kind in ("CoSimulation", "ModelExchange"):
        for each in package.root.iterfind(kind):
            if (
                each.get(f"canSerialize{word}") in TRUE
                and each.get(f"canGetAndSet{word}") not in TRUE
            ):
                yield f"{kind}: canSerialize{word} without canGetAndSet{word}"


@point(
    "description-times",
    "the default experiment ends after its start, and its step size and tolerance are positive",
)
def _times(package: Package) -> Iterator[str]:
    for given in package.root.iterfind("DefaultExperiment"):
        start, stop = _number(given.get("startTime"), 0.0), _number(given.get("stopTime"), math.inf)
        if not start < stop:
            yield f"from {start:g} s to {stop:g} s"
        for name in ("stepSize", "tolerance"):
            if not 0 < _number(given.get(name), 1.0) < math.inf:
                yield f"{name} {given.get(name)}"


@point("description-experiment", "a default experiment with a stop time", Severity.note)
def _experiment(package: Package) -> Iterator[str]:
    if package.root.find("DefaultExperiment[@stopTime]") is None:
        yield "it is missing"
