"""A joint in an arm: the torque of the rest of the arm and the inertia are columns."""

import math
import tomllib
from copy import deepcopy

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis import diagnose, load_records, records_from_arrays, validate
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.checks.records import as_inputs
from bristle.diagnosis.estimation.fitted_model import sliding_fit
from bristle.diagnosis.modelfile import Model, model_text
from bristle.model.native import Native
from bristle.plant.servo import servo_program

H, STEP = 1e-3, 2e-4
TRUE = {"J": 0.05, "a2": 0.1, "Fc": 0.4}
TREE = {
    "friction": "coulomb",
    "parameters": {"J": 0.04, "a2": 0.12, "Fc": 0.3},
    "bounds": {"J": [0.01, 0.2], "a2": [0.0, 1.0], "Fc": [0.0, 2.0]},
    "time": {"column": "t", "unit": "s"},
    "input": {"column": "u", "kind": "torque", "unit": "N.m"},
    "output": {"column": "y", "kind": "position", "unit": "rad", "resolution": STEP},
    "known": {
        "torque": {"column": "tau", "unit": "N.m"},
        "inertia_factor": {"column": "m", "unit": "1"},
    },
}


def joint(seed, seconds=10.0, scale=1.0, extra=lambda theta: 0.0):
    """Return time, input, position and what is known of a joint in a loop, simulated apart from
    the package; the rest of the arm really asks for `scale` times the known torque.
    """
    rng, n = np.random.default_rng(seed), round(seconds / H)
    t = H * np.arange(n)
    goal = 1.2 * np.sin(1.9 * t + seed) + 0.3 * np.sin(6.9 * t) + 0.05 * np.sin(31.0 * t)
    tau = 3.0 * np.sin(1.4 * t + 1.0) + 1.5 * np.cos(3.8 * t + seed)
    factor = 1.0 + 0.5 * np.sin(1.1 * t + seed)
    u, y, theta, v, noise = np.empty(n), np.empty(n), 0.0, 0.0, 0.0
    for k in range(n):
        y[k] = STEP * round(theta / STEP)
        noise += 0.02 * (0.1 * rng.normal() - noise)
        u[k] = tau[k] + 60.0 * (goal[k] - y[k]) - 2.0 * v
        for _ in range(5):
            by = H / 5 / (TRUE["J"] * factor[k])
            free = v + by * (u[k] - scale * tau[k] + noise + extra(theta) - TRUE["a2"] * v)
            hold = by * TRUE["Fc"]
            v = 0.0 if abs(free) <= hold else free - math.copysign(hold, free)
            theta += H / 5 * v
    return t, u, y, {"torque": tau, "inertia_factor": factor}


def records_of(model, **how):
    columns = [(f"run {k}", *joint(k, **how)) for k in range(2)]
    return records_from_arrays(
        model, [(name, 50.0 * k + t, *rest) for k, (name, t, *rest) in enumerate(columns)]
    )


def test_a_known_torque_and_a_factor_move_a_servo_as_newton_says():
    program = servo_program("viscous", encoder=False, effects=("known",))
    given = {"J": 0.1, "a2": 0.0, "b": 1.0, "u_max": 1e6}
    count = 400
    inputs = {
        "u": np.full(count, 0.7),
        "known.torque": np.full(count, 0.2),
        "known.inertia_factor": np.full(count, 2.5),
    }
    theta = Native(program, given).run(H, inputs, ["theta"])[0][:, 0]
    expected = 0.5 * (0.7 - 0.2) / (0.1 * 2.5) * (H * np.arange(count + 1)) ** 2
    np.testing.assert_allclose(theta, expected, rtol=1e-6, atol=1e-12)


