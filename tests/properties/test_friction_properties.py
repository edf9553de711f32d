"""What must hold for every input: bounds, symmetry, steady state, dissipativity, change of
units.
"""

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.friction import law
from bristle.plant.servo import servo_program

FEW = settings(max_examples=15, deadline=None, derandomize=True)
H = 1e-3
SEED = st.integers(0, 2**32 - 1)


@cache
def alone(name):
    """Return a law whose velocity is the input; `work` is the integral of K(v) v w, where K(v) v is
    w' + c |v| w.
    """
    system, which = System("alone"), law(name)
    for parameter in (
        Parameter("J", "J", "kg.m2", 0.001, 1e-9, 1e6, "inertia", "dixit2008 eq. (7)"),
        *which.parameters,
    ):
        system.parameter(parameter)
    v = system.input(Variable("v", "rad/s", "velocity"))
    own = system.namespace(f"{name}.")
    for state in which.states:
        system.state(State(state.name, state.unit, state.description, scale=state.scale(own)))
    friction = which.equations(own, v)
    for state, rate in friction.rates.items():
        system.rate(state, rate)
    system.state(State("work", "J", "supplied energy", scale=1e-3))
    system.state(State("mechanical", "J", "energy taken from the motion", scale=1e-9))
    system.rate("mechanical", friction.force * v)
    if name == "modified":
        deg = ca.fabs(v) * 180.0 / math.pi
        k = (
            own.sigma0
            + own.sigma1 * ca.exp(-((deg / 10) ** 2))
            + own.sigma2 * ca.exp(-(((deg - 20) / 20) ** 2))
        )
        system.rate("work", k * v * own.w)
    else:
        system.rate("work", own.z * v)
    system.output(Variable("F", "N.m", "force"), friction.force)
    for place in ("work", "mechanical"):
        system.output(Variable(f"{place}_out", "J", place), system.symbols[place])
    return Program("Alone", [system])


@cache
def servo(name):
    return servo_program(name, encoder=False)


