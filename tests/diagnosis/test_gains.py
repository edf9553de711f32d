"""A goal beside a measured input: the gains of the controller between them."""

import math
import os
import tomllib
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis import Model, diagnose, load_records, records_from_arrays
from bristle.diagnosis.following.gains import seen_controller
from bristle.diagnosis.modelfile import model_text
from bristle.diagnosis.report.text.statement import controller_line

DATA = Path(os.environ.get("BRISTLE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
H, STEP, J, A2, FC = 1e-3, 2 * math.pi / 40000, 0.004, 0.01, 0.05
TREE = {
    "friction": "coulomb",
    "parameters": {"J": J, "a2": A2, "Fc": FC, "b": 0.1},
    "time": {"column": "t", "unit": "s"},
    "input": {
        "column": "i",
        "kind": "current",
        "unit": "A",
        "goal": {"column": "goal", "unit": "deg"},
    },
    "output": {"column": "y", "kind": "position", "unit": "deg"},
}


def goals(n, rng):
    """Return a goal (n,), and its rate."""
    t = H * np.arange(n)
    steps = np.repeat(rng.uniform(-1, 1, n // 1500 + 1), 1500)[:n]
    wave = sum(a * np.sin(w * t + p) for a, w, p in zip((0.5, 0.2), (3, 11), (0, 1), strict=True))
    # moves of 0.2 s, rests and waves
    goal = np.convolve(np.where(t % 4 < 2, steps, wave), np.full(200, 1 / 200), mode="same")
    return goal, np.diff(goal, prepend=goal[0]) / H


def follows(gains, velocity=False, seed=0, seconds=12.0, noise=0.0, lag=2e-3):
    """Return a record of a servo that follows a goal by a controller of these gains [A]."""
    n, rng, parts = round(seconds / H), np.random.default_rng(seed), 4
    goal, rate = goals(n, rng)
    own = {"kp": 0.0, "ki": 0.0, "kd": 0.0, "forward": 1.0, "weight": 1.0, "limit": 1e9, "late": 1}
    own |= {"ahead": 0.0} | gains
    rate = rate + own["ahead"] * (np.roll(rate, -1) - rate)
    q = v = seen = total = d = before = 0.0
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n):
        shown = STEP * math.floor(q / STEP)
        seen += (1 - math.exp(-H / lag)) * ((shown - before) / H - seen)
        before = shown
        if velocity:
            y[k], error = seen, goal[k] - seen
            asked = own["kp"] * error + own["ki"] * total
        else:
            late = shown - lag * seen * own["late"]
            y[k], error = shown, goal[k] - late
            ahead = own["kd"] * (own["forward"] * rate[k] - seen)
            asked = own["kp"] * (own["weight"] * goal[k] - late) + own["ki"] * total + ahead
        u[k] = min(max(asked, -own["limit"]), own["limit"])
        total += H * error * (u[k] == asked or asked * error < 0)
        d = 0.99 * d + 0.14 * 0.05 * FC * rng.standard_normal()
        for _ in range(parts):
            free = v + H / parts * (0.1 * u[k] + d - A2 * v) / J
            v = free - np.clip(free, -H / parts * FC / J, H / parts * FC / J)
            q += H / parts * v
    measured = u + noise * rng.standard_normal(n)
    return "run", H * np.arange(n), measured, y, {"goal": goal}


def seen(gains, velocity=False, **how):
    tree = deepcopy(TREE)
    if velocity:
        tree["input"]["goal"]["unit"] = tree["output"]["unit"] = "rad/s"
        tree["output"]["kind"] = "velocity"
    model = Model.from_dict(tree)
    return seen_controller(model, records_from_arrays(model, [follows(gains, velocity, **how)]))


@pytest.mark.parametrize(
    "gains",
    [
        {"kp": 30.0},
        {"kp": 60.0, "kd": 2.0},
        {"kp": 60.0, "kd": 2.0, "forward": 0.0},
        {"kp": 60.0, "kd": 2.0, "ki": 100.0},
        {"kp": 60.0, "kd": 2.0, "ki": 100.0, "late": 0},
        {"kp": 60.0, "kd": 2.0, "forward": 1.0, "ahead": 1.0},
        {"kp": 60.0, "kd": 2.0, "forward": 1.0, "ahead": 0.5, "ki": 100.0},
        {"kp": 60.0, "kd": 2.0, "weight": 0.7},
        {"kp": 60.0, "kd": 2.0, "ki": 100.0, "limit": 6.0},
    ],
)
def test_the_gains_of_a_position_loop(gains):
    """`late`: whether all that the drive sees is filtered, or as in most the velocity alone."""
    for seed in (0, 1):
        found = seen(gains, seed=seed, noise=0.05)
        assert found.of == "position"
        shown = {name: true for name, true in gains.items() if name != "late"}
        assert set(found.gains) == {*shown, *(["forward"] if "kd" in gains else [])}, found
        assert found.share > 0.97
        assert "Between goal and input: a controller" in controller_line(found)
        for name, true in shown.items():
            assert found.gains[name].value == pytest.approx(true, rel=0.1, abs=0.05), found
        if "kd" in gains:
            low, high = found.gains["kd"].ci95
            assert low < gains["kd"] < high


def test_a_lag_between_those_that_are_tried_is_found():
    found = seen({"kp": 60.0, "kd": 2.0, "ki": 100.0, "late": 0}, lag=2.7e-3)
    assert found.lag == pytest.approx(2.7e-3, rel=0.01)
    for name, true in (("kp", 60.0), ("kd", 2.0), ("ki", 100.0)):
        assert found.gains[name].value == pytest.approx(true, rel=0.01)


def test_units_are_those_of_the_input_that_was_measured():
    found = seen({"kp": 60.0, "kd": 2.0, "ki": 100.0, "limit": 6.0}).gains
    units = {name: each.unit for name, each in found.items()}
    assert units["kp"] == "A/rad"
    assert (units["ki"], units["kd"], units["limit"]) == ("A/(rad.s)", "A.s/rad", "A")


def test_a_velocity_loop_is_one_of_its_integral():
    found = seen({"kp": 2.0, "ki": 40.0}, velocity=True, noise=0.02)
    assert found.of == "velocity"
    low, high = found.gains["kd"].ci95
    assert low < 2.0 < high < 2.3
    assert found.gains["kp"].value == pytest.approx(40.0, rel=0.1)


def test_a_goal_that_was_not_followed_has_no_controller():
    model = Model.from_dict(deepcopy(TREE))
    name, t, u, y, known = follows({"kp": 60.0, "kd": 2.0})
    other = {"goal": np.roll(known["goal"][::-1], 700)}
    found = seen_controller(model, records_from_arrays(model, [(name, t, u, y, other)]))
    assert found.share < 0.9
    assert "another made it" in controller_line(found)


def test_the_gains_that_the_authors_of_emps_set():
    """vir = kp kv (qg - qm) - kv qm', with kp = 160.18 1/s and kv = 243.45 V/(m/s)."""
    if not DATA.is_dir():
        pytest.skip(f"no measured data: {DATA} is not there (set BRISTLE_DATA)")
    tree = deepcopy(TREE) | {
        "input": {
            "column": "vir",
            "kind": "voltage",
            "unit": "V",
            "goal": {"column": "qg", "unit": "m"},
        },
        "output": {"column": "qm", "kind": "position", "unit": "m"},
    }
    model = Model.from_dict(tree)
    found = seen_controller(model, load_records(model, [DATA / "emps" / "DATA_EMPS.mat"]))
    assert found.gains["kp"].value == pytest.approx(160.18 * 243.45, rel=0.02)
    assert found.gains["kd"].value == pytest.approx(243.45, rel=0.02)
    assert found.gains["kp"].unit == "V/m"
    assert found.share > 0.999


@pytest.mark.parametrize("what", ["a goal that rests", "an input at its limit"])
def test_what_shows_no_law_is_said(what):
    model = Model.from_dict(deepcopy(TREE))
    name, t, u, y, _ = follows({"kp": 60.0, "kd": 2.0}, seconds=4.0)
    u = np.where(u > 0, 1.0, -1.0) if what == "an input at its limit" else u
    rests = {"goal": np.full_like(t, 0.3)}
    found = seen_controller(model, records_from_arrays(model, [(name, t, u, y, rests)]))
    assert 0.0 <= found.share < 0.9
    assert all(math.isfinite(each.value) for each in found.gains.values())
    assert "another made it" in controller_line(found)


def test_a_diagnosis_says_what_made_the_input():
    model = Model.from_dict(deepcopy(TREE))
    record = follows({"kp": 30.0}, noise=0.05)
    answer = diagnose(model, records_from_arrays(model, [record]))
    content = answer.to_dict()["controller"]
    assert content["gains"]["kp"]["value"] == pytest.approx(30.0, rel=0.02)
    assert content["of"] == "position"
    assert any("kp = " in line for line in answer.statement)
    assert answer.verdict == "none"


def test_a_model_file_keeps_the_goal_and_a_record_must_have_it():
    model = Model.from_dict(deepcopy(TREE))
    again = Model.from_dict(tomllib.loads(model_text(model)))
    assert again.goal == model.goal
    name, t, u, y, _ = follows({"kp": 30.0}, seconds=4.0)
    with pytest.raises(BristleError, match=r"lacks input\.goal"):
        diagnose(model, records_from_arrays(model, [(name, t, u, y)]))
    twice = deepcopy(TREE)
    twice["input"] |= {"kind": "setpoint", "unit": "rad"}
    with pytest.raises(BristleError, match="the input is the goal itself"):
        Model.from_dict(twice)
