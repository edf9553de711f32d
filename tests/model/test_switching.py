"""Modes that switch within a step: where, at what cost, and what derivatives make of it, against
closed forms.
"""

import math

import casadi as ca
import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.python import python_tables
from bristle.model.runtime import Core
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable

LEVEL, FAST, SLOW = 0.3, -2.0, -0.5  # x falls from 1: exponentially, and otherwise below the level


def falling(located=True, sensitivities=()):
    system = System("falling")
    system.input(Variable("pace", "1", "only counts the steps"))
    level = system.parameter(
        Parameter("level", "l", "1", LEVEL, 0.0, 1.0, "where it changes", "gear1984")
    )
    fast = system.parameter(
        Parameter("fast", "a", "1/s", FAST, -9.0, 0.0, "rate above the level", "gear1984")
    )
    start = system.parameter(
        Parameter("begin", "x0", "1", 1.0, 0.0, 9.0, "start value", "gear1984")
    )
    x = system.state(State("x", "1", "state", initial=start))
    below = system.mode(State("below", "1", "it has changed"))
    system.rate("x", ca.if_else(below == 0, fast * x, SLOW * x))
    system.update("below", ca.if_else(x <= level, 1, below))
    if located:
        system.margin("below", ca.if_else(below == 0, level - x, -1))
    system.output(Variable("y", "1", "state"), x)
    return Program("Falling", [system], sensitivities=sensitivities)


def exact(t, level=LEVEL, fast=FAST, begin=1.0):
    switch = math.log(level / begin) / fast
    return begin * math.exp(fast * t) if t <= switch else level * math.exp(SLOW * (t - switch))


def run(program, n=50, h=0.02, **parameters):
    native = Native(
        program, {"solver.max_step": h} | {f"solver.{k}": x for k, x in parameters.items()}
    )
    record, sens = native.run(
        h, {"pace": np.zeros(n)}, ["y"], sensitivities=bool(program.sensitivities)
    )
    return record[:, 0], sens, native.steps


@pytest.mark.parametrize("tolerance", [1e-5, 1e-7, 1e-9])
def test_a_switch_is_found_as_closely_as_the_tolerance_asks(tolerance):
    expected = np.array([exact(0.02 * k) for k in range(51)])
    found, _, steps = run(falling(), tolerance=tolerance)
    _, _, plain = run(falling(located=False), tolerance=tolerance)
    assert np.max(np.abs(found - expected)) < 3 * tolerance
    assert steps - plain < 120


def test_without_a_margin_it_switches_up_to_a_step_late():
    expected = np.array([exact(0.02 * k) for k in range(51)])
    found, _, _ = run(falling(located=False), tolerance=1e-9)
    assert np.max(np.abs(found - expected)) > 1e-3


def test_derivatives_carry_over_a_switch():
    """x = level^(1 - SLOW/fast) begin^(SLOW/fast) exp(SLOW t) after the switch, as functions of
    level, fast and begin.
    """
    names = ("level", "fast", "begin")
    found, sens, _ = run(falling(sensitivities=names), tolerance=1e-9)
    x = found[-1]
    ratio = SLOW / FAST
    assert sens[-1, 0, 0] == pytest.approx((1 - ratio) / LEVEL * x, rel=1e-6)
    assert sens[-1, 0, 1] == pytest.approx(ratio / FAST * math.log(LEVEL) * x, rel=1e-6)
    # an initial value does not count among what the parameters move: the state begins independent
    # of it
    assert sens[-1, 0, 2] == 0.0


def test_what_begins_past_its_point_switches_at_once():
    """The step control cannot go back; it takes a step so short that what it does wrong cannot be
    seen.
    """
    native = Native(falling(), {"begin": 0.2, "solver.max_step": 0.02, "solver.tolerance": 1e-13})
    record, _ = native.run(0.02, {"pace": np.zeros(50)}, ["y"])
    assert record[-1, 0] == pytest.approx(0.2 * math.exp(SLOW), rel=1e-8)


def test_c_and_python_take_the_same_steps():
    program = falling()
    native, core = Native(program), Core(python_tables(program))
    core.initialise(0.0)
    for _ in range(700):
        native.advance(1e-3)
        core.advance(1e-3)
    assert native.values.tolist() == core.v
    assert native.steps == core.steps


def test_a_margin_belongs_to_a_mode_and_has_no_place_beside_dry_friction():
    program = falling().variants[0].system
    program.margin("x", program.symbols["x"])
    with pytest.raises(BristleError, match="'x' has a margin; only a mode may"):
        program.check()
    system = System("both")
    v = system.state(State("v", "rad/s", "velocity"))
    system.rate("v", -v)
    mode = system.mode(State("m", "1", "mode"))
    system.update("m", mode)
    system.margin("m", v)
    system.dry_friction("v", 1.0, 1.0)
    with pytest.raises(BristleError, match="only without dry friction"):
        system.check()
