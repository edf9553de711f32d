"""The servo around the law: drive, load inputs, encoder, true parameters, errors."""

import math
import tomllib
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.model.basis import gaussian
from bristle.model.native import Native
from bristle.model.normalised import OBSERVED
from bristle.plant.friction import law, laws
from bristle.plant.servo import servo_program

H = 1e-3
GRID = 2 * math.pi / 40000
SHIPPED = (
    "coulomb",
    "dahl",
    "elastoplastic",
    "gms",
    "leuven",
    "lugre",
    "lugre_velocity_damping",
    "modified",
    "modified_polynomial",
    "stribeck_static",
    "viscous",
)


def test_every_file_in_friction_is_a_law():
    lists = tomllib.loads((Path(__file__).parents[1] / "shipped.toml").read_text(encoding="utf-8"))
    assert {*SHIPPED, *lists["laws"]} <= set(laws())
    assert list(laws()) == sorted(laws())
    assert law("lugre").name == "lugre"


def test_an_unknown_law_is_refused_in_one_line():
    with pytest.raises(
        BristleError,
        match=r"'dahlia' \(did you mean 'dahl'\?\); known: coulomb, dahl, elastoplastic",
    ) as caught:
        servo_program("dahlia")
    assert "\n" not in str(caught.value)


# -- drive and loads -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHIPPED)
def test_the_drive_saturates_at_u_max(name):
    program = servo_program(name)
    asked = 100.0 * np.sin(0.02 * np.arange(1500))
    found, _ = Native(program, {"u_max": 5.0}).run(H, {"u": asked}, ["theta", "v", "F"])
    cut, _ = Native(program, {"u_max": 1e3}).run(
        H, {"u": np.clip(asked, -5.0, 5.0)}, ["theta", "v", "F"]
    )
    np.testing.assert_array_equal(found, cut)
    free, _ = Native(program, {"u_max": 1e3}).run(H, {"u": asked}, ["v"])
    assert np.max(np.abs(free)) > 2 * np.max(np.abs(found[:, 1]))


@pytest.mark.parametrize("name", SHIPPED)
def test_load_torque_acts_like_drive_torque_but_is_not_cut(name):
    program, u = servo_program(name), 3.0 * np.sin(0.02 * np.arange(1000))
    by_drive, _ = Native(program).run(H, {"u": u}, ["v"])
    by_load, _ = Native(program).run(H, {"tau_load": 0.0065 * u}, ["v"])
    np.testing.assert_allclose(by_load, by_drive, rtol=1e-9, atol=1e-12)
    loaded, _ = Native(program).run(
        H, {"u": np.full(3000, 24.0), "tau_load": np.full(3000, 0.0065 * 24)}, ["v"]
    )
    driven, _ = Native(program).run(H, {"u": np.full(3000, 48.0)}, ["v"])
    assert loaded[-1, 0] > 1.5 * driven[-1, 0]


@pytest.mark.parametrize(
    ("name", "dry"),
    [
        (name, 0.0 if name == "viscous" else 0.004)
        for name in SHIPPED
        if name != "modified_polynomial"
    ],
)
def test_load_scale_scales_dry_friction_and_nothing_else(name, dry):
    program, n = servo_program(name), 6000
    speeds = {}
    for scale in (0.0, 1.0, 2.0):
        record, _ = Native(program).run(
            H, {"u": np.full(n, 10.0), "load_scale": np.full(n, scale)}, ["v", "F"]
        )
        v, force = record[-1]
        speeds[scale] = v
        assert force == pytest.approx(scale * dry + 0.002 * v, rel=1e-4)
        assert v == pytest.approx(
            (0.065 - scale * dry) / 0.002 * (1 - math.exp(-2.0 * 6.0)), rel=2e-3
        )
    assert speeds[0.0] - speeds[1.0] == pytest.approx(dry / 0.002, abs=0.01)
    assert speeds[1.0] - speeds[2.0] == pytest.approx(dry / 0.002, abs=0.01)


