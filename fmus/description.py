"""modelDescription.xml and its companions, generated from the program."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from xml.etree import ElementTree as ET

from bristle.common.units import BASE, parse_unit
from bristle.common.xml import document
from bristle.fmus.dependencies import initial, structural
from bristle.fmus.interface import Exposed, Interface
from bristle.model.system import SAMPLE_TIME, TOLERANCE
from bristle.model.variables import Parameter

STOP_TIME = 20.0  # s, of the default experiment
DISPLAY_UNITS = {"rad": "deg", "rad/s": "rpm", "s": "ms"}  # unit -> what a tool may show instead
LOG_CATEGORY = ("logStatusError", "why a call was refused or a simulation cannot go on")


def _text(value: object) -> str:
    return (
        str(value).lower()
        if isinstance(value, bool)
        else repr(value)
        if isinstance(value, float)
        else str(value)
    )


def _element(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    """Add a child; attributes that are None are left out."""
    return ET.SubElement(parent, tag, {k: _text(v) for k, v in attributes.items() if v is not None})


def _units(parent: ET.Element, variables: Sequence[Exposed]) -> None:
    definitions = _element(parent, "UnitDefinitions")
    for text in sorted({x.slot.variable.unit for x in variables if x.type == "Real"}):
        unit = parse_unit(text)
        powers = {base: power for base, power in zip(BASE, unit.exponents, strict=True) if power}
        factor = {"factor": unit.factor} if unit.factor != 1.0 else {}
        element = _element(definitions, "Unit", name=text)
        _element(element, "BaseUnit", **powers, **factor)
        if (shown := DISPLAY_UNITS.get(text)) is not None:
            _element(
                element, "DisplayUnit", name=shown, factor=unit.factor / parse_unit(shown).factor
            )


def _selector_type(interface: Interface) -> str:
    return f"{interface.program.name}.{interface.program.selector}"


def _items(parent: ET.Element, interface: Interface) -> None:
    for value, variant in enumerate(interface.program.variants, start=1):
        _element(
            parent,
            "Item",
            name=variant.system.name,
            value=value,
            description=variant.system.description,
        )


def _description(exposed: Exposed) -> str:
    variable = exposed.slot.variable
    return (
        f"{variable.description} ({variable.symbol})"
        if isinstance(variable, Parameter)
        else variable.description
    )


def _start(exposed: Exposed) -> float | int | bool | None:
    """Return the start value where the standards require one: of what can be set."""
    kind = {"Enumeration": int, "Integer": int, "Boolean": bool}.get(exposed.type, float)
    return kind(exposed.slot.start) if exposed.settable else None


def _limit(value: float | None, exposed: Exposed) -> float | int | None:
    return (
        None
        if value is None
        else int(value)
        if exposed.type in ("Enumeration", "Integer")
        else float(value)
    )


def _display_unit(exposed: Exposed) -> str | None:
    """Return what an angle, a speed or a sample time is shown in; simulated time stays in s."""
    unit = exposed.slot.variable.unit
    if exposed.type != "Real" or (unit == "s" and exposed.name != SAMPLE_TIME.name):
        return None
    return DISPLAY_UNITS.get(unit)


def _value_attributes(interface: Interface, exposed: Exposed) -> dict[str, object]:
    """Return the attributes of a value, which have the same names in both standards."""
    return {
        "declaredType": _selector_type(interface) if exposed.type == "Enumeration" else None,
        "unit": exposed.slot.variable.unit if exposed.type == "Real" else None,
        "displayUnit": _display_unit(exposed),
        "min": _limit(exposed.minimum, exposed),
        "max": _limit(exposed.maximum, exposed),
        "nominal": exposed.nominal,
        "start": _start(exposed),
    }


def _experiment(root: ET.Element, interface: Interface) -> None:
    starts = {slot.name: slot.start for slot in interface.program.slots if slot.kind == "parameter"}
    tolerance, step = starts.get(TOLERANCE.name), starts.get(SAMPLE_TIME.name, SAMPLE_TIME.default)
    _element(
        root,
        "DefaultExperiment",
        startTime=0.0,
        stopTime=STOP_TIME,
        tolerance=tolerance,
        stepSize=step,
    )


def _log_categories(root: ET.Element) -> None:
    name, description = LOG_CATEGORY
    _element(_element(root, "LogCategories"), "Category", name=name, description=description)


def _root(interface: Interface, fmi_version: str, token_name: str) -> ET.Element:
    release = version("bristle")
    attributes = {
        "fmiVersion": fmi_version,
        "modelName": interface.program.name,
        token_name: interface.program.token,
        "description": interface.program.description,
        "version": release,
        "license": "MIT",
        "generationTool": f"Bristle {release}",
        "variableNamingConvention": "structured",
    }
    return ET.Element("fmiModelDescription", attributes)


# -- FMI 2.0 ---------------------------------------------------------------------------------------


def _interfaces_2(root: ET.Element, interface: Interface, sources: Sequence[str]) -> None:
    native = bool(sources)
    common: dict[str, object] = {
        "modelIdentifier": interface.program.name,
        "needsExecutionTool": None if native else True,
        "canBeInstantiatedOnlyOncePerProcess": False,
        "canNotUseMemoryManagementFunctions": True,
        "canGetAndSetFMUstate": True,
        "canSerializeFMUstate": True,
        "providesDirectionalDerivative": interface.exchange,
    }
    elements = (
        [_element(root, "ModelExchange", **common, completedIntegratorStepNotNeeded=True)]
        if interface.exchange
        else []
    )
    variable_step = {"canHandleVariableCommunicationStepSize": True, "maxOutputDerivativeOrder": 0}
    elements.append(_element(root, "CoSimulation", **common, **variable_step))
    for element in elements if native else ():
        files = _element(element, "SourceFiles")
        for name in sources:
            _element(files, "File", name=name)


def _types_2(root: ET.Element, interface: Interface) -> None:
    if interface.program.selector:
        simple = _element(
            _element(root, "TypeDefinitions"), "SimpleType", name=_selector_type(interface)
        )
        _items(_element(simple, "Enumeration"), interface)


def _variables_2(
    root: ET.Element, interface: Interface, shown: Sequence[Exposed], number: dict[str, int]
) -> None:
    parent = _element(root, "ModelVariables")
    state_of = {der.name: state.name for der, state in interface.rates}
    for x in shown:
        scalar = _element(
            parent,
            "ScalarVariable",
            name=x.name,
            valueReference=x.reference,
            description=_description(x),
            causality=x.causality,
            variability=x.variability,
            initial=x.initial,
        )
        derivative = number[state_of[x.name]] if x.name in state_of else None
        _element(scalar, x.type, **_value_attributes(interface, x), derivative=derivative)


def _structure_2(root: ET.Element, interface: Interface, number: dict[str, int]) -> None:
    at_one_instant, at_start = structural(interface), initial(interface)

    def unknowns(tag: str, names: Sequence[str], dependencies: dict[str, list[Exposed]]) -> None:
        if names:
            group = _element(structure, tag)
            for name in names:
                indices = " ".join(
                    str(number[x.name]) for x in dependencies[name] if x.name in number
                )
                _element(group, "Unknown", index=number[name], dependencies=indices)

    structure = _element(root, "ModelStructure")
    unknowns("Outputs", [x.name for x in interface.of("output")], at_one_instant)
    unknowns("Derivatives", [der.name for der, _ in interface.rates], at_one_instant)
    unknowns("InitialUnknowns", sorted(at_start, key=number.__getitem__), at_start)


def description_2(interface: Interface, sources: Sequence[str]) -> bytes:
    """Return modelDescription.xml for FMI 2.0; without sources it is an FMU that needs Python."""
    shown = [x for x in interface.variables if x.causality != "independent"]
    number = {x.name: k for k, x in enumerate(shown, start=1)}
    root = _root(interface, "2.0", "guid")
    if interface.exchange:
        root.set("numberOfEventIndicators", "0")
    _interfaces_2(root, interface, sources)
    _units(root, shown)
    _types_2(root, interface)
    _log_categories(root)
    _experiment(root, interface)
    _variables_2(root, interface, shown, number)
    _structure_2(root, interface, number)
    return document(root)


# -- FMI 3.0 ---------------------------------------------------------------------------------------

TYPES_3 = {
    "Real": "Float64",
    "Boolean": "Boolean",
    "Enumeration": "Enumeration",
    "Integer": "Int32",
}


def _interfaces_3(root: ET.Element, interface: Interface) -> None:
    common: dict[str, object] = {
        "modelIdentifier": interface.program.name,
        "canGetAndSetFMUState": True,
        "canSerializeFMUState": True,
        "providesDirectionalDerivatives": interface.exchange,
    }
    if interface.exchange:
        _element(root, "ModelExchange", **common)
    fixed = None if interface.continuous else interface.sample_time
    _element(
        root,
        "CoSimulation",
        **common,
        canHandleVariableCommunicationStepSize=True,
        fixedInternalStepSize=fixed,
    )


def _variables_3(root: ET.Element, interface: Interface) -> None:
    parent = _element(root, "ModelVariables")
    state_of = {der.name: state.reference for der, state in interface.rates}
    for x in interface.variables:
        _element(
            parent,
            TYPES_3[x.type],
            name=x.name,
            valueReference=x.reference,
            description=_description(x),
            causality=x.causality,
            variability=x.variability,
            initial=x.initial,
            **_value_attributes(interface, x),
            derivative=state_of.get(x.name),
        )


def _structure_3(root: ET.Element, interface: Interface) -> None:
    at_one_instant, at_start = structural(interface), initial(interface)
    reference = {x.name: x.reference for x in interface.variables}
    structure = _element(root, "ModelStructure")

    def unknown(tag: str, name: str, dependencies: list[Exposed]) -> None:
        _element(
            structure,
            tag,
            valueReference=reference[name],
            dependencies=" ".join(str(x.reference) for x in dependencies),
        )

    for x in interface.of("output"):
        unknown("Output", x.name, at_one_instant[x.name])
    for der, _ in interface.rates:
        unknown("ContinuousStateDerivative", der.name, at_one_instant[der.name])
    for name in sorted(at_start, key=reference.__getitem__):
        unknown("InitialUnknown", name, at_start[name])


def description_3(interface: Interface) -> bytes:
    """Return modelDescription.xml for FMI 3.0."""
    root = _root(interface, "3.0", "instantiationToken")
    _interfaces_3(root, interface)
    _units(root, interface.variables)
    if interface.program.selector:
        types = _element(root, "TypeDefinitions")
        _items(_element(types, "EnumerationType", name=_selector_type(interface)), interface)
    _log_categories(root)
    _experiment(root, interface)
    _variables_3(root, interface)
    _structure_3(root, interface)
    return document(root)


def build_description(interface: Interface, sources: Sequence[str]) -> bytes:
    """Return sources/buildDescription.xml for FMI 3.0."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = _element(root, "BuildConfiguration", modelIdentifier=interface.program.name)
    files = _element(
        configuration, "SourceFileSet", language="C99", compilerOptions="-ffp-contract=off"
    )
    for name in sources:
        _element(files, "SourceFile", name=name)
    _element(configuration, "Library", name="m", external=True)
    return document(root)
