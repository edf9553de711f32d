"""Servos that are given a goal: the controller is found from goal and position alone."""

import math
import tomllib
from copy import deepcopy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis import diagnose, records_from_arrays, validate
from bristle.diagnosis.answer import Estimate
from bristle.diagnosis.checks.preparation import dataset_of, slides_of
from bristle.diagnosis.following.controller import controllers
from bristle.diagnosis.following.whole_loop import following_case
from bristle.diagnosis.init.proposal import propose
from bristle.diagnosis.modelfile import Model, model_text
from bristle.diagnosis.report.proposed_model import model_text as proposed_text
from bristle.diagnosis.report.text.said import said as sentence
from bristle.diagnosis.stages.sliding_motion import from_sliding_motion
from bristle.harness.scenario.reading import load
from bristle.harness.scenario.samples import read_samples

STEP = 2 * np.pi / 8192
TRUE = {"J": 0.01, "a2": 0.2, "Fc": 0.12}
TREE = {
    "friction": "coulomb",
    "parameters": {"J": 0.01, "a2": 0.15, "Fc": 0.1},
    "bounds": {"J": [0.002, 0.05], "a2": [0.0, 2.0], "Fc": [0.0, 0.6]},
    "time": {"column": "t", "unit": "s"},
    "input": {"column": "goal", "kind": "setpoint", "unit": "rad"},
    "output": {"column": "theta", "kind": "position", "unit": "rad", "resolution": STEP},
}


def goal_of(rng, n, h):
    """Return steps, ramps and rests (n,)."""
    at, x, out = 0, 0.0, np.zeros(n)
    while at < n:
        length, size = int(rng.uniform(0.2, 1.0) / h), rng.choice([-1, 1]) * rng.uniform(0.05, 2.5)
        size = -size if abs(x + size) > 6.0 else size
        ramp = np.minimum(np.arange(length) / (length * rng.choice([0.02, 0.5, 1.0])), 1.0)
        out[at : at + length] = (x + size * ramp)[: n - at]
        at, x = at + length, x + size
    return out


def driven(goal, h, gains, extra=lambda theta: 0.0, seed=1):
    """Return the position of a servo, simulated apart from the package: Coulomb friction by
    projection, the controller every millisecond.
    """
    rng = np.random.default_rng(seed)
    steps, dt = round(h / 1e-4), 1e-4
    theta = v = integral = torque = before = noise = 0.0
    out = np.empty(len(goal))
    for k, r in enumerate(goal):
        out[k] = STEP * math.floor(theta / STEP)
        for i in range(steps):
            if i % 10 == 0:
                seen = STEP * math.floor(theta / STEP)
                integral += gains.get("ki", 0.0) * (r - seen) * 1e-3
                rate = (seen - before) / 1e-3
                before = seen
                torque = gains["kp"] * (r - seen) + integral - gains.get("kd", 0.0) * rate
                torque = max(-gains.get("limit", 1e9), min(gains.get("limit", 1e9), torque))
                noise += 0.02 * (rng.normal() * 0.02 - noise)
            free = v + dt / TRUE["J"] * (torque + noise + extra(theta) - TRUE["a2"] * v)
            hold = dt / TRUE["J"] * TRUE["Fc"]
            v = 0.0 if abs(free) <= hold else free - math.copysign(hold, free)
            theta += dt * v
    return out


def records_of(gains, h=2e-3, seconds=14.0, extra=lambda theta: 0.0):
    model, columns = Model.from_dict(deepcopy(TREE)), []
    for k in range(2):
        goal = goal_of(np.random.default_rng(10 + k), round(seconds / h), h)
        time = 100.0 * k + h * np.arange(len(goal))
        columns.append((f"run {k}", time, goal, driven(goal, h, gains, extra, k)))
    return model, records_from_arrays(model, columns)


def driven_at_speed(goal, h, gains, seed):
    """Return the velocity of a servo in a PI loop of it, as differences of the encoder's readings;
    the controller acts at each sample.
    """
    rng, dt = np.random.default_rng(seed), h / 10
    theta = v = integral = before = noise = 0.0
    out = np.zeros(len(goal))
    for k, r in enumerate(goal):
        reading = STEP * math.floor(theta / STEP)
        out[k] = (reading - before) / h if k else 0.0
        before = reading
        torque = gains["kd"] * (r - out[k]) + integral
        integral += gains["kp"] * (r - out[k]) * h
        for _ in range(10):
            noise += 0.02 * (rng.normal() * 0.02 - noise)
            free = v + dt / TRUE["J"] * (torque + noise - TRUE["a2"] * v)
            hold = dt / TRUE["J"] * TRUE["Fc"]
            v = 0.0 if abs(free) <= hold else free - math.copysign(hold, free)
            theta += dt * v
    return out


