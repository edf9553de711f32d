"""A compiled program is found again by its fingerprint: it must change whenever the sources
would.
"""

import copy
from dataclasses import replace
from pathlib import Path

import pytest

from bristle.model import sources
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.sources import c_sources, fingerprint, lanes_sources
from bristle.observer import observer_program
from bristle.plant.servo import servo_program


def built(law="coulomb", effects=(), wanted=("J",), observed="theta"):
    return servo_program(
        law, encoder=False, effects=effects, sensitivities=wanted, observed=observed
    )


VARIED = {
    "another law": lambda: built("lugre"),
    "an effect": lambda: built(effects=("cogging",)),
    "another parameter to differentiate by": lambda: built(wanted=("a2",)),
    "one more": lambda: built(wanted=("J", "a2")),
    "another output": lambda: built(observed="v"),
    "another start value": lambda: built().preset({"J": 0.02}),
    "another description": lambda: described("other"),
}


def described(text):
    program = copy.copy(built())
    program.description = text
    return program


@pytest.mark.parametrize("what", VARIED)
def test_what_changes_the_sources_changes_the_fingerprint(what):
    program, other = built(), VARIED[what]()
    sources_of = lanes_sources if what == "another output" else c_sources  # only lanes look at it
    assert sources_of(program) != sources_of(other)
    assert fingerprint(program) != fingerprint(other)


def test_the_same_program_built_anew_is_found_again():
    assert fingerprint(built(effects=("backlash",))) == fingerprint(built(effects=("backlash",)))


def doubled(system, what, name):
    """Change one equation of a system, as another formula in `plant/` would."""
    if what == "constants":
        system.constants[0] = {key: 2 * value for key, value in system.constants[0].items()}
        return
    place = getattr(system, what)
    name = name or next(iter(place))
    if what == "dry":
        system.dry = replace(place, **{name: 2 * getattr(place, name)})
    elif what == "states":
        place[name] = replace(place[name], initial=place[name].initial + 1)
    elif isinstance(place[name], tuple):
        place[name] = (place[name][0], 2 * place[name][1])
    else:
        place[name] = 2 * place[name]


def servo(law, effects):
    return servo_program(
        law, encoder=False, effects=effects, sensitivities=("J",), observed="theta"
    )


@pytest.mark.parametrize(
    ("make", "what", "name"),
    [
        (lambda: servo("coulomb", ()), "rates", "v"),
        (lambda: servo("coulomb", ()), "outputs", "theta"),
        (lambda: servo("coulomb", ()), "calculated", None),
        (lambda: servo("coulomb", ()), "dry", "bound"),
        (lambda: servo("coulomb", ()), "dry", "inertia"),
        (lambda: servo("coulomb", ()), "states", "theta"),
        (lambda: servo("coulomb", ("bristle_damping",)), "dry", "stiffness"),
        (lambda: servo("coulomb", ("asymmetric_coulomb",)), "dry", "backward"),
        (lambda: servo("coulomb", ("input_delay",)), "updates", None),
        (lambda: servo("gms", ()), "margins", None),
        pytest.param(observer_program, "constants", None, marks=pytest.mark.slow),
    ],
)
def test_one_operation_more_in_one_equation_changes_the_fingerprint(make, what, name):
    program, changed = make(), make()
    doubled(next(v.system for v in changed.variants if getattr(v.system, what)), what, name)
    assert fingerprint(changed) != fingerprint(program)
    assert c_sources(changed) != c_sources(program)


def test_a_place_in_the_table_belongs_to_the_fingerprint():
    program = built()
    before = fingerprint(program)
    program.slots = [program.slots[0], program.slots[2], program.slots[1], *program.slots[3:]]
    assert fingerprint(program) != before


@pytest.mark.parametrize("name", ["proximal.py", "core.c", "emit.py"])
def test_the_code_that_makes_functions_belongs_to_the_fingerprint(name, monkeypatch):
    """Whatever it would make of an equation is not looked at, so a change of it has to count by
    itself.
    """
    program = built()
    before = fingerprint(program)
    read = Path.read_text
    monkeypatch.setattr(
        Path, "read_text", lambda self, **o: read(self, **o) + (" " if self.name == name else "")
    )
    sources._code.cache_clear()
    try:
        assert fingerprint(program) != before
    finally:
        monkeypatch.undo()
        sources._code.cache_clear()
    assert fingerprint(program) == before


def test_no_function_is_made_for_it(monkeypatch):
    def never(self, system):
        raise AssertionError("made")

    monkeypatch.setattr(Program, "_kernels", never)
    fingerprint(built())


def test_a_program_whose_output_is_differentiated_runs_alone_too():
    """What only lanes call is not in its sources: an unused function would be refused."""
    assert "seen_jacobian" not in c_sources(built())["model_coulomb.c"]
    assert "seen_jacobian" in lanes_sources(built())["model.c"]
    assert Native(built()).steps == 0
