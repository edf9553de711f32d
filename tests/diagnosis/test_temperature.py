"""Friction that falls as the servo warms, with its temperature in a column of the records."""

import math
import tomllib
from copy import deepcopy

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.common.units import quantity
from bristle.diagnosis import diagnose, load_records
from bristle.diagnosis.modelfile import Model, model_text
from bristle.model.native import Native
from bristle.plant.servo import servo_program

H, STEP, SECONDS = 2e-3, 2e-4, 20.0
TREE = {
    "friction": "coulomb",
    "parameters": {"J": 0.04, "a2": 0.12, "Fc": 0.3},
    "bounds": {"J": [0.01, 0.2], "a2": [0.0, 1.0], "Fc": [0.0, 2.0]},
    "time": {"column": "t", "unit": "s"},
    "input": {"column": "u", "kind": "torque", "unit": "N.m"},
    "output": {"column": "y", "kind": "position", "unit": "rad", "resolution": STEP},
    "known": {"temperature": {"column": "T", "unit": "degC"}},
}


def warming(seed, begin, viscous):
    """Return time, input, position and temperature [degC] of a servo that warms by 30 K in a
    record, in a loop, simulated apart from the package.
    """
    rng, n = np.random.default_rng(seed), round(SECONDS / H)
    t = H * np.arange(n)
    warm = begin + 30.0 * (1.0 - np.exp(-t / 8.0))
    goal = 1.2 * np.sin(2.9 * t + seed) + 0.4 * np.sin(6.9 * t) + 0.05 * np.sin(31.0 * t)
    u, y, theta, v, noise = np.empty(n), np.empty(n), 0.0, 0.0, 0.0
    for k in range(n):
        y[k] = STEP * round(theta / STEP)
        noise += 0.02 * (0.1 * rng.normal() - noise)
        u[k] = 60.0 * (goal[k] - y[k]) - 2.0 * v
        drag = 0.2 * math.exp(-viscous * (warm[k] - 20.0))
        for _ in range(10):
            free = v + H / 10 / 0.05 * (u[k] + noise - drag * v)
            hold = H / 10 / 0.05 * 0.3
            before, v = v, 0.0 if abs(free) <= hold else free - math.copysign(hold, free)
            theta += H / 20 * (before + v)
    return np.column_stack([t, u, y, warm])


def records_in(folder, model, viscous):
    paths = []
    for k, begin in enumerate((18.0, 35.0)):
        paths.append(folder / f"run{k}.csv")
        table = warming(k, begin, viscous)
        np.savetxt(paths[-1], table, delimiter=",", header="t,u,y,T", comments="")
    return load_records(model, paths)


def test_viscous_friction_falls_by_half_where_the_exponent_says():
    """A motion that only viscous friction brakes: v falls as exp(-a2(T)/J t)."""
    count, program = 300, servo_program("coulomb", encoder=False, effects=("temperature_friction",))
    given = {"J": 0.1, "a2": 0.4, "coulomb.Fc": 0.0, "v_start": 2.0}
    for kelvin, factor in ((293.15, 1.0), (293.15 + math.log(2.0) / 0.03, 0.5)):
        inputs = {"u": np.zeros(count), "temperature_friction.temperature": np.full(count, kelvin)}
        values = given | {"temperature_friction.viscous_fall": 0.03}
        v = Native(program, values).run(H, inputs, ["v"])[0][:, 0]
        expected = 2.0 * np.exp(-factor * 4.0 * H * np.arange(count + 1))
        np.testing.assert_allclose(v, expected, rtol=1e-6)


def test_readings_in_degrees_are_kelvin_inside_and_the_file_reads_back(tmp_path):
    model = Model.from_dict(deepcopy(TREE))
    assert model.effects == {}
    assert quantity("20 degC", "K") == pytest.approx(293.15)
    [first, _] = records_in(tmp_path, model, 0.02)
    assert first.known["known.temperature"][0] == pytest.approx(18.0 + 273.15)
    assert Model.from_dict(tomllib.loads(model_text(model))).known == model.known


def test_kelvin_that_are_called_degrees_are_one_line(tmp_path):
    model = Model.from_dict(deepcopy(TREE))
    table = warming(1, 293.15, 0.0)
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,u,y,T", comments="")
    with pytest.raises(BristleError, match=r"known\.temperature is 566.* check its unit") as error:
        load_records(model, [tmp_path / "a.csv"])
    assert "\n" not in str(error.value)


def test_friction_by_temperature_needs_its_column():
    tree = deepcopy(TREE) | {"effects": {"temperature_friction": {"viscous_fall": 0.02}}}
    assert Model.from_dict(tree).effects["temperature_friction"] == {
        "viscous_fall": 0.02,
        "dry_fall": 0.0,
    }
    del tree["known"]
    with pytest.raises(BristleError, match=r"effects\.temperature_friction.*known\.temperature"):
        Model.from_dict(tree)


@pytest.mark.long
@pytest.mark.parametrize("viscous", [0.0, 0.02])
def test_it_is_named_with_its_size_where_it_is_and_only_there(tmp_path, viscous):
    model = Model.from_dict(deepcopy(TREE))
    found = diagnose(model, records_in(tmp_path, model, viscous))
    if viscous == 0.0:
        assert found.verdict == "none"
        return
    assert [e.name for e in found.effects] == ["temperature_friction"]
    size = found.effects[0].parameters["viscous_fall"]
    assert size.value == pytest.approx(viscous, rel=0.1)
    assert size.ci95[0] <= viscous <= size.ci95[1]