def at_speed(gains, seconds=14.0, h=2e-3):
    """Return a model of a velocity loop, and the columns of two records."""
    tree = deepcopy(TREE)
    tree["input"]["unit"] = "rad/s"
    tree["output"] = {"column": "speed", "kind": "velocity", "unit": "rad/s"}
    columns = []
    for k in range(2):
        goal = 1.5 * goal_of(np.random.default_rng(20 + k), round(seconds / h), h)
        time = 100.0 * k + h * np.arange(len(goal))
        columns.append((f"run {k}", time, goal, driven_at_speed(goal, h, gains, k)))
    return Model.from_dict(tree), columns


# -- the model file --------------------------------------------------------------------------------
def test_a_model_file_with_a_setpoint_reads_back():
    tree = deepcopy(TREE) | {"controller": {"kp": 4.0, "limit": "0.8 N.m"}}
    tree["bounds"] |= {"controller.ki": [0.0, 9.0]}
    model = Model.from_dict(tree)
    assert model.controller == {"kp": 4.0, "limit": 0.8}
    assert model.bounds["controller.ki"] == (0.0, 9.0)
    assert (model.input_unit, model.drive) == ("rad", "torque")
    assert model.unit("controller.kp") == "N.m/rad"
    again = Model.from_dict(tomllib.loads(model_text(model)))
    assert (again.controller, again.bounds) == (model.controller, model.bounds)
    # what acts on an input acts on the torque that is asked for
    assert model.unit("saturation.limit") == "N.m"


def test_a_linear_axis_has_forces():
    tree = deepcopy(TREE)
    tree["input"]["unit"] = tree["output"]["unit"] = "mm"
    tree["output"]["resolution"] = 0.01
    model = Model.from_dict(tree)
    assert (model.input_unit, model.drive, model.controller) == ("m", "force", {})
    assert model.unit("controller.kp") == "N/m"


def test_a_goal_in_the_unit_of_a_velocity_is_summed_as_its_output_is():
    model, columns = at_speed({"kp": 6.0, "kd": 0.3}, seconds=3.0)
    [first, _] = records_from_arrays(model, columns)
    _, time, goal, speed = columns[0]
    h = time[1] - time[0]
    assert np.diff(first.u) == pytest.approx(h * goal[1:])
    assert np.diff(first.y) == pytest.approx(h * speed[1:], abs=1e-9)
    again = Model.from_dict(tomllib.loads(model_text(model)))
    assert (again.goal_is_rate, again.differences, again.output_kind) == (True, True, "position")
    assert again.unit("controller.kp") == "N.m/rad"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"controller": {"kq": 1.0}}, "no parameter of a controller"),
        ({"controller": {"kp": -1.0}}, "(torque over error of position)"),
        ({"controller": {"limit": 0.0}}, "outside"),
        ({"input": {"column": "u", "kind": "torque", "unit": "N.m"}, "controller": {}}, "setpoint"),
        (
            {"output": {"column": "v", "kind": "velocity", "unit": "rad/s"}},
            "column of the position",
        ),
        ({"input": {"column": "goal", "kind": "setpoint", "unit": "N.m"}}, "N.m"),
    ],
)
def test_what_cannot_be_is_one_line(change, said):
    with pytest.raises(BristleError) as error:
        Model.from_dict(deepcopy(TREE) | change)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_the_observers_of_a_scenario_need_what_drives_the_servo(tmp_path):
    t = np.arange(3000) * 1e-3
    table = np.column_stack([t, np.sin(t), np.sin(t - 0.05)])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,goal,theta", comments="")
    lines = ['[observer]\nmethod = "rls"', '[record]\nfile = "a.csv"']
    lines += ['[record.time]\ncolumn = "t"\nunit = "s"']
    lines += ['[record.input]\ncolumn = "goal"\nkind = "setpoint"\nunit = "rad"']
    lines += ['[record.output]\ncolumn = "theta"\nkind = "position"\nunit = "rad"']
    (tmp_path / "s.toml").write_text("\n".join(lines) + "\n")
    with pytest.raises(BristleError, match=r"record.input.kind.*observers need what drives"):
        read_samples(load(tmp_path / "s.toml"))