@pytest.mark.parametrize("name", SHIPPED)
def test_friction_is_what_newton_leaves_over(name):
    """J v' = b u + tau - F, integrated over each step with the trapezoidal rule."""
    program, n = servo_program(name), 4000
    u = 4.0 * np.sin(0.01 * np.arange(n))
    record, _ = Native(program).run(H / 10, {"u": u, "tau_load": np.full(n, 1e-3)}, ["v", "F"])
    v, force = record.T
    change = 0.001 * np.diff(v)
    impulse = (0.0065 * u + 1e-3 - 0.5 * (force[:-1] + force[1:])) * H / 10
    moving = v[:-1] * v[1:] > 0.0  # while it sticks, dry friction follows each new voltage at once
    assert np.mean(moving) > 0.7
    assert np.max(np.abs(change - impulse)[moving]) < 2e-3 * np.max(np.abs(0.0065 * u)) * H / 10


@pytest.mark.parametrize("name", SHIPPED)
def test_starting_values(name):
    native = Native(servo_program(name), {"theta_start": -0.7, "v_start": 2.5})
    record, _ = native.run(H, {"u": np.zeros(2)}, ["theta", "v", "theta_enc", "v_enc"])
    assert record[0, 0] == -0.7
    assert record[0, 1] == 2.5
    assert record[0, 2] == pytest.approx(math.floor(-0.7 / GRID) * GRID, abs=1e-12)
    assert record[0, 3] == 0.0


# -- encoder ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("counts", [40000.0, 500.0])
def test_the_encoder_floors_to_its_grid_and_differences_it(counts):
    grid, n = 2 * math.pi / counts, 1500
    u = 3.0 * np.sin(0.02 * np.arange(n))
    native = Native(servo_program("lugre"), {"encoder.counts": counts, "theta_start": -0.01})
    record, _ = native.run(H, {"u": u}, ["theta", "theta_enc", "v_enc"])
    theta, shown, speed = record.T
    lines = np.rint(shown / grid)
    np.testing.assert_allclose(shown, lines * grid, rtol=0, atol=1e-12)
    gap = theta - shown
    assert np.min(gap) >= -1e-12  # floored, not rounded
    assert np.max(gap) < grid + 1e-12
    assert np.max(gap) > 0.9 * grid
    assert np.min(theta) < 0.0 < np.max(theta)
    np.testing.assert_allclose(speed[1:], np.diff(lines) * grid / H, rtol=0, atol=1e-9)


def test_one_count_is_nine_degrees_a_second():
    record, _ = Native(servo_program("viscous")).run(H, {"u": np.full(200, 1.0)}, ["v_enc"])
    levels = np.unique(np.rint(np.degrees(record[:, 0]) / 9.0 * 1e6) / 1e6)
    assert len(levels) > 3
    np.testing.assert_allclose(levels, np.rint(levels), atol=1e-6)


def test_a_servo_without_encoder_has_no_encoder_outputs_and_moves_alike():
    u = 3.0 * np.sin(0.02 * np.arange(500))
    bare, full = servo_program("lugre", encoder=False), servo_program("lugre")
    assert "theta_enc" not in bare.index
    assert "encoder.counts" not in bare.index
    found, _ = Native(bare).run(H, {"u": u}, ["theta", "v"])
    expected, _ = Native(full).run(H, {"u": u}, ["theta", "v"])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


# -- true parameters -------------------------------------------------------------------------------

