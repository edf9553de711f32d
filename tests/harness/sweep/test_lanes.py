"""Runs in the lanes of the processor's vectors have the digits of runs with their FMUs, and give
way to them where one fails.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.fmus.calls import CONTROL_SIZE
from bristle.harness.cosim.bus import Bus
from bristle.harness.cosim.loop import simulate
from bristle.harness.run.checked import RunOptions
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.plan import RunSetup, identification, prepare
from bristle.harness.scenario.reading import load
from bristle.harness.sweep import lanes as together
from bristle.harness.sweep.chunk import run_chunk
from bristle.harness.sweep.design import design
from bristle.harness.sweep.lanes import RUNS_WORTH_IT, Together, alike
from bristle.harness.sweep.spec import prepare_sweep

Maker = Callable[..., Path]
COMPENSATED = [
    "controller.compensation=valid",
    "controller.parameters.fade=1 ms",
    "controller.parameters.test_time=10 ms",
]
STIMULI = """[[stimuli]]
variable = "load_scale"
points = [["0 s", 1.0], ["0.3 s", 1.7]]
[[stimuli]]
variable = "tau_load"
[stimuli.sine]
amplitude = "1 mN.m"
frequency = "3 Hz"
[[checks]]"""
DIVERGES = "observer.parameters.besancon.alpha2=1e6 1/s"


def setup_of(path: Path, seed: int, *overrides: str) -> RunSetup:
    loaded = load(path, overrides, seed)
    return prepare(loaded, build_fmus(loaded))


def control() -> Any:
    return np.zeros(CONTROL_SIZE, dtype=np.int64)


def check_equal(buses: Sequence[Bus], made: Together) -> None:
    some, left = buses[: made.width], buses[made.width :]
    if left:  # a processor with two lanes
        check_equal(left, made)
    for bus, trace in zip(some, made.run(some, control()), strict=True):
        expected = simulate(bus)
        assert trace is not None
        np.testing.assert_array_equal(trace.values, expected.values)
        assert trace.flags.ports == expected.flags.ports
        np.testing.assert_array_equal(trace.flags.rows, expected.flags.rows)
        np.testing.assert_array_equal(trace.flags.values, expected.flags.values)


def test_lanes_have_the_digits_of_fmus(base: str, scenario_file: Maker) -> None:
    """Recorded inputs, events, links of Booleans, seeds and other parameters in each lane."""
    path = scenario_file(base.replace("[[checks]]", STIMULI))
    changes = ["duration=0.7 s", "sensor=encoder", "observer.method=rls", *COMPENSATED]
    setups = [
        setup_of(path, seed, f"plant.parameters.J={mass} kg.m2", *changes)
        for seed, mass in enumerate((8e-4, 1e-3, 1.2e-3), 1)
    ]
    buses = [identification(setup) for setup in setups]
    assert len({alike(bus) for bus in buses}) == 1
    made = Together(setups[0])
    check_equal(buses, made)
    check_equal(buses[1:], made)  # nothing is left of the first time


@pytest.mark.slow
def test_an_fmu_with_effects_and_another_law(base: str, scenario_file: Maker) -> None:
    path = scenario_file(base)
    changes = [
        "duration=0.5 s",
        "plant.law=gms",
        'plant.effects=["cogging"]',
        "observer.method=two_step",
    ]
    setups = [setup_of(path, seed, *changes) for seed in (1, 2)]
    check_equal([identification(setup) for setup in setups], Together(setups[0]))


def test_another_time_base_is_not_alike(base: str, scenario_file: Maker) -> None:
    path = scenario_file(base)
    first = identification(setup_of(path, 1))
    for change in (
        "duration=1 s",
        "step=2 ms",
        "plant.parameters.solver.max_step=0.5 ms",
        "sensor=encoder",
    ):
        assert alike(identification(setup_of(path, 1, change))) != alike(first)


@pytest.mark.sampled(4)
def test_a_run_that_is_out_of_the_ordinary_has_no_trace(base: str, scenario_file: Maker) -> None:
    path = scenario_file(base.replace("bastin_gevers", "besancon"))
    setups = [setup_of(path, 1), setup_of(path, 1, DIVERGES), setup_of(path, 2)]
    buses = [identification(setup) for setup in setups]
    assert simulate(buses[1]).failure is not None
    made = Together(setups[0])
    assert [trace is None for trace in made.run(buses[:2], control())] == [False, True]
    check_equal([buses[0], buses[2]], made)


def test_fmus_that_are_not_compiled_ones_of_bristle_run_alone(
    base: str, scenario_file: Maker
) -> None:
    loaded = load(scenario_file(base), [])
    with pytest.raises(BristleError, match="alone"):
        Together(prepare(loaded, build_fmus(loaded, kind="python")))


def test_rows_of_a_sweep_are_the_same_in_lanes(
    base: str, scenario_file: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two sensors in turn, an observer that diverges, and a run that cannot be made."""
    path = scenario_file(
        base.replace('"2 s"', '"0.3 s"')
        .replace("bastin_gevers", "besancon")
        .replace("estimates.b.error_percent", "steps")
    )
    varied = [
        "observer.parameters.besancon.alpha2=[2 1/s, 1e6 1/s]",
        "plant.parameters.J=[0.001 kg.m2, 0.002 kg.m2]",
    ]
    asked = design([*varied, "sensor=[clean, encoder]"], seeds=[1, 2])
    sweep = prepare_sweep(path, asked, RunOptions())
    points = list(asked.points())
    first, _, third = points[5].overrides
    points[5] = replace(points[5], overrides=(first, "plant.parameters.J=-1 kg.m2", third))
    calls: list[int] = []
    run = Together.run

    def counted(made: Together, buses: Sequence[Bus], shared: Any) -> Any:
        calls.append(len(buses))
        return run(made, buses, shared)

    monkeypatch.setattr(together.Together, "run", counted)
    alone, lanes = (run_chunk(replace(sweep, lanes=way), points) for way in (False, True))
    assert sum(calls) == len(points) - 1
    assert [row["run"] for row in lanes] == [point.index for point in points]
    for one, other in zip(alone, lanes, strict=True):
        assert {**one, "wall_s": 0.0} == {**other, "wall_s": 0.0}
    assert {row["verdict"] for row in lanes} == {"pass", "fail", "error"}


def test_few_runs_are_not_worth_the_programs(base: str, scenario_file: Maker) -> None:
    path = scenario_file(base)
    for runs in (RUNS_WORTH_IT - 1, RUNS_WORTH_IT):
        assert prepare_sweep(path, design((), seeds=range(1, runs + 1)), RunOptions()).lanes == (
            runs >= RUNS_WORTH_IT
        )
