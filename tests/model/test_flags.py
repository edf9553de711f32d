"""Flags of the compiler change how long it takes and how fast the result is, and no digit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from bristle.fmus.build import program_of
from bristle.model import compiler
from bristle.model.compiler import FLAGS_VARIABLE, compiler_identity
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.observer import methods
from bristle.plant.friction import laws

H, N = 1e-3, 2000


@pytest.fixture
def with_flags(monkeypatch):
    """Return what sets the flags of the environment."""

    def use(flags: str) -> None:
        monkeypatch.setenv(FLAGS_VARIABLE, flags)
        compiler._forget()

    yield use
    monkeypatch.undo()
    compiler._forget()


def test_flags_of_the_environment_belong_to_what_is_cached(with_flags):
    identities = set()
    for flags in ("", "-O1", "-O1 -g"):
        with_flags(flags)
        identities.add(compiler_identity())
    assert len(identities) == 3


def table(program: Program, names: list[str]) -> NDArray[np.float64]:
    """Outputs of a program that is driven by steps and sines."""
    time = H * np.arange(N)
    series = np.sin(7 * time) + np.sign(np.sin(31 * time))
    inputs = {name: series for name in ("u", "y_theta", "y_v") if name in program.index}
    return Native(program).run(H, inputs, names)[0]


def outputs(program: Program) -> list[str]:
    return [slot.name for slot in program.slots if slot.kind == "output"]


@pytest.mark.slow
@pytest.mark.sampled(8)
@pytest.mark.parametrize(
    ("what", "variant"),
    [*(("plant", name) for name in laws()), *(("observer", name) for name in methods())],
)
def test_every_level_of_optimisation_gives_the_same_digits(with_flags, what, variant):
    program = program_of(what, variant)
    found = []
    for flags in ("-O3", "-O1"):
        with_flags(flags)
        found.append(table(program, outputs(program)))
    np.testing.assert_array_equal(*found)
    assert np.nanmax(np.ptp(found[0], axis=0)) > 0
