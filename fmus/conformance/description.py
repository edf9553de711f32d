"""Points of modelDescription.xml."""

from __future__ import annotations

import math
from collections.abc import Iterator

from bristle.fmus.conformance.registry import Package, Severity, point
from bristle.fmus.host import IDENTIFIER

REAL = ("Real", "Float64", "Float32")


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


@point("description-experiment", "a default experiment with a stop time", Severity.note)
def _experiment(package: Package) -> Iterator[str]:
    if package.root.find("DefaultExperiment[@stopTime]") is None:
        yield "it is missing"