J = 0.002
OWN = {
    "modified": {
        "modified.sigma0": 500.0,
        "modified.sigma1": 700.0,
        "modified.sigma2": 200.0,
        "modified.c": 125.0,
        "modified.tau": 0.01,
    },
    "modified_polynomial": {"modified_polynomial.sigma0": 500.0, "modified_polynomial.c": 125.0},
    "lugre": {"lugre.Fc": 0.006, "lugre.Fs": 0.01},
    "coulomb": {"coulomb.Fc": 0.006},
    "dahl": {"dahl.Fc": 0.006},
    "elastoplastic": {"elastoplastic.Fc": 0.006},
    "gms": {"gms.Fc": 0.006},
    "leuven": {"leuven.Fc": 0.006},
    "lugre_velocity_damping": {"lugre_velocity_damping.Fc": 0.006},
    "stribeck_static": {"stribeck_static.Fc": 0.006},
    "viscous": {},
}
EXPECTED = {
    "modified": {
        "Fc": 4.0,
        "sigma0": 500.0,
        "sigma1": 700.0,
        "sigma2": 200.0,
        "c": 125.0,
        "tau": 0.01,
        "width": 1.0,
    },
    "modified_polynomial": {"sigma0": 500.0, "c": 125.0, "tau": 0.0},
    "lugre": {"Fc": 3.0, "a0": 0.0075, "a1": 0.005, "v0": math.radians(25)},
    "lugre_velocity_damping": {"Fc": 3.0, "a0": 0.0075, "a1": 0.0015, "v0": math.radians(25)},
    "elastoplastic": {"Fc": 3.0, "a0": 0.0075, "a1": 0.0015, "v0": math.radians(25)},
    "dahl": {"Fc": 3.0, "a0": 0.0075},
    "gms": {"Fc": 3.0, "v0": math.radians(25)},
    "stribeck_static": {"Fc": 3.0, "v0": math.radians(25)},
    "coulomb": {"Fc": 3.0},
    "leuven": {"Fc": 3.0},
    "viscous": {},
}


@pytest.mark.parametrize("name", SHIPPED)
def test_true_parameters_are_normalised_and_what_is_missing_is_not_valid(name):
    program = servo_program(name)
    values = Native(program, {"J": J, "b": 0.01, "a2": 0.003, **OWN[name]}).values
    expected = {"alpha2": 1.5, "b": 5.0, "load": 0.0, "delay": 0.0, **EXPECTED[name]}
    names = {
        "alpha2",
        "b",
        "Fc",
        "sigma0",
        "sigma1",
        "sigma2",
        "c",
        "tau",
        "vc",
        "a0",
        "a1",
        "v0",
        "load",
        "delay",
        "width",
    }
    names |= {"sigma0_1", "sigma0_2", "sigma0_3"}
    assert set(OBSERVED) == names
    for parameter in names - {"vc"}:  # which follows from the others; see below
        value = values[program.index[f"true.{parameter}"]]
        valid = values[program.index[f"true.{parameter}_valid"]]
        assert valid == (1.0 if parameter in expected else 0.0)
        if parameter in expected:
            assert value == pytest.approx(expected[parameter], rel=1e-14)
        else:
            assert value == 0.0


@pytest.mark.sampled(4)
def test_the_true_gate_is_where_the_basis_functions_leave_five_percent():
    """At the gate the friction level differs by 5 % from Coulomb friction, above it by less,
    whatever the weights.
    """
    program = servo_program("modified")
    for sigma in (
        {},
        {"modified.sigma2": 50.0},
        {"modified.sigma1": 0.0, "modified.sigma2": -300.0},
    ):
        servo = Native(program, {"J": J, "b": 0.01, "a2": 0.003} | sigma)
        weights = [
            dict(zip((s.name for s in program.slots), servo.values, strict=True))[
                f"modified.sigma{i}"
            ]
            for i in range(3)
        ]
        gate = servo.values[program.index["true.vc"]]
        speeds = np.linspace(0.999 * gate, 3 * gate, 2000)
        last = np.array([float(ca.evalf(gaussian(ca.SX(v))[-1])) for v in speeds])
        share = np.abs(weights[2] * last / weights[0])
        assert share[speeds >= gate].max() < 0.05 < share[0] < 0.051


