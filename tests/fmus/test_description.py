"""modelDescription.xml: valid, complete, and true."""

import math
from importlib.resources import files
from pathlib import Path
from zipfile import ZipFile

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from bristle.common.units import parse_unit
from bristle.fmus.build import program_of
from bristle.fmus.interface import Interface
from bristle.model.variables import Parameter
from bristle.observer import methods
from bristle.plant.friction import laws

SMOOTH = (
    "dahl",
    "elastoplastic",
    "lugre",
    "lugre_velocity_damping",
    "modified",
    "modified_parallel",
    "modified_polynomial",
    "viscous",
)
ALL = [
    *(
        ("plant", {"law": law, "fmi": fmi, "encoder": law not in SMOOTH})
        for law in laws()
        for fmi in (2, 3)
    ),
    *(("plant", {"law": "lugre", "fmi": fmi}) for fmi in (2, 3)),
    *((what, {"fmi": fmi}) for what in ("plant", "controller", "observer") for fmi in (2, 3)),
    *((what, {"kind": "python"}) for what in ("plant", "controller", "observer")),
    ("plant", {"law": "lugre", "kind": "python"}),
    ("observer", {"method": next(iter(methods()))}),
]
# all others are real
KINDS = {"Enumeration": "Integer", "Integer": "Int32", "Int32": "Int32", "Boolean": "Boolean"}
WHOLE = [("plant", {}), ("controller", {}), ("observer", {})]


def identity(case):
    return "-".join([case[0], *map(str, case[1].values())]) if isinstance(case, tuple) else None


@pytest.mark.sampled(8)
@pytest.mark.parametrize("case", ALL, ids=identity)
def test_the_validator_finds_nothing(built, case):
    assert validate_fmu(str(built(case[0], **case[1]).path)) == []


@pytest.mark.sampled(4)
def test_the_validator_would_find_something(built, tmp_path):
    """A description without the unknowns of the initialization is found out."""
    source = built("plant").path
    broken = tmp_path / "broken.fmu"
    with ZipFile(source) as old, ZipFile(broken, "w") as new:
        text = old.read("modelDescription.xml").decode()
        new.writestr(
            "modelDescription.xml",
            text[: text.index("<InitialUnknowns>")] + "</ModelStructure></fmiModelDescription>",
        )
    assert validate_fmu(str(broken))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", ["plant", "controller", "observer"])
def test_build_description_is_valid_and_complete(built, what):
    folder = built(what, fmi=3).folder / "sources"
    schema = etree.XMLSchema(
        file=str(Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3BuildDescription.xsd")
    )
    document = etree.parse(str(folder / "buildDescription.xml"))
    schema.assertValid(document)
    assert {e.get("name") for e in document.iter("SourceFile")} == {
        p.name for p in folder.glob("*.c")
    }


@pytest.mark.sampled(8)
@pytest.mark.parametrize("case", ALL, ids=identity)
def test_variables_are_those_of_the_program(built, case):
    """Names, units, limits, starts and value references; one definition, so no list of names is
    typed here.
    """
    fmu = built(case[0], **case[1])
    variant = case[1].get("law") or case[1].get("method")
    program = program_of(case[0], variant, encoder=case[1].get("encoder", True))
    shown = {v.name: v for v in fmu.description.modelVariables}
    public = ("selector", "index", "running", "parameter", "calculated", "input", "output")
    lean = variant in SMOOTH and not case[1].get("encoder", True)
    for slot in program.slots:
        expected = (
            slot.kind in public
            or (slot.kind == "time" and fmu.fmi == 3)
            or (lean and slot.kind in ("state", "der"))
        )
        assert (slot.name in shown) == expected, slot.name
        if not expected:
            continue
        v = shown[slot.name]
        assert v.valueReference == slot.index
        assert v.description
        if v.type in ("Real", "Float64"):
            assert v.unit == slot.variable.unit
            assert parse_unit(v.unit).factor == pytest.approx(1.0, rel=1e-15)  # SI
        if isinstance(slot.variable, Parameter):
            assert (float(v.min), float(v.max)) == (slot.variable.minimum, slot.variable.maximum)
            assert float(v.start) == slot.variable.default
            assert (v.causality, v.initial) == ("parameter", "exact")
            assert v.variability in ("fixed", "tunable")  # which of both: test_tunable.py
    assert len(shown) == len({v.valueReference for v in shown.values()})
    assert all(len(name) <= 55 for name in shown)  # Simulink's limit
    assert sum(v.causality == "independent" for v in shown.values()) == (1 if fmu.fmi == 3 else 0)


@pytest.mark.sampled(3, "observer")
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_selector_is_an_enumeration_of_the_variants(built, fmi):
    cases = (
        ("plant", "law", list(laws()), "coulomb"),
        ("observer", "method", list(methods()), "bastin_gevers"),
    )
    for what, name, expected, chosen in cases:
        [v] = [v for v in built(what, fmi=fmi).description.modelVariables if v.name == name]
        assert v.type == "Enumeration"
        assert [(item.name, int(item.value)) for item in v.declaredType.items] == [
            (n, k) for k, n in enumerate(expected, start=1)
        ]
        assert (int(v.start), int(v.min), int(v.max)) == (
            expected.index(chosen) + 1,
            1,
            len(expected),
        )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    "case", [*WHOLE, ("plant", {"law": "lugre", "encoder": False})], ids=identity
)
def test_the_binary_starts_with_the_values_of_the_description(built, Raw, fmi, case):
    fmu = built(case[0], fmi=fmi, **case[1])
    raw = Raw(fmu.info)
    handle = raw.instantiate()
    assert raw.enter(handle) == 0
    for v in fmu.description.modelVariables:
        kind = KINDS.get(v.type, "Real")
        status, value = raw.read(handle, v.name, kind)
        assert status == 0
        if v.start is not None:
            assert value == (v.start == "true" if kind == "Boolean" else float(v.start)), v.name
        elif v.causality != "independent" and kind == "Real":
            assert math.isfinite(value), v.name