def test_the_model_file_reads_back():
    model = Model.from_dict(deepcopy(TREE))
    assert model.effects == {"known": {"scale": 1.0}}
    assert {key: column.column for key, column in model.known.items()} == {
        "torque": "tau",
        "inertia_factor": "m",
    }
    again = Model.from_dict(tomllib.loads(model_text(model)))
    assert (again.known, again.effects) == (model.known, model.effects)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"known": {"torque": {"column": "tau", "unit": "kg"}}}, "known.torque"),
        ({"known": {"torque": {"column": "u", "unit": "N.m"}}}, "already"),
        ({"known": {"force": {"column": "f", "unit": "N"}}}, "force"),
        (
            {
                "known": {
                    "inertia": {"column": "a", "unit": "kg.m2"},
                    "inertia_factor": {"column": "m", "unit": "1"},
                }
            },
            "remove one",
        ),
    ],
)
def test_what_cannot_be_known_is_one_line(change, said):
    with pytest.raises(BristleError) as error:
        Model.from_dict(deepcopy(TREE) | change)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_columns_are_read_with_their_units_and_an_inertia_becomes_a_factor(tmp_path):
    t, u, y, known = joint(0, seconds=4.0)
    table = np.column_stack([t, u, y, 1e3 * known["torque"], 0.04 * known["inertia_factor"]])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,u,y,tau,m", comments="")
    tree = deepcopy(TREE)
    tree["known"] = {
        "torque": {"column": "tau", "unit": "1", "scale": "0.001 N.m"},
        "inertia": {"column": "m", "unit": "kg.m2"},
    }
    model = Model.from_dict(tree)
    [record] = load_records(model, [tmp_path / "a.csv"])
    np.testing.assert_allclose(record.known["known.torque"], known["torque"], rtol=1e-9)
    [taken] = as_inputs(model, [record])
    np.testing.assert_allclose(
        taken.known["known.inertia_factor"], known["inertia_factor"], rtol=1e-9
    )


def test_records_without_what_is_known_are_refused():
    model = Model.from_dict(deepcopy(TREE))
    t, u, y, _ = joint(0, seconds=3.0)
    records = records_from_arrays(model, [("a", t, u, y)])
    with pytest.raises(BristleError, match="lacks the known torque"):
        diagnose(model, records)


def test_the_motion_that_slides_shows_the_joint_and_the_scale_of_what_is_known():
    model = Model.from_dict(deepcopy(TREE))
    records = records_of(model, scale=0.9)
    dataset = dataset_of(model, as_inputs(model, records))
    fit = sliding_fit(dataset, *base_servo_of(model, dataset))
    known = fit.deviations()
    for name, true in (("J", 0.05), ("coulomb.Fc", 0.4), ("known.scale", 0.9)):
        assert fit.values[name] == pytest.approx(true, rel=0.02)
        assert abs(fit.values[name] - true) < 4 * known[name]
    # without the columns the same records show another servo
    plain = deepcopy(TREE)
    del plain["known"]
    other = Model.from_dict(plain)
    parts = [(r.name, r.time, r.u, r.y) for r in records]
    dataset = dataset_of(other, as_inputs(other, records_from_arrays(other, parts)))
    wrong = sliding_fit(dataset, *base_servo_of(other, dataset))
    assert abs(wrong.values["coulomb.Fc"] - 0.4) > 0.1


@pytest.mark.long
def test_cogging_of_a_joint_is_named_and_a_wrong_mass_is_said():
    model = Model.from_dict(deepcopy(TREE))
    records = records_of(
        model, seconds=14.0, scale=0.9, extra=lambda theta: 0.2 * math.sin(11 * theta + 0.5)
    )
    answer = diagnose(model, records)
    assert [each.name for each in answer.effects] == ["cogging"]
    amplitude = answer.effects[0].parameters["amplitude"]
    assert amplitude.value == pytest.approx(0.2, rel=0.03)
    assert answer.parameters["coulomb.Fc"].value == pytest.approx(0.4, rel=0.03)
    assert answer.parameters["J"].value == pytest.approx(0.05, rel=0.03)
    assert any("known torque fits best times 0.9" in line for line in answer.findings)


@pytest.mark.slow
def test_a_model_with_what_is_known_validates():
    tree = deepcopy(TREE)
    tree["parameters"] = dict(TRUE)
    model = Model.from_dict(tree)
    found = validate(model, records_of(model, seconds=5.0))
    plain = deepcopy(tree)
    del plain["known"]
    other = Model.from_dict(plain)
    parts = [(r.name, r.time, r.u, r.y) for r in records_of(model, seconds=5.0)]
    worse = validate(other, records_from_arrays(other, parts))
    assert found.records[0].rms < 0.1 * worse.records[0].rms