def test_a_goal_that_is_the_position_itself_is_no_goal():
    model, [record, *_] = records_of({"kp": 6.0}, seconds=3.0)
    same = [("a", record.time, record.y, record.y)]
    with pytest.raises(BristleError, match="goal and output hold the same values"):
        records_from_arrays(model, same)


def test_a_controller_that_is_not_known_is_not_validated():
    model, records = records_of({"kp": 6.0}, seconds=3.0)
    with pytest.raises(BristleError, match=r"controller\.kp is not given"):
        validate(model, records)


# -- what the motion shows of the controller -------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize(
    "gains",
    [
        {"kp": 6.0},
        {"kp": 6.0, "ki": 12.0},
        {"kp": 6.0, "kd": 0.3},
        {"kp": 6.0, "limit": 1.2},
    ],
    ids=lambda gains: " ".join(gains),
)
def test_its_structure_and_its_gains_are_found(gains):
    model, records = records_of(gains)
    found = controllers(model, slides_of(dataset_of(model, records)))[0].controller
    assert ("ki" in found) == ("ki" in gains)
    assert ("limit" in found) == ("limit" in gains)
    # relative to the nominal inertia, which is the true one
    assert found["kp"] == pytest.approx(6.0, rel=0.05)
    for name, near in (("ki", 0.05), ("limit", 0.15)):
        if name in gains:
            assert found[name] / found["kp"] == pytest.approx(gains[name] / 6.0, rel=near)


@pytest.mark.slow
def test_a_velocity_loop_is_found_from_goal_and_velocity_alone():
    gains = {"kp": 6.0, "kd": 0.3}  # its integral and proportional gain
    model, columns = at_speed(gains)
    records = records_from_arrays(model, columns)
    found = controllers(model, slides_of(dataset_of(model, records)))[0].controller
    assert found["kp"] == pytest.approx(gains["kp"], rel=0.25)
    assert found["kd"] / found["kp"] == pytest.approx(gains["kd"] / gains["kp"], rel=0.1)
    assert found.get("ki", 0.0) == 0.0


def test_what_is_known_stays():
    _, records = records_of({"kp": 6.0}, seconds=6.0)
    known = Model.from_dict(deepcopy(TREE) | {"controller": {"kp": 6.0}})
    found = controllers(known, slides_of(dataset_of(known, records)))[0].controller
    assert found["kp"] == 6.0


@pytest.mark.long
def test_a_gain_that_is_given_sets_the_scale_of_a_rough_model():
    """A proposed model has an inertia of 1, from which no bounds reach that of the true gain."""
    _, records = records_of({"kp": 6.0}, seconds=6.0)
    tree = deepcopy(TREE) | {"controller": {"kp": 6.0}}
    tree["parameters"] = {name: 100.0 * x for name, x in tree["parameters"].items()}
    tree["bounds"] = {name: [100.0 * x for x in ends] for name, ends in tree["bounds"].items()}
    case = following_case(Model.from_dict(tree), records, (), lambda name, share: None)
    assert case.model.controller["kp"] == 6.0
    for name, true in (("J", TRUE["J"]), ("coulomb.Fc", TRUE["Fc"])):
        assert case.base.fit.values[name] == pytest.approx(true, rel=0.1)
        assert case.model.bounds[name][1] < 20 * true
    [note] = case.later
    assert note.facts["scale"] == pytest.approx(0.01, rel=0.1)
    assert "J, a2 and friction" in sentence(note)


def test_without_a_setpoint_a_model_stays_as_it_is():
    tree = deepcopy(TREE) | {"input": {"column": "u", "kind": "torque", "unit": "N.m"}}
    model = Model.from_dict(tree)
    assert controllers(model, lambda tried: pytest.fail("tried")) == [model]


# -- the diagnosis ---------------------------------------------------------------------------------
@pytest.mark.long
def test_cogging_is_named_through_the_loop_and_ratios_are_right():
    amplitude = 0.08
    model, records = records_of(
        {"kp": 6.0}, extra=lambda theta: amplitude * math.sin(9 * theta + 1.0)
    )
    answer = diagnose(model, records)
    content = answer.to_dict()
    assert [each["name"] for each in content["effects"]] == ["cogging"]
    kp = content["parameters"]["controller.kp"]["value"]
    assert content["parameters"]["controller.kp"]["ci95"] is None
    found = content["effects"][0]["parameters"]
    assert found["amplitude"]["value"] / kp == pytest.approx(amplitude / 6.0, rel=0.05)
    assert found["periods"]["value"] == pytest.approx(9.0, abs=0.05)
    friction = content["parameters"]["coulomb.Fc"]
    assert friction["value"] / kp == pytest.approx(TRUE["Fc"] / 6.0, rel=0.05)
    inertia = content["parameters"]["J"]["value"]
    assert inertia / kp == pytest.approx(TRUE["J"] / 6.0, rel=0.03)
    assert any("only their ratios are known" in line for line in content["findings"])