def test_units_are_defined_by_their_si_factors(built):
    for unit in built("plant").description.unitDefinitions:
        parsed = parse_unit(unit.name)
        got = [int(getattr(unit.baseUnit, base) or 0) for base in ("kg", "m", "s", "A", "K", "rad")]
        assert got == list(parsed.exponents), unit.name
        assert float(unit.baseUnit.factor or 1.0) == parsed.factor


def attributes(fmu, interface):
    return dict(
        etree.parse(str(fmu.folder / "modelDescription.xml")).getroot().find(interface).attrib
    )


@pytest.mark.parametrize("fmi", [2, 3])
def test_capabilities(built, fmi):
    lean, whole = built("plant", law="modified", fmi=fmi, encoder=False), built("plant", fmi=fmi)
    assert whole.description.modelExchange is None
    assert lean.description.numberOfContinuousStates == 3
    state, derivative = ("state", "Derivative") if fmi == 2 else ("State", "Derivatives")
    for fmu, interface, smooth in (
        (whole, "CoSimulation", False),
        (lean, "CoSimulation", True),
        (lean, "ModelExchange", True),
    ):
        given = attributes(fmu, interface)
        assert given[f"canGetAndSetFMU{state}"] == given[f"canSerializeFMU{state}"] == "true"
        assert given[f"providesDirectional{derivative}"] == str(smooth).lower()
        assert given.get("canBeInstantiatedOnlyOncePerProcess", "false") == "false"
        assert given.get("canHandleVariableCommunicationStepSize") == (
            "true" if interface == "CoSimulation" else None
        )
    for description in (lean.description, whole.description):
        assert [c.name for c in description.logCategories] == ["logStatusError"]
        experiment = description.defaultExperiment
        assert float(experiment.stopTime) > float(experiment.startTime) == 0.0
        assert float(experiment.stepSize) == 1e-3
        assert description.generationDateAndTime is None


# -- dependencies, by perturbation -----------------------------------------------------------------


def differs(a, b):
    return {
        name
        for name in a
        if a[name] != b[name] and not (math.isnan(a[name]) and math.isnan(b[name]))
    }


def values(raw, handle, names):
    return {name: raw.read(handle, name, kind)[1] for name, kind in names.items()}


def kinds(fmu, *causalities):
    return {
        v.name: KINDS.get(v.type, "Real")
        for v in fmu.description.modelVariables
        if v.causality in causalities
    }


def each_variant(fmu, raw):
    """Give an instance of each variant."""
    selector = [v for v in fmu.description.modelVariables if v.type == "Enumeration"]
    for choice in range(1, int(selector[0].max) + 1) if selector else [1]:
        handle = raw.instantiate()
        if selector:
            assert raw.set(handle, selector[0].name, choice, "Integer") == 0
        yield handle


def changed_by(raw, handle, outputs, name):
    """Return the outputs that another value of an input changes; the old one is set again."""
    before, [old] = values(raw, handle, outputs), raw.get(handle, name)
    raw.set(handle, name, old + 0.4)
    found = differs(before, values(raw, handle, outputs))
    raw.set(handle, name, old)
    return found


