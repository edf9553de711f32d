"""What the library offers: the public names, each with a docstring that names all arguments.

A name that is added or removed here changes what users can rely on: it is an entry of CHANGELOG.md.
"""

import dataclasses
import inspect
import re

import pytest

PUBLIC = {
    "bristle": [
        "BristleError",
        "Diagnosis",
        "Model",
        "Record",
        "Reproduction",
        "Result",
        "SweepResult",
        "Validation",
        "__version__",
        "build",
        "diagnose",
        "load_model",
        "load_record",
        "load_records",
        "records_from_arrays",
        "reproduce",
        "run",
        "sweep",
        "validate",
    ],
    "bristle.common.errors": [
        "BristleError",
        "EquationError",
        "IncompleteError",
        "NotStaticError",
        "RestartError",
        "SimulationError",
        "suggest",
    ],
    "bristle.common.units": [
        "Unit",
        "convert",
        "interval",
        "parse_unit",
        "per_second",
        "quantity",
        "zero_of",
    ],
    "bristle.diagnosis": [
        "BristleError",
        "Diagnosis",
        "Model",
        "Record",
        "SearchOptions",
        "StickSlip",
        "Validation",
        "diagnose",
        "diagnose_fmu",
        "fmu_model",
        "load_model",
        "load_records",
        "records_from_arrays",
        "stick_slip",
        "validate",
        "validate_fmu",
        "write",
        "write_validation",
    ],
    "bristle.fmus": ["build", "obtain"],
    "bristle.fmus.conformance": [
        "BEHAVIOUR",
        "POINTS",
        "PointResult",
        "Severity",
        "Verdict",
        "conformance",
        "junit",
        "sarif",
        "static_conformance",
        "to_lines",
        "to_tree",
    ],
    "bristle.model.declarations": [
        "checked_declarations",
        "packaged_declaration",
        "packaged_declarations",
        "source_keys",
    ],
    "bristle.model.native": ["Native"],
    "bristle.model.program": ["Program"],
    "bristle.model.system": ["DryRow", "System"],
    "bristle.model.variables": ["Namespace", "Parameter", "State", "Variable", "declaring"],
    "bristle.observer": ["estimated", "methods", "observer_program"],
    "bristle.observer.method": [
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
    ],
    "bristle.plant.effect": [
        "BOTH_DIRECTIONS",
        "BOTH_SIGNS",
        "Context",
        "Coupling",
        "DRY_FRICTION",
        "Effect",
        "Evidence",
        "Extension",
        "Limits",
        "NEEDS",
        "OVER_INERTIA",
        "REVERSALS",
        "RecordedMotion",
        "power",
    ],
    "bristle.plant.controller": ["CONTROLLER"],
    "bristle.plant.known": ["KNOWN"],
    "bristle.plant.effects": ["BESIDE", "effect", "effects", "owners_of_inputs", "separation"],
    "bristle.plant.friction": ["law", "law_names", "laws"],
    "bristle.plant.law": [
        "Friction",
        "FrictionLaw",
        "stribeck_curve",
        "stribeck_end",
        "stribeck_parameters",
        "stribeck_truth",
    ],
    "bristle.plant.servo": ["servo", "servo_program"],
    "bristle.plant.signal_effects": ["SIGNAL_EFFECTS", "extension"],
    "bristle.plant.unnamed_torque": ["UNNAMED_KNOTS", "UNNAMED_TORQUES"],
    "bristle.plant.wording": ["ROTARY", "Wording"],
    "bristle.records": [
        "Column",
        "Layout",
        "Record",
        "Requirements",
        "read_record",
        "read_records",
        "records_from_arrays",
    ],
    "bristle.result": ["Reproduction", "Result", "SweepResult"],
}
# their docstrings have to be complete
OFFERED_TO_USERS = ("bristle", "bristle.diagnosis", "bristle.fmus", "bristle.records")
PARAMETERS = re.compile(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", re.DOTALL | re.MULTILINE)
ATTRIBUTES = re.compile(r"^Attributes\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", re.DOTALL | re.MULTILINE)


def documented(text, section):
    """Return the names that a section of a docstring explains."""
    found = section.search(inspect.cleandoc(text or ""))
    return (
        set(re.findall(r"\*?\w+", " ".join(re.findall(r"^(\S[^:\n]*)", found[1], re.MULTILINE))))
        if found
        else set()
    )


def offered(modules):
    """Return every public function and class that is offered to users, by its name."""
    return {
        f"{module}.{name}": getattr(modules[module], name)
        for module in OFFERED_TO_USERS
        for name in PUBLIC[module]
        if name[0] != "_"
    }


def test_the_public_names_are_these(modules):
    declared = {
        name: sorted(module.__all__)
        for name, module in modules.items()
        if getattr(module, "__all__", [])
    }
    assert declared == PUBLIC


def test_every_package_says_what_it_offers(modules):
    packages = {name for name, module in modules.items() if hasattr(module, "__path__")}
    assert len(packages) > 15
    assert not {name for name in packages if not hasattr(modules[name], "__all__")}


def test_every_public_name_is_there_and_documented(modules):
    for module, names in PUBLIC.items():
        for name in names:
            value = getattr(modules[module], name)
            if inspect.isfunction(value) or inspect.isclass(value):
                assert (value.__doc__ or "").strip(), f"{module}.{name}"


def test_every_argument_of_a_public_function_is_documented(modules):
    functions = {
        name: value for name, value in offered(modules).items() if inspect.isfunction(value)
    }
    assert len(functions) >= 12
    for name, function in functions.items():
        asked = set(inspect.signature(function).parameters)
        missing = asked - documented(function.__doc__, PARAMETERS)
        assert not missing, (
            f"{name}: the docstring has no entry under Parameters for {sorted(missing)}"
        )


def test_every_field_of_a_public_class_is_documented(modules):
    for name, value in offered(modules).items():
        if dataclasses.is_dataclass(value):
            explained = {
                word for each in value.__mro__ for word in documented(each.__doc__, ATTRIBUTES)
            }
            missing = {f.name for f in dataclasses.fields(value)} - explained
            assert not missing, (
                f"{name}: the docstring has no entry under Attributes for {sorted(missing)}"
            )


def test_an_unknown_argument_is_refused(modules):
    for name, value in offered(modules).items():
        if inspect.isfunction(value):
            with pytest.raises(TypeError, match="no_such_argument"):
                value(no_such_argument=1)
            assert "**" not in str(inspect.signature(value)), name
