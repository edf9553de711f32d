"""Two positions, of motor and load: play, compliance and waves are seen in their difference."""

import math
import tomllib
from copy import deepcopy

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis import Model, diagnose, load_records, records_from_arrays
from bristle.diagnosis.between.two_positions import between_sensors
from bristle.diagnosis.modelfile import model_text
from bristle.diagnosis.report.text.statement import between_line

H, STEP = 1e-3, 2 * math.pi / 40000
TREE = {
    "friction": "coulomb",
    "parameters": {"J": 0.01, "a2": 0.02, "Fc": 0.09},
    "time": {"column": "t", "unit": "s"},
    "input": {"column": "u", "kind": "torque", "unit": "N.m"},
    "output": {
        "column": "motor",
        "kind": "position",
        "unit": "rad",
        "resolution": STEP,
        "load": {"column": "load", "unit": "rad"},
    },
}
J_LOAD = 0.006


def prescribed(difference, friction=0.04, seed=0):
    """Return a record whose load moves as given, and the motor apart from it by a function of the
    torque in the coupling and the position of the load.
    """
    rng = np.random.default_rng(seed)
    t = H * np.arange(12000)
    w, size = np.array([1.3, 4.1, 9.7]), np.array([2.0, 0.8, 0.15])
    angle = t[:, None] * w + rng.uniform(0, 6, 3)
    theta = (size * np.sin(angle)).sum(axis=1)
    v = (size * w * np.cos(angle)).sum(axis=1)
    a = -(size * w**2 * np.sin(angle)).sum(axis=1)
    torque = J_LOAD * a + friction * np.sign(v)
    apart = difference(torque, theta)
    shown = [STEP * np.floor(x / STEP) for x in (theta + apart, theta)]
    return "run", t, torque + 0.01 * np.sin(t), shown[0], {"load": shown[1]}


def found(difference, **how):
    model = Model.from_dict(deepcopy(TREE))
    return between_sensors(model, records_from_arrays(model, [prescribed(difference, **how)]))


def test_nothing_between_the_sensors_is_nothing():
    seen = found(lambda torque, theta: 0 * theta)
    assert seen.parts == {}
    assert "nothing is seen" in between_line(seen)


@pytest.mark.parametrize("play", [0.003, 0.02])
def test_a_play_follows_the_sign_of_the_torque(play):
    seen = found(lambda torque, theta: 0.5 * play * np.sign(torque) + torque / 300.0)
    assert list(seen.parts) == ["backlash"]
    estimate = seen.parts["backlash"]["play"]
    assert estimate.value == pytest.approx(play, rel=0.02)
    low, high = estimate.ci95
    assert low - STEP < play < high + STEP
    assert "a play of 0.0" in between_line(seen)


def test_a_compliance_follows_its_size():
    stiffness = 20.0
    seen = found(lambda torque, theta: torque / stiffness)
    assert list(seen.parts) == ["compliance"]
    frequency = math.sqrt(stiffness / J_LOAD) / (2 * math.pi)
    assert seen.parts["compliance"]["frequency"].value == pytest.approx(frequency, rel=0.05)


@pytest.mark.parametrize(("periods", "name"), [(1, "eccentric_encoder"), (3, "transmission_error")])
def test_a_wave_follows_the_position(periods, name):
    seen = found(lambda torque, theta: 0.004 * np.sin(periods * theta + 0.7))
    assert list(seen.parts) == [name]
    wave = seen.parts[name]
    assert wave["amplitude"].value == pytest.approx(0.004, rel=0.03)
    assert wave["phase"].value == pytest.approx(0.7, abs=0.05)
    assert wave["periods"].value == periods


def test_a_play_beside_an_eccentric_wheel():
    seen = found(lambda torque, theta: 0.006 * np.sign(torque) + 0.01 * np.sin(theta))
    assert set(seen.parts) == {"backlash", "eccentric_encoder"}
    assert seen.parts["backlash"]["play"].value == pytest.approx(0.012, rel=0.05)
    assert seen.parts["eccentric_encoder"]["amplitude"].value == pytest.approx(0.01, rel=0.03)


def flying(seed, seconds=8.0, play=0.02):
    """Return a record of two inertias with a play between them, through which the load flies."""
    rng, step = np.random.default_rng(seed), 5e-5
    p = rng.uniform(0, 6, 3)
    xm = vm = xl = vl = 0.0
    rows = []
    for k in range(round(seconds / H)):
        t = k * H
        u = 0.22 * math.sin(4.4 * t + p[0]) + 0.15 * math.sin(12 * t + p[1])
        u += 0.1 * math.sin(1.4 * t + p[2])
        rows.append((t, u, xm, xl))
        for _ in range(round(H / step)):
            d = xm - xl
            deep = d - math.copysign(min(abs(d), play / 2), d)
            torque = 0.0
            if deep:
                torque = 60.0 * deep + 0.15 * (vm - vl)
                torque = max(torque, 0.0) if deep > 0 else min(torque, 0.0)
            vm += step / 0.004 * (u - torque - 0.01 * vm - 0.05 * math.tanh(vm / 0.01))
            vl += step / J_LOAD * (torque - 0.01 * vl - 0.04 * math.tanh(vl / 0.01))
            xm += step * vm
            xl += step * vl
    t, u, motor, load = np.array(rows).T
    shown = [STEP * np.floor(x / STEP) for x in (motor, load)]
    return f"run {seed}", t + 50 * seed, u, shown[0], {"load": shown[1]}


@pytest.mark.slow
def test_a_play_through_which_the_load_flies():
    model = Model.from_dict(deepcopy(TREE))
    seen = between_sensors(model, records_from_arrays(model, [flying(1), flying(2)]))
    assert list(seen.parts) == ["backlash"]
    assert seen.parts["backlash"]["play"].value == pytest.approx(0.02, rel=0.05)


def test_the_column_is_read_and_written_back(tmp_path):
    model = Model.from_dict(deepcopy(TREE))
    again = Model.from_dict(tomllib.loads(model_text(model)))
    assert again.load == model.load
    _, t, u, motor, known = prescribed(lambda torque, theta: 0 * theta)
    table = np.column_stack([t, u, motor, known["load"]])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,u,motor,load", comments="")
    [record] = load_records(model, [tmp_path / "a.csv"])
    np.testing.assert_allclose(record.known["load"], known["load"], rtol=1e-12)


def test_what_cannot_be_is_one_line():
    tree = deepcopy(TREE)
    tree["output"] |= {"kind": "velocity", "unit": "rad/s"}
    del tree["output"]["resolution"]
    with pytest.raises(BristleError, match=r"output\.load"):
        Model.from_dict(tree)
    model = Model.from_dict(deepcopy(TREE))
    name, t, u, motor, _ = prescribed(lambda torque, theta: 0 * theta)
    with pytest.raises(BristleError, match=r"lacks output\.load"):
        diagnose(model, records_from_arrays(model, [(name, t, u, motor)]))