def moved(v, rng):
    """Return a value near the start value of a variable, within its limits."""
    start, low, high = (
        float(x) if x is not None else d for x, d in ((v.start, 0), (v.min, -9.0), (v.max, 9.0))
    )
    return min(max(start * 1.3 + 0.3 * rng.random(), low), high)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "case",
    [*WHOLE, ("plant", {"law": "lugre", "encoder": False}), ("plant", {"law": "coulomb"})],
    ids=identity,
)
def test_outputs_depend_on_no_more_inputs_than_declared(built, Raw, case):
    """At a communication point, an input that is not among an output's dependencies does not change
    it.
    """
    fmu = built(case[0], **case[1])
    raw, outputs = Raw(fmu.info), kinds(fmu, "output")
    declared = {u.variable.name: {d.name for d in u.dependencies} for u in fmu.description.outputs}
    inputs = fmu.names("input")
    found = {name: set() for name in outputs}
    for handle in each_variant(fmu, raw):
        assert raw.start(handle) == 0
        for k in range(20):
            # at rest first: that is where dry friction depends on the voltage
            for name in inputs if k >= 5 else ():
                assert raw.set(handle, name, 0.7 + 0.2 * math.sin(k)) == 0
            assert raw.step(handle, 1e-3 * k, 1e-3) == 0
            for name in inputs:
                for changed in changed_by(raw, handle, outputs, name):
                    found[changed].add(name)
        raw.free(handle)
    for name in outputs:
        assert found[name] <= declared[name], name
    if case[0] == "plant":  # and what is declared is what is there
        assert found["F"] == declared["F"] & set(inputs) != set()


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "case",
    [
        *WHOLE[:2],
        pytest.param(WHOLE[2], marks=pytest.mark.slow),
        ("plant", {"law": "lugre", "encoder": False}),
    ],
    ids=identity,
)
def test_initial_values_depend_on_no_more_than_declared(built, Raw, case):
    fmu = built(case[0], **case[1])
    raw = Raw(fmu.info)
    declared = {
        u.variable.name: {d.name for d in u.dependencies} for u in fmu.description.initialUnknowns
    }
    unknowns = {
        name: kind
        for name, kind in kinds(fmu, "output", "calculatedParameter", "local").items()
        if name in declared
    }
    found = {name: set() for name in unknowns}
    rng = np.random.default_rng(1)
    settable = [
        v
        for v in fmu.description.modelVariables
        if v.causality in ("parameter", "input") and v.type == "Real"
    ]
    for handle in each_variant(fmu, raw):
        assert raw.enter(handle) == 0
        for v in settable:
            before = values(raw, handle, unknowns)
            assert raw.set(handle, v.name, moved(v, rng)) == 0
            for changed in differs(before, values(raw, handle, unknowns)):
                found[changed].add(v.name)
        raw.free(handle)
    assert any(found.values())
    for name in unknowns:
        assert found[name] <= declared[name], name
    for name in ("true.alpha2", "true.b"):  # and what is declared is what is there
        if name in declared:
            assert (
                declared[name] - {"law", "law_index"}
                == {"a2" if name == "true.alpha2" else "b", "J"}
                == found[name]
            )


def test_interface_is_that_of_the_program_alone():
    """States and rates are public only where Model Exchange is offered."""
    assert Interface(program_of("plant", "modified", encoder=False)).exchange
    assert not Interface(program_of("plant", "modified")).exchange
    assert not Interface(program_of("plant", "modified", encoder=False), native=False).exchange
    assert not Interface(program_of("plant", "coulomb", encoder=False)).exchange
    assert not Interface(program_of("plant")).exchange


def test_the_license_is_that_of_the_project(built):
    text = (Path(__file__).parents[2] / "LICENSE").read_text(encoding="utf-8")
    assert (files("bristle.fmus") / "c" / "LICENSE.txt").read_text(encoding="utf-8") == text
    assert (built("plant").folder / "documentation" / "licenses" / "license.txt").read_text(
        encoding="utf-8"
    ) == text


def test_borrowed_files_keep_their_licences(built):
    python, native = built("plant", kind="python").folder, built("plant").folder
    assert "MIT License" in (python / "documentation" / "licenses" / "pythonfmu.txt").read_text(
        encoding="utf-8"
    )
    assert "2-Clause BSD License" in (native / "sources" / "fmi2Functions.h").read_text(
        encoding="utf-8"
    )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", [*WHOLE, ("plant", {"kind": "python"})], ids=identity)
def test_documentation_names_every_variable(built, case):
    fmu = built(case[0], **case[1])
    page = (fmu.folder / "documentation" / "index.html").read_text(encoding="utf-8")
    assert all(
        f"<td>{v.name}</td>" in page
        for v in fmu.description.modelVariables
        if v.causality != "independent"
    )
