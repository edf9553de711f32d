"""A compiled program is found again by its fingerprint: it must change whenever the sources would."""

import copy
from dataclasses import replace

import pytest

from bristle.model import sources
from bristle.model.sources import c_sources, fingerprint
from bristle.plant.servo import servo_program


def built(law="coulomb", effects=(), wanted=("J",), observed="theta"):
    return servo_program(law, encoder=False, effects=effects, sensitivities=wanted, observed=observed)


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
    assert c_sources(program) != c_sources(other)
    assert fingerprint(program) != fingerprint(other)


def test_the_same_program_built_anew_is_found_again():
    assert fingerprint(built(effects=("backlash",))) == fingerprint(built(effects=("backlash",)))


def test_one_operation_more_in_one_kernel_changes_the_fingerprint():
    program = built()
    before, text = fingerprint(program), c_sources(program)
    kernel = program.variants[0].kernels["outputs"]
    function, targets = kernel.blocks[0]
    arguments = function.sx_in()
    changed = type(function)("outputs", arguments, [2 * function(*arguments)])
    program.variants[0].kernels["outputs"] = replace(kernel, blocks=((changed, targets), *kernel.blocks[1:]))
    assert c_sources(program) != text
    assert fingerprint(program) != before


def test_targets_belong_to_the_fingerprint():
    program = built()
    before = fingerprint(program)
    kernel = program.variants[0].kernels["outputs"]
    turned = tuple((function, targets[::-1]) for function, targets in kernel.blocks)
    program.variants[0].kernels["outputs"] = replace(kernel, blocks=turned)
    assert fingerprint(program) != before


def test_nothing_is_spelled_out_for_it(monkeypatch):
    def never(kernel):
        raise AssertionError("spelled out")

    program = built()
    monkeypatch.setattr(sources, "emit_c", never)
    fingerprint(program)
