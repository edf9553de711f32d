"""Several instances in the lanes of the processor's vectors give, each for itself, the digits of
one alone.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from bristle.common.errors import BristleError, SimulationError
from bristle.fmus.build import program_of
from bristle.model.lanes import Lanes
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.observer import methods
from bristle.plant.effects import effects
from bristle.plant.friction import laws

Array = NDArray[np.float64]
STEP = 1e-3
LENGTH = 1500
NO_LIMIT = (-1e300, 1e300)


def in_lanes(
    program: Program, values: Sequence[Mapping[str, float]], inputs: Mapping[str, Array]
) -> tuple[Array, list[bool]]:
    """Return the whole table after each step, shape (steps, variables, instances), and which
    instances have not failed.

    Inputs have the shape (steps, instances). A processor with two lanes takes several turns.
    """
    lanes = Lanes(program)
    turns = [
        _turn(
            lanes,
            values[k : k + lanes.width],
            {name: series[:, k : k + lanes.width] for name, series in inputs.items()},
        )
        for k in range(0, len(values), lanes.width)
    ]
    return np.concatenate([found for found, _ in turns], axis=2), [
        each for _, alive in turns for each in alive
    ]


def _turn(
    lanes: Lanes, values: Sequence[Mapping[str, float]], inputs: Mapping[str, Array]
) -> tuple[Array, list[bool]]:
    program = lanes.program
    lanes.initialise(
        [*values, *[values[-1]] * (lanes.width - len(values))], 0.0, dict.fromkeys(inputs, NO_LIMIT)
    )
    steps = len(next(iter(inputs.values())))
    size = len(program.slots) * lanes.width
    table = np.ctypeslib.as_array((ctypes.c_double * size).from_address(lanes.address)).reshape(
        -1, lanes.width
    )
    found = np.empty((steps, len(program.slots), len(values)))
    for k in range(steps):
        for name, series in inputs.items():
            table[program.index[name], : len(values)] = series[k]
        lanes.library.lanes_step(
            ctypes.c_void_p(lanes.address), ctypes.c_double(k * STEP), ctypes.c_double(STEP), 1
        )
        found[k] = table[:, : len(values)]
    return found, [lanes.alive(lane) for lane in range(len(values))]


def alone(program: Program, values: Mapping[str, float], inputs: Mapping[str, Array]) -> Array:
    """Return the same table of one instance, shape (steps, variables)."""
    native = Native(program, values)
    found = []
    for k in range(len(next(iter(inputs.values())))):
        v = native.values
        v[0] = k * STEP
        for name, series in inputs.items():
            v[program.index[name]] = series[k]
        native.write(v)
        native.advance(STEP)
        found.append(native.values)
    return np.array(found)


def compared(program: Program) -> list[int]:
    """Return the places that change from step to step and that lanes keep; derivatives are for
    Model Exchange alone.
    """
    return [
        slot.index
        for slot in program.slots
        if slot.kind in ("output", "state", "sampled", "mode", "calculated", "hidden")
    ]


def voltages(lanes: int, rms: float) -> Array:
    """Low-pass noise, another one in each lane, with many reversals and some rest."""
    white = np.random.default_rng(3).standard_normal((LENGTH, lanes))
    u = np.empty((LENGTH, lanes))
    x = np.zeros(lanes)
    for k in range(LENGTH):
        x = 0.98 * x + 0.2 * white[k]
        u[k] = rms * x * (k % 500 < 400)
    return u


def agree(
    program: Program, values: Sequence[Mapping[str, float]], inputs: Mapping[str, Array]
) -> Array:
    """Check that each lane has the digits of its own run alone, and return them."""
    found, alive = in_lanes(program, values, inputs)
    assert all(alive)
    for lane, each in enumerate(values):
        expected = alone(program, each, {name: series[:, lane] for name, series in inputs.items()})
        np.testing.assert_array_equal(
            found[:, compared(program), lane], expected[:, compared(program)]
        )
    return found


@pytest.mark.sampled(4)
@pytest.mark.parametrize("law", list(laws()))
def test_a_plant_in_each_lane(law: str) -> None:
    program = program_of("plant", law)
    values = [{"J": 1e-3 * scale} for scale in (0.5, 1.0, 2.0)]  # their internal steps differ
    found = agree(program, values, {"u": voltages(3, 8.0 if law == "modified_polynomial" else 3.0)})
    speed = found[:, program.index["v"], :]
    assert np.all(np.sum(np.diff(np.sign(speed), axis=0) != 0, axis=0) > 1)
    assert not np.array_equal(speed[:, 0], speed[:, 1])


def test_a_plant_with_effects() -> None:
    names = [
        name
        for name in effects()
        if name not in ("backlash", "presliding", "bristle_damping", "encoder_play")
    ]
    program = program_of("plant", "coulomb", names[:6])
    agree(program, [{"J": 1e-3}, {"J": 2e-3}], {"u": voltages(2, 4.0)})


@pytest.mark.sampled(9)
@pytest.mark.parametrize("method", [name for k, name in enumerate(methods()) if k % 3 == 0])
def test_an_observer_in_each_lane(method: str) -> None:
    program = program_of("observer", method)
    plant = program_of("plant", "modified")
    seen, _ = in_lanes(plant, [{"J": 1e-3}, {"J": 2e-3}], {"u": voltages(2, 3.0)})
    driven = {
        "u": voltages(2, 3.0),
        "y_theta": seen[:, plant.index["theta_enc"]],
        "y_v": seen[:, plant.index["v_enc"]],
    }
    agree(
        program,
        [{}, {}],
        {name: series for name, series in driven.items() if name in program.index},
    )


def test_a_lane_that_fails_leaves_the_others_alone() -> None:
    program = program_of("plant", "lugre")
    u = voltages(3, 3.0)
    u[700:, 1] = np.nan
    found, alive = in_lanes(program, [{}, {}, {}], {"u": u})
    assert alive == [True, False, True]
    for lane in (0, 2):
        expected = alone(program, {}, {"u": u[:, lane]})
        np.testing.assert_array_equal(
            found[:, compared(program), lane], expected[:, compared(program)]
        )


@pytest.mark.parametrize("wrong", [2.0, -2.0, np.nan, np.inf])
def test_a_lane_whose_input_is_outside_its_limits_fails(wrong: float) -> None:
    lanes = Lanes(program_of("controller"))
    lanes.initialise([{}] * lanes.width, 0.0, {"y_v": (-1.0, 1.0)})
    (ctypes.c_double * 2).from_address(lanes.place("y_v", 0))[:] = [1.0, wrong]
    lanes.library.lanes_step(
        ctypes.c_void_p(lanes.address), ctypes.c_double(0.0), ctypes.c_double(STEP), 1
    )
    assert [lanes.alive(0), lanes.alive(1)] == [True, False]


def test_a_lane_whose_internal_steps_become_too_many_fails() -> None:
    program = program_of("plant", "lugre")
    many = {"lugre.sigma0": 1e6, "solver.max_steps": 100.0}
    few = {"solver.max_steps": 100.0}
    u = voltages(2, 3.0)[:300]
    with pytest.raises(SimulationError, match="internal steps"):
        alone(program, many, {"u": u[:, 0]})
    assert in_lanes(program, [many, few], {"u": u})[1] == [False, True]


def test_lanes_of_another_time_base_are_refused() -> None:
    lanes = Lanes(program_of("controller"))
    values = [{"sample_time": 1e-3 * (k + 1)} for k in range(lanes.width)]
    with pytest.raises(BristleError, match="'sample_time' differs between lanes"):
        lanes.initialise(values, 0.0, {})


def test_what_is_compiled_is_told_once(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path))
    caplog.set_level("INFO", "bristle")
    program = program_of("controller")
    for width in (2, 2, 4):
        Lanes(program, width, "what a test compiles")
    said = "compiling what a test compiles once, a few seconds each; later calls take them"
    assert [record.getMessage()[: len(said)] for record in caplog.records] == [said]


def test_what_is_in_the_cache_is_not_told(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path))
    caplog.set_level("INFO", "bristle")
    for what in ("", "what is there"):
        Lanes(program_of("controller"), 2, what)
    assert caplog.records == []