@pytest.mark.long
def test_a_weight_that_outweighs_friction_is_named_through_the_loop():
    """Without it no loop comes near the records: they are looked for together."""
    model, records = records_of(
        {"kp": 4.0}, h=5e-3, extra=lambda theta: -2.5 * math.sin(theta + 0.3)
    )
    content = diagnose(model, records).to_dict()
    assert [each["name"] for each in content["effects"]] == ["gravity"]
    kp = content["parameters"]["controller.kp"]["value"]
    found = content["effects"][0]["parameters"]
    assert found["amplitude"]["value"] / kp == pytest.approx(2.5 / 4.0, rel=0.01)
    assert found["phase"]["value"] == pytest.approx(0.3, abs=0.01)
    for name in ("J", "coulomb.Fc"):
        true = TRUE[name.rpartition(".")[2]] / 4.0
        assert content["parameters"][name]["value"] / kp == pytest.approx(true, rel=0.03)


# -- the proposal ----------------------------------------------------------------------------------
def test_goal_and_position_alone_are_proposed_as_a_setpoint(tmp_path):
    _, records = records_of({"kp": 6.0}, seconds=8.0)
    path = tmp_path / "log.csv"
    table = np.column_stack([records[0].time - records[0].time[0], records[0].u, records[0].y])
    header = "time [s],goal_position [rad],present_position [rad]"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    found = propose([path])
    assert (found.input.kind, found.input.column.column) == ("setpoint", "goal_position [rad]")
    assert found.output.column.column == "present_position [rad]"
    assert found.rough["J"].value == 1.0
    assert found.controller["kp"] == pytest.approx(6.0 / TRUE["J"], rel=0.3)
    written = Model.from_dict(tomllib.loads(proposed_text(found, "next")))
    assert written.controller == {}
    assert written.parameters["coulomb.Fc"] / found.controller["kp"] == pytest.approx(
        TRUE["Fc"] / 6.0, rel=0.2
    )


@pytest.mark.slow
def test_goal_and_velocity_alone_are_proposed_as_a_setpoint(tmp_path):
    """Explained by inertia and friction, a goal of the velocity would pass for what drives it."""
    gains = {"kp": 6.0, "kd": 0.3}
    _, columns = at_speed(gains, seconds=8.0)
    path = tmp_path / "log.csv"
    table = np.column_stack([columns[0][1], np.rad2deg(columns[0][2:]).T])
    header = "time [s],target speed [deg/s],speed [deg/s]"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    for asked in (None, {"input": "target speed [deg/s]"}):
        found = propose([path], asked)
        assert (found.input.kind, found.input.column.unit) == ("setpoint", "deg/s")
        assert found.output.column.column == "speed [deg/s]"
        assert found.controller["kd"] * TRUE["J"] == pytest.approx(gains["kd"], rel=0.3)


def test_an_inertia_reaches_as_far_as_a_late_damping_hides(answer):
    """J - kd lag is all that shows: with a damping of 0.3, 5 ms late, 1.5e-3 more than seems."""
    values = {"J": (0.01, 0.009, 0.011), "a2": (0.1, 0.0, 0.2), "controller.kd": (0.2, 0.1, 0.3)}
    values |= {"controller.lag": (1e-3, 0.0, 2e-3)}
    known = {name: Estimate(x, "", (low, high), False) for name, (x, low, high) in values.items()}

    def interval(controller):
        case = SimpleNamespace(model=SimpleNamespace(controller=controller))
        found = from_sliding_motion(case, replace(answer("none"), base=known, fitted=known), None)
        assert found.base == found.fitted
        assert {name: e for name, e in found.fitted.items() if name != "J"} == {
            name: e for name, e in known.items() if name != "J"
        }
        return found.fitted["J"].ci95

    # what of the damping is late by the lag that was found is in J already
    assert interval({"kp": 3.0, "kd": 0.2}) == pytest.approx((0.009, 0.011 + 1.5e-3 - 0.2e-3))
    assert interval({"kp": 3.0, "kd": 0.0}) == (0.009, 0.011)