@pytest.mark.parametrize("name", SHIPPED)
def test_the_true_gate_is_where_the_stribeck_effect_leaves_five_percent(name):
    """A friction level Fc + (Fs - Fc) exp(-(v/vs)^2) is within 5 % of Fc from there on; other laws
    have no such speed.
    """
    program = servo_program(name)
    stribeck = {f"{name}.Fc": 0.006, f"{name}.Fs": 0.0084, f"{name}.vs": 0.5}
    # whose elements may stop short of the curve
    has = f"{name}.vs" in program.index and name != "leuven"
    servo = Native(program, {"J": J} | (stribeck if has else {}))
    assert servo.values[program.index["true.vc_valid"]] == (name == "modified" or has)
    if has:
        gate = servo.values[program.index["true.vc"]]
        assert 0.0024 * math.exp(-((gate / 0.5) ** 2)) == pytest.approx(0.05 * 0.006, rel=1e-12)


@pytest.mark.parametrize("name", [name for name in SHIPPED if "Fc" in EXPECTED[name]])
def test_the_true_coulomb_friction_is_what_a_fast_shaft_feels(name):
    program = servo_program(name)
    native = Native(program, {"J": J, "b": 0.01, "a2": 0.003, **OWN[name]})
    record, _ = native.run(H, {"u": np.full(4000, 20.0)}, ["v", "F"])
    v, force = record[-1]
    assert (force - 0.003 * v) / J == pytest.approx(
        native.values[program.index["true.Fc"]], rel=1e-3
    )


# -- errors ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "parameter", "value", "unit"),
    [
        ("lugre", "J", -1.0, "kg.m2"),
        ("lugre", "lugre.Fc", 0.0, "N.m"),
        ("coulomb", "coulomb.Fc", -0.1, "N.m"),
        ("modified", "modified.c", math.nan, "1/rad"),
        ("viscous", "encoder.counts", 0.0, "1"),
        ("viscous", "solver.tolerance", 1.0, "1"),
        ("lugre", "sample_time", 0.0, "s"),
    ],
)
def test_a_parameter_outside_its_interval_is_named_with_unit_and_range(
    name, parameter, value, unit
):
    with pytest.raises(BristleError) as caught:
        Native(servo_program(name), {parameter: value})
    text = str(caught.value)
    assert text.startswith(f"{parameter} = ")
    assert f" {unit} is outside [" in text
    assert f"] {unit}; choose" in text
    assert "\n" not in text


def test_lugre_without_stribeck_effect_is_the_modified_law_with_tau():
    """With Fs = Fc: w = sigma0 z/J, sigma0/J, c = sigma0/Fc and tau = sigma1/sigma0 turn one law
    into the other.
    """
    n = 3000
    u = 3.0 * np.sin(0.02 * np.arange(n)) + np.sin(0.11 * np.arange(n))
    lugre, modified = (
        servo_program("lugre", encoder=False),
        servo_program("modified", encoder=False),
    )
    own = {"lugre.sigma0": 0.8, "lugre.sigma1": 0.02, "lugre.Fc": 0.004, "lugre.Fs": 0.004}
    same = {
        "modified.sigma0": 800.0,
        "modified.sigma1": 0.0,
        "modified.sigma2": 0.0,
        "modified.c": 200.0,
        "modified.tau": 0.025,
    }
    first, _ = Native(lugre, own).run(H, {"u": u}, ["theta", "v", "F"])
    second, _ = Native(modified, same).run(H, {"u": u}, ["theta", "v", "F"])
    size = np.ptp(first, axis=0)
    assert np.all(np.abs(second - first) <= [1e-8, 1e-8, 1e-7] * size)
    without, _ = Native(modified, same | {"modified.tau": 0.0}).run(
        H, {"u": u}, ["theta", "v", "F"]
    )
    assert np.max(np.abs(without - first) / size) > 1e-3
