"""What observers say of a long rest, of an input that does nothing, and of a plant that their model
is not: not valid, or right.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.loop import simulate
from bristle.model.native import Native
from bristle.observer import methods, observer_program

STEP = 1e-3
COUNT = 2 * np.pi / 40000  # rad
TRUE = {"alpha2": 2.0, "b": 6.5, "Fc": 4.0, "sigma0": 600.0, "c": 150.0}
ASKED = (*TRUE, "load", "delay")
Record = dict[str, np.ndarray]


@cache
def record(
    seconds: float, moves: tuple[tuple[float, float], ...], effect: str = "", **given: float
) -> Record:
    """Return set S under the reference controller; `moves`: from when [s] at which scale, `load`:
    torque [N.m] from 28 s on.
    """
    load = given.pop("load", 0.0)
    parameters = {name.replace("__", "."): value for name, value in given.items()}
    plant = BusUnit(
        "plant",
        Fmu(obtain("plant", law="modified", effects=[effect] if effect else ())),
        parameters,
    )
    controller = BusUnit("controller", Fmu(obtain("controller")), {"seed": 1.0, "order": 1.0})
    links = ((("controller", "u"), ("plant", "u")), (("plant", "v"), ("controller", "y_v")))
    names = (("controller", "u"), ("plant", "theta"), ("plant", "v"))
    events = [(round(t / STEP), ("controller", "reference_scale"), scale) for t, scale in moves]
    events += [(28_000, ("plant", "tau_load"), load)] if load else []
    bus = Bus(
        (plant, controller),
        round(seconds / STEP),
        STEP,
        links,
        tuple(sorted(events, key=lambda e: e[0])),
        record=names,
    )
    trace = simulate(bus)
    assert trace.failure is None
    u, theta, v = (np.ascontiguousarray(trace[port]) for port in names)
    return {"u": u, "y_theta": np.floor(theta / COUNT) * COUNT, "y_v": v}


def observed(method: str, data: Record, **given: float) -> dict[str, np.ndarray]:
    """Return what a method says of the parameters over time, and `adapted`."""
    known = {
        p.name: TRUE[p.symbol] for p in methods()[method].parameters if "known" in p.description
    }
    names = [*(f"{name}_{what}" for what in ("hat", "sd", "valid") for name in ASKED), "adapted"]
    parameters = known | {f"{method}.{name}": value for name, value in given.items()}
    out, _ = Native(observer_program(method), parameters).run(STEP, data, names)
    assert np.all(np.isfinite(out))
    return dict(zip(names, out[1:].T, strict=True))


@pytest.mark.parametrize("method", ["rls", "self_starting_ekf", "joint_ukf"])
def test_a_load_that_changes_in_rest_is_not_called_known_and_is_found_when_motion_returns(method):
    data = record(50.0, ((0.0, 1.0), (10.0, 0.0), (35.0, 1.0)), load=0.002)
    found = observed(method, data)
    at = {when: round(when / STEP) for when in (9.0, 27.9, 34.0, 49.9)}
    assert [found["load_valid"][k] for k in at.values()] == [1, 0, 0, 1]
    assert found["load_sd"][at[27.9]] > 20 * found["load_sd"][at[9.0]]
    assert found["load_hat"][at[49.9]] == pytest.approx(2.0, rel=0.02)
    for name in ("alpha2", "b", "Fc"):  # which a rest does not change
        assert found[f"{name}_valid"][at[9.0] : at[34.0]].all()
        assert found[f"{name}_hat"][at[49.9]] == pytest.approx(TRUE[name], rel=0.02)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ["two_step_drem", "swapped"])
def test_a_rest_forgets_nothing(method):
    data = record(50.0, ((0.0, 1.0), (25.0, 0.0)))
    found = observed(method, data)
    before, after = round(29.0 / STEP), round(49.9 / STEP)
    for name in ("alpha2", "b", "sigma0", "c"):
        assert found[f"{name}_sd"][after] == pytest.approx(found[f"{name}_sd"][before], rel=0.05), (
            name
        )


def test_a_filter_that_waits_for_motion_starts_from_it():
    data = record(20.0, ((0.0, 0.0), (6.0, 1.0)))
    found = observed("joint_ukf", data, longest_wait=5.0)
    assert not found["b_valid"][: round(6.0 / STEP)].any()
    for name in TRUE:
        valid = found[f"{name}_valid"] > 0
        assert valid[-1], name
        assert found[f"{name}_hat"][-1] == pytest.approx(TRUE[name], rel=0.1)
        assert np.all(found[f"{name}_sd"][valid] > 0)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("effect", "name", "parameters"),
    [
        ("saturation", "b", {"saturation__limit": 4.0}),
        ("input_delay", "b", {"input_delay__delay": 0.012}),
        ("gain_asymmetry", "load", {"gain_asymmetry__share": 0.3}),
    ],
)
def test_what_the_model_misses_beyond_the_noise_is_in_the_deviation(effect, name, parameters):
    true = {**TRUE, "load": 0.0}
    found = observed("rls", record(30.0, ((0.0, 1.0),), effect, **parameters))
    sound = observed("rls", record(30.0, ((0.0, 1.0),)))
    assert not found[f"{name}_valid"][-1]
    assert abs(found[f"{name}_hat"][-1] - true[name]) < 5 * found[f"{name}_sd"][-1]
    assert sound[f"{name}_valid"][-1]
    assert sound[f"{name}_sd"][-1] < 0.005 * TRUE["b"]


@pytest.mark.parametrize("method", ["rls", "two_step", "swapped", "parallel_elements"])
def test_without_an_input_neither_its_gain_nor_its_delay_is_known(method):
    t = np.arange(20_000) * STEP
    v = 3 * np.sin(2 * t) + np.cos(5 * t)
    found = observed(method, {"u": 0 * t, "y_theta": np.cumsum(v) * STEP, "y_v": v})
    for name in ("b", "delay"):
        assert not found[f"{name}_valid"].any()
        assert found[f"{name}_sd"][-1] > 1e3


def test_a_delay_below_zero_is_not_valid():
    found = observed("swapped", record(30.0, ((0.0, 1.0),)))
    data = record(30.0, ((0.0, 1.0),))
    # the input comes a sample too late
    early = observed("swapped", data | {"u": np.concatenate([np.zeros(1), data["u"][:-1]])})
    assert found["delay_valid"][-1]
    assert early["delay_hat"][-1] == pytest.approx(-1.0, abs=0.1)
    assert not early["delay_valid"][-1]
    assert early["b_valid"][-1]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", sorted(methods()))
def test_nothing_is_adapted_by_nothing(method):
    nothing = np.zeros(3000)
    found = observed(method, {"u": nothing, "y_theta": nothing, "y_v": nothing})
    assert not found["adapted"].any()
    assert not any(found[f"{name}_valid"].any() for name in ASKED)