def velocities(seed, size, n=1500):
    """Return a jumping and a wandering part, with reversals and rests."""
    rng = np.random.default_rng(seed)
    levels = np.repeat(rng.normal(size=n // 50) * (rng.random(n // 50) > 0.2), 50)
    return size * (levels + 0.3 * np.sin(np.arange(n) * rng.uniform(0.01, 0.3)))


LUGRE = st.fixed_dictionaries(
    {
        "lugre.sigma0": st.floats(0.1, 100.0),
        "lugre.sigma1": st.floats(0.0, 0.05),
        "lugre.Fc": st.floats(1e-3, 0.02),
        "lugre.vs": st.floats(0.01, 2.0),
        "lugre.Fs": st.floats(1.0, 3.0),
    }
)
MODIFIED = st.fixed_dictionaries(
    {
        "modified.sigma0": st.floats(50.0, 2000.0),
        "modified.sigma1": st.floats(0.0, 3000.0),
        "modified.sigma2": st.floats(0.0, 1000.0),
        "modified.c": st.floats(20.0, 500.0),
    }
)
SIZE = st.floats(1e-3, 20.0)


def lugre(values):
    """Fs is drawn as a multiple of Fc."""
    return values | {"lugre.Fs": values["lugre.Fs"] * values["lugre.Fc"]}


@pytest.mark.sampled(4)
@FEW
@given(LUGRE, SEED, SIZE)
def test_deflection_stays_below_fs_over_sigma0_and_is_dissipative(values, seed, size):
    values = lugre(values)
    native = Native(alone("lugre"), values)
    record, _ = native.run(H, {"v": velocities(seed, size)}, ["alone.z", "work_out"])
    limit = values["lugre.Fs"] / values["lugre.sigma0"]
    z, work = record.T
    assert np.max(np.abs(z)) <= limit * (1 + 1e-6)
    assert np.max(np.abs(z)) > 0.01 * limit
    # int z v >= d(z^2/2) over every stretch: the surplus never falls
    assert np.all(np.diff(work - z**2 / 2) >= -1e-6 * limit**2 - 1e-11)


def surplus(values, v, viscous, h=H):
    """Return int F v - sigma0 z^2/2, with viscous friction sigma2 v in F, at each sample."""
    record, _ = Native(alone("lugre"), values).run(h, {"v": v}, ["alone.z", "mechanical_out"])
    z, energy = record.T
    return (
        energy
        + viscous * np.concatenate([[0.0], np.cumsum(v**2 * h)])
        - values["lugre.sigma0"] * z**2 / 2
    )


@FEW
@given(LUGRE, SEED, SIZE, st.floats(1.0, 5.0))
def test_lugre_takes_energy_where_viscous_friction_outweighs_the_bristles_damping(
    values, seed, size, factor
):
    """int F v >= d(sigma0 z^2/2) for sigma2 >= sigma1 (Fs - Fc)/Fc.

    Source: barabanov2000.
    """
    values, v = lugre(values), velocities(seed, size)
    viscous = (
        factor
        * values["lugre.sigma1"]
        * (values["lugre.Fs"] - values["lugre.Fc"])
        / values["lugre.Fc"]
    )
    found = surplus(values, v, viscous)
    assert np.all(np.diff(found) >= -1e-6 * values["lugre.Fs"] ** 2 / values["lugre.sigma0"])
    assert found[-1] > 0.0


@pytest.mark.parametrize(("viscous", "passive"), [(0.4, False), (158.2, True)])
def test_set_t_gives_energy_back(viscous, passive):
    """Set T has sigma2 = 0.4 N.s/m where 158 would be needed: bent at rest and pulled on, its
    bristles push.
    """
    values = {
        "lugre.sigma0": 1e5,
        "lugre.sigma1": math.sqrt(1e5),
        "lugre.Fc": 1.0,
        "lugre.Fs": 1.5,
        "lugre.vs": 1e-3,
    }
    rest = surplus(values, np.full(2000, 1e-5), viscous, 1e-2)
    assert rest[-1] - rest[0] > 0.0
    v = np.concatenate([np.full(20_000, 1e-5), np.full(300, 0.1)])
    found = surplus(values, v, viscous)[20_000:]
    assert (np.min(np.diff(found)) >= 0.0) == passive


@FEW
@given(MODIFIED, SEED, SIZE)
def test_modified_friction_is_bounded_and_dissipative(values, seed, size):
    native = Native(alone("modified"), values)
    record, _ = native.run(H, {"v": velocities(seed, size)}, ["alone.w", "work_out"])
    w, work = record.T
    deg = np.linspace(0.0, 200.0, 20_001)
    k = (
        values["modified.sigma0"]
        + values["modified.sigma1"] * np.exp(-((deg / 10) ** 2))
        + values["modified.sigma2"] * np.exp(-(((deg - 20) / 20) ** 2))
    )
    limit = np.max(k) / values["modified.c"]
    assert np.max(np.abs(w)) <= limit * (1 + 1e-6)
    assert np.all(np.diff(work - w**2 / 2) >= -1e-6 * limit**2)


@FEW
@given(
    st.sampled_from(["lugre", "modified", "modified_polynomial", "coulomb", "viscous"]),
    SEED,
    st.floats(0.2, 20.0),
)
def test_odd_symmetry_to_the_last_bit(name, seed, size):
    rng = np.random.default_rng(seed)
    u = size * np.cumsum(rng.normal(size=800)) * 0.05
    tau = 0.002 * rng.normal(size=800)
    record = ["theta", "v", "F"]
    there, _ = Native(servo(name)).run(H, {"u": u, "tau_load": tau}, record)
    back, _ = Native(servo(name)).run(H, {"u": -u, "tau_load": -tau}, record)
    assert np.max(np.abs(there[:, 1])) > 0.0
    np.testing.assert_array_equal(there, -back)


@FEW
@given(LUGRE, st.floats(1e-3, 50.0), st.sampled_from([-1.0, 1.0]))
def test_steady_lugre_friction_is_the_stribeck_curve(values, speed, side):
    values, v = lugre(values), side * speed
    fc, fs = values["lugre.Fc"], values["lugre.Fs"]
    g = fc + (fs - fc) * math.exp(-((v / values["lugre.vs"]) ** 2))
    pace = 30.0 * g / (values["lugre.sigma0"] * speed) / 500  # thirty time constants in 500 steps
    native = Native(alone("lugre"), values | {"solver.max_step": 1.0})
    record, _ = native.run(pace, {"v": np.full(500, v)}, ["F"])
    assert record[-1, 0] == pytest.approx(side * g, rel=1e-6)


@FEW
@given(st.floats(0.05, 20.0), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 0.02))
def test_the_servo_settles_where_drive_balances_friction(volts, side, sigma1):
    u = side * (1.2 + volts)  # above break-away
    native = Native(servo("lugre"), {"lugre.sigma1": sigma1, "a2": 0.01})
    record, _ = native.run(H, {"u": np.full(4000, u)}, ["v", "F"])
    v, force = record[-1]
    g = 0.004 + 0.0032 * math.exp(-((v / 0.4363323129985824) ** 2))
    assert force == pytest.approx(side * g + 0.01 * v, rel=1e-5)
    assert force == pytest.approx(0.0065 * u, rel=1e-5)


@FEW
@given(LUGRE, SEED, st.floats(0.5, 10.0))
def test_results_do_not_depend_on_the_unit_of_angle(values, seed, size):
    """A servo computed in degrees, with all parameters converted, is the same servo."""
    values, d = lugre(values), 180.0 / math.pi
    u = size * np.repeat(np.random.default_rng(seed).normal(size=20), 40)
    tolerance = {"solver.tolerance": 1e-10}
    radian, _ = Native(servo("lugre"), values | tolerance).run(H, {"u": u}, ["theta", "v", "F"])
    # torque stays N.m: stiffness, damping and inertia are per degree, speeds in degrees
    scaled = {"J": 0.001 / d, "a2": 0.002 / d} | {
        name: x * {"sigma0": 1 / d, "sigma1": 1 / d, "vs": d}.get(name.split(".")[1], 1.0)
        for name, x in values.items()
    }
    degree, _ = Native(servo("lugre"), scaled | tolerance).run(H, {"u": u}, ["theta", "v", "F"])
    size = np.max(np.abs(radian), axis=0)
    assert np.all(np.abs(degree / [d, d, 1.0] - radian) <= 1e-6 * size)


@FEW
@given(MODIFIED, SEED, st.floats(0.5, 10.0))
def test_modified_sigmas_do_not_change_with_the_unit_of_torque(values, seed, size):
    """In mN.m only J, b and a2 change: sigma_i and c are friction over inertia."""
    u = size * np.repeat(np.random.default_rng(seed).normal(size=20), 40)
    newton, _ = Native(servo("modified"), values).run(H, {"u": u}, ["theta", "v", "F"])
    milli, _ = Native(servo("modified"), values | {"J": 1.0, "b": 6.5, "a2": 2.0}).run(
        H, {"u": u}, ["theta", "v", "F"]
    )
    size = np.max(np.abs(newton), axis=0)
    assert np.all(np.abs(milli / [1.0, 1.0, 1000.0] - newton) <= 1e-8 * size)


def cycle_energy(w1, slow, fast):
    """Return the energy J int w v dt of: load slowly to w1, unload fast to w = 0."""
    native = Native(alone("modified"), {"solver.tolerance": 1e-11})
    times, v = [], []
    for speed, start, end in ((slow, 0.0, w1), (-fast, w1, 0.0)):
        deg = math.degrees(abs(speed))
        k = (
            600.0
            + 800.0 * math.exp(-((deg / 10) ** 2))
            + 300.0 * math.exp(-(((deg - 20) / 20) ** 2))
        )
        goal = math.copysign(k / 150.0, speed)
        # exponential at constant speed
        times.append(math.log((start - goal) / (end - goal)) / (150.0 * abs(speed)))
        v.append(speed)
    energy = w = 0.0
    for duration, speed in zip(times, v, strict=True):
        record, _ = native.run(
            duration / 50, {"v": np.full(50, speed)}, ["mechanical_out", "alone.w"]
        )
        energy, w = record[-1]
    return energy, w


def test_remark_4_fails_a_cycle_returns_energy():
    """Dissipativity of v -> w, claimed in dixit2008 remark 4, does not hold: more comes out than
    went in.
    """
    slow, fast = math.radians(0.1), math.radians(60.0)
    energy, w = cycle_energy(0.3, slow, fast)
    assert abs(w) < 1e-8  # the state is back where it began
    assert energy == pytest.approx(-4.05e-8, rel=0.005)
    # as w1 -> 0 the energy tends to J w1^2/2 (1/K_fast - 1/K_slow) < 0
    k_slow, k_fast = (
        600 + 800 * math.exp(-1e-4) + 300 * math.exp(-((19.9 / 20) ** 2)),
        600 + 300 * math.exp(-4),
    )
    ratios = []
    for w1 in (0.3, 0.1, 0.03):
        limit = 0.001 * w1**2 / 2 * (1 / k_slow - 1 / k_fast)
        ratios.append(cycle_energy(w1, slow, fast)[0] / limit)
    assert ratios[2] == pytest.approx(1.0, abs=0.05)
    assert abs(ratios[2] - 1) < abs(ratios[1] - 1) < abs(ratios[0] - 1)
