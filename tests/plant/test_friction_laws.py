"""Each friction law against what does not come from its code: closed forms, located solutions,
properties, experiments.
"""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.friction import law, laws
from bristle.plant.servo import servo_program

H = 1e-3
J, B, A2 = 0.001, 0.0065, 0.002  # defaults of the servo,
S0, S1, FC, FS, VS = 0.8, 0.002, 0.004, 0.0072, 0.4363323129985824  # of the laws,
FADING = 0.02  # sigma1 of the law whose damping fades,
# of the elements
C, K, ALPHA, W = (
    0.2,
    (0.4, 0.25, 0.15, 0.08),
    (0.1, 0.2, 0.3, 0.4),
    (0.0008, 0.0016, 0.0024, 0.0032),
)
FEW = settings(max_examples=10, deadline=None, derandomize=True)
MEMORY = tuple(name for name in laws() if law(name).states)
STRIBECK = ("elastoplastic", "gms", "leuven", "lugre", "lugre_velocity_damping")


def level(v, fc=FC, fs=FS, vs=VS):
    return fc + (fs - fc) * math.exp(-((v / vs) ** 2))


@cache
def alone(name):
    """Return a law whose velocity is an input; x is the path, `work` the energy taken from the
    motion.
    """
    system, which = System("alone"), law(name)
    for parameter in (
        Parameter("J", "J", "kg.m2", J, 1e-9, 1e6, "inertia", "dixit2008 eq. (7)"),
        *which.parameters,
    ):
        system.parameter(parameter)
    v = system.input(Variable("v", "rad/s", "velocity"))
    own = system.namespace(f"{name}.")
    for state in which.states:
        system.state(State(state.name, state.unit, state.description, scale=state.scale(own)))
    for mode in which.modes:
        system.mode(mode)
    friction = which.equations(own, v)
    for state, rate in friction.rates.items():
        system.rate(state, rate)
    for mode, (following, *past) in friction.switches.items():
        system.update(mode, following)
        system.margin(mode, *past)
    for what, rate, size in (("x", v, 1e-3), ("work", friction.force * v, 1e-6)):
        system.state(State(what, "1", what, scale=size))
        system.rate(what, rate)
    system.output(Variable("F", "N.m", "friction"), friction.force)
    return Program("Alone", [system])


def pulled(name, v, h=H, record=("F",), **parameters):
    """Return what a law does at the velocities v, one column for each name."""
    values = {k if k.startswith("solver") else f"{name}.{k}": x for k, x in parameters.items()}
    found, _ = Native(alone(name), values).run(h, {"v": np.asarray(v, dtype=float)}, list(record))
    return found.T


@cache
def servo(name):
    return servo_program(name, encoder=False)


# -- closed forms at constant velocity -------------------------------------------------------------


@pytest.mark.parametrize("v", [1e-3, 0.3, -0.3, 20.0])
def test_dahl_relaxes_exponentially_with_the_path(v):
    n = 300
    [force] = pulled("dahl", np.full(n, v))
    path = v * H * np.arange(n + 1)
    np.testing.assert_allclose(
        force, math.copysign(FC, v) * (1 - np.exp(-S0 * np.abs(path) / FC)), rtol=0, atol=2e-7 * FC
    )


@pytest.mark.parametrize("v", [1e-3, 0.3, -0.3, 2.0])
def test_lugre_with_fading_damping_relaxes_exponentially(v):
    n, vd = 300, 0.5
    force, z = pulled("lugre_velocity_damping", np.full(n, v), record=("F", "alone.z"))
    g = level(v)
    decay = np.exp(-S0 * abs(v) / g * H * np.arange(n + 1))
    expected = math.copysign(g, v) * (1 - decay) + FADING * math.exp(-((v / vd) ** 2)) * v * decay
    np.testing.assert_allclose(force[1:], expected[1:], rtol=0, atol=2e-7 * FS)
    np.testing.assert_allclose(
        z, math.copysign(g / S0, v) * (1 - decay), rtol=0, atol=2e-7 * FS / S0
    )


@pytest.mark.parametrize("v", [2e-3, 0.4, -0.4])
def test_elastoplastic_is_a_spring_up_to_break_away_and_then_yields_along_a_sine(v):
    """Up to z_ba it is F = sigma0 x + sigma1 v; the path from there to any z is an integral of 1/(1
    - alpha z/z_ss).
    """
    share, zss = 0.7, level(v) / S0
    zba = share * FC / S0

    def slope(z):
        alpha = 0.5 * math.sin(math.pi * (z - (zss + zba) / 2) / (zss - zba)) + 0.5
        return 1 / (1 - alpha * z / zss)

    ends = [0.3 * zba, 0.99 * zba, *(zba + part * (zss - zba) for part in (0.2, 0.5, 0.8, 0.97))]
    for z in ends:
        path = z if z < zba else zba + quad(slope, zba, z, epsabs=0, epsrel=1e-11)[0]
        force, found = pulled(
            "elastoplastic",
            np.full(100, v),
            h=path / abs(v) / 100,
            record=("F", "alone.z"),
            share=share,
            sigma1=S1,
        )
        rate = v * (1 if z < zba else 1 / slope(z))
        assert found[-1] == pytest.approx(math.copysign(z, v), rel=2e-6)
        assert force[-1] == pytest.approx(S0 * math.copysign(z, v) + S1 * rate, rel=5e-6)


@pytest.mark.parametrize("v", [0.02, 0.3, -0.3, 3.0])
def test_gms_loads_along_straight_lines(v):
    n = 400
    [force] = pulled("gms", np.full(n, v))
    t = H * np.arange(n + 1)
    expected = sum(
        np.minimum(k * abs(v) * t, alpha * level(v)) for k, alpha in zip(K, ALPHA, strict=True)
    )
    np.testing.assert_allclose(force, math.copysign(1, v) * expected, rtol=0, atol=1e-6 * FS)


@pytest.mark.parametrize(("before", "after"), [(0.3, 1.0), (1.0, 0.3), (-1.0, -0.1), (0.2, 5.0)])
def test_slipping_gms_follows_the_friction_level_with_a_lag(before, after):
    """Also where the level rises: an element that slips does not stick because its force is below
    its limit.
    """
    n = 1000
    [force] = pulled("gms", np.concatenate([np.full(n, before), np.full(100, after)]))
    first, last = level(before), level(after)
    lag = np.exp(-C / last * H * np.arange(101))
    np.testing.assert_allclose(
        force[n:], math.copysign(1, after) * (last + (first - last) * lag), rtol=0, atol=1e-6 * FS
    )


@pytest.mark.parametrize("n", [1.0, 2.0])
@pytest.mark.parametrize("v", [0.05, -1.5])
def test_leuven_loads_along_exponentials_or_tangents(n, v):
    """dF/dt = K v (1 - (F/s)^n), K the stiffness of the elements that still stick: piecewise in
    closed form.
    """
    s, times, force = level(v), np.linspace(0.0, 0.12 / abs(v), 301), 0.0
    [found] = pulled("leuven", np.full(300, v), h=times[1], n=n, sigma1=0.0)
    order = sorted(zip(K, W, strict=True), key=lambda each: each[1] / each[0])
    expected, begin, z = np.zeros(301), 0.0, 0.0
    for i, (k, w) in enumerate([*order, (1.0, math.inf)]):
        stiffness = sum(k for k, _ in order[i:])
        until = force + stiffness * (w / k - z)  # when the next one slips
        pace = stiffness * abs(v) / s

        def at(t, pace=pace, force=force, begin=begin):
            if n == 1:
                return s - (s - force) * np.exp(-pace * (t - begin))
            return s * np.tanh(pace * (t - begin) + math.atanh(force / s))

        expected = np.where(times >= begin, at(times), expected)
        if stiffness == 0 or until >= s:
            break
        begin += (
            math.log((s - force) / (s - until))
            if n == 1
            else math.atanh(until / s) - math.atanh(force / s)
        ) / pace
        force, z = until, w / k
    assert i >= 2
    np.testing.assert_allclose(found, math.copysign(1, v) * expected, rtol=0, atol=2e-6 * FS)


@pytest.mark.parametrize("name", STRIBECK)
@pytest.mark.parametrize("v", [0.05, -0.3, 0.6, -10.0])
def test_steady_friction_is_the_stribeck_curve(name, v):
    [force] = pulled(name, np.full(400, v), h=max(1.0 / abs(v), 1.0) / 400)
    assert force[-1] == pytest.approx(math.copysign(level(v), v), rel=1e-6)


@pytest.mark.parametrize(
    "name", ["dahl", "elastoplastic", "gms", "leuven", "lugre_velocity_damping", "stribeck_static"]
)
@pytest.mark.parametrize("volts", [2.0, -2.0])
def test_a_servo_settles_where_the_drive_balances_friction(name, volts):
    record, _ = Native(servo(name), {"a2": 0.02}).run(H, {"u": np.full(1500, volts)}, ["v", "F"])
    v, force = record[-1]
    assert force == pytest.approx(
        math.copysign(FC if name == "dahl" else level(v), v) + 0.02 * v, rel=1e-6
    )
    assert force == pytest.approx(B * volts, rel=1e-6)


# -- properties ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(laws()))
def test_odd_symmetry_to_the_last_bit(name):
    rng = np.random.default_rng(3)
    u, tau = (
        4.0 * np.sin(0.03 * np.arange(800)) + rng.normal(size=800),
        0.002 * rng.normal(size=800),
    )
    there, _ = Native(servo(name)).run(H, {"u": u, "tau_load": tau}, ["theta", "v", "F"])
    back, _ = Native(servo(name)).run(H, {"u": -u, "tau_load": -tau}, ["theta", "v", "F"])
    assert np.sum(np.diff(np.sign(there[1:, 1])) != 0) > 2
    np.testing.assert_array_equal(there, -back)


def test_dahl_is_rate_independent_and_lugre_is_not():
    v = 0.5 * np.sin(0.05 * np.arange(600)) + 0.3 * np.sin(0.13 * np.arange(600))
    for name, alike in (("dahl", True), ("lugre", False)):
        [slow], [fast] = pulled(name, v), pulled(name, 10 * v, h=H / 10)
        assert (np.max(np.abs(fast - slow)) < 1e-6 * FC) == alike


def path(seed, size=0.02, n=12):
    """Return steps along a path with n reversals and nested loops, 20 a stretch."""
    turns = np.random.default_rng(seed).uniform(-size, size, n)
    return np.repeat(np.diff(np.concatenate([[0.0], turns])) / 20, 20)


@FEW
@given(st.integers(0, 2**32 - 1), st.floats(0.002, 0.05))
def test_slow_gms_is_the_sum_of_its_stops(seed, size):
    """Rate independent, with the memory of every turning point: f <- clip(f + k dx), whatever the
    time it takes.
    """
    steps = path(seed, size)
    forces, expected = np.zeros(4), [0.0]
    limits = FS * np.array(ALPHA)
    for dx in steps:
        forces = np.clip(forces + np.array(K) * dx, -limits, limits)
        expected.append(forces.sum())
    seconds = 1.0  # speeds of milliradians a second, at which the level is Fs
    [found] = pulled("gms", steps / seconds, h=seconds, **{"solver.max_step": 1.0})
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-4 * FS)


@pytest.mark.parametrize(
    ("name", "closed"), [("gms", True), ("leuven", True), ("lugre", False), ("dahl", False)]
)
def test_an_inner_loop_closes_and_leaves_no_trace(name, closed):
    """Up to a, back to b, up again through a: the force at a, and all that follows, is as if there
    had been no loop.

    In the law of Leuven the memory is that of z, and the loop closes in z: with a large n that is
    the path.
    """
    up, down = np.full(100, 1.0), np.full(40, -1.0)
    parameters = {"solver.max_step": 1.0} | ({"n": 20.0, "sigma1": 0.0} if name == "leuven" else {})
    pace = 4e-5 if name != "leuven" else 1e-5
    with_loop = pulled(name, pace * np.concatenate([up, down, -down, up]), h=1.0, **parameters)[0]
    without = pulled(name, pace * np.concatenate([up, up]), h=1.0, **parameters)[0]
    gap = np.max(np.abs(with_loop[180:] - without[100:])) / np.max(np.abs(without))
    assert (gap < 1e-5) == closed


def test_presliding_gms_obeys_masing():
    """Every branch after a reversal is the virgin curve at twice the scale."""
    n, pace = 200, 1e-4  # 0.02 rad: two of the elements slip
    force = pulled(
        "gms",
        pace * np.concatenate([np.full(n, 1.0), np.full(2 * n, -1.0)]),
        h=1.0,
        **{"solver.max_step": 1.0},
    )[0]
    virgin, branch = force[: n + 1], force[n:]
    np.testing.assert_allclose(branch[0] - branch[::2], 2 * virgin, rtol=0, atol=1e-5 * FS)
    assert np.max(np.abs(np.diff(virgin, 2))) > 1e-6  # it does bend


@FEW
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 5.0), st.floats(0.0, 0.999))
def test_elastoplastic_deflection_is_bounded_and_dissipative(seed, size, share):
    """int z v >= d(z^2/2): the surplus never falls, because alpha >= 0 and acts only on the way
    out.
    """
    rng = np.random.default_rng(seed)
    v = size * (np.repeat(rng.normal(size=20), 30) + 0.3 * np.sin(0.2 * np.arange(600)))
    z, work = pulled("elastoplastic", v, record=("alone.z", "alone.work"), share=share, sigma1=0.0)
    limit = FS / S0
    assert np.max(np.abs(z)) <= limit * (1 + 1e-6)
    assert np.all(np.diff(work / S0 - z**2 / 2) >= -1e-6 * limit**2)


@FEW
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 3.0), st.floats(1e-3, 0.3), st.floats(1.0, 4.0))
def test_fading_damping_keeps_lugre_passive(seed, size, sigma1, ratio):
    """int F v >= d(sigma0 z^2/2) without any viscous friction, for sigma1 vd <= 4 sqrt(2e) Fc."""
    rng = np.random.default_rng(seed)
    v = size * (np.repeat(rng.normal(size=20), 30) + 0.3 * np.sin(0.2 * np.arange(600)))
    vd = 4 * math.sqrt(2 * math.e) * FC / sigma1
    own = {"sigma1": sigma1, "vd": vd, "Fs": ratio * FC}
    z, work = pulled("lugre_velocity_damping", v, record=("alone.z", "alone.work"), **own)
    assert np.all(np.diff(work - S0 * z**2 / 2) >= -1e-6 * FS**2 / S0)


@pytest.mark.parametrize(
    ("name", "vd", "passive"), [("lugre", None, False), ("lugre_velocity_damping", 0.3, True)]
)
def test_constant_damping_gives_energy_back_after_a_jump_of_the_velocity(name, vd, passive):
    """Bent at rest to Fs/sigma0 and pulled on fast, bristles beyond the deflection they slide with
    push forward.
    """
    own = {"sigma1": 0.1, "Fs": 3 * FC} | ({"vd": vd} if vd else {})
    v = np.concatenate([np.full(200, 5e-4), np.full(100, 2.0)])
    times = np.concatenate([[0.0], np.cumsum(np.where(v < 1.0, 0.5, 1e-5))])
    native = Native(
        alone(name), {f"{name}.{k}": x for k, x in own.items()} | {"solver.max_step": 1.0}
    )
    rows = [
        native.run(h, {"v": speeds}, ["alone.z", "alone.work"])[0]
        for h, speeds in ((0.5, v[:200]), (1e-5, v[200:]))
    ]
    z, work = np.concatenate([rows[0][:-1], rows[1]]).T
    assert len(z) == len(times)
    surplus = work - S0 * z**2 / 2
    assert z[200] > 2 * FC / S0
    assert (np.min(np.diff(surplus)[200:]) >= 0.0) == passive


# -- experiments -----------------------------------------------------------------------------------

KINDS = {  # set T of canudas1995, in newtons and metres, as far as each law has it
    "lugre": {"sigma0": 1e5, "sigma1": 0.0, "Fc": 1.0, "Fs": 1.5, "vs": 1e-3},
    "elastoplastic": {
        "sigma0": 1e5,
        "sigma1": 0.0,
        "share": 0.95,
        "Fc": 1.0,
        "Fs": 1.5,
        "vs": 1e-3,
    },
    "gms": {
        "Fc": 1.0,
        "Fs": 1.5,
        "vs": 1e-3,
        "C": 100.0,
        "k1": 4e4,
        "k2": 3e4,
        "k3": 2e4,
        "k4": 1e4,
        "alpha1": 0.1,
        "alpha2": 0.2,
        "alpha3": 0.3,
        "alpha4": 0.4,
    },
}


@pytest.mark.parametrize(
    ("name", "drift", "within"),
    [("lugre", 6.08, 0.05), ("elastoplastic", 0.0, 1e-4), ("gms", 0.0, 1e-3)],
)
def test_drift_under_a_vibrating_load(name, drift, within):
    """0.6 + 0.3 sin(20 t) N below Fs = 1.5 N; 316 N.s/m beside it damp what would ring. In
    micrometres a cycle.

    Source: dupont2002, the experiment. The closed form for LuGre is that of tests/published; two
    elements of GMS slip.
    """
    n, cycles = 200, 14
    period = 2 * math.pi / 20
    t = period / n * (np.arange(n * cycles) + 0.5)
    load = 0.6 + 0.3 * np.sin(20 * t)
    given = {f"{name}.{k}": x for k, x in KINDS[name].items()} | {
        "J": 1.0,
        "a2": 316.0,
        "solver.tolerance": 1e-9,
    }
    record, _ = Native(servo(name), given).run(period / n, {"tau_load": load}, ["theta", "v"])
    per_cycle = np.diff(record[::n, 0])[-4:] * 1e6
    np.testing.assert_allclose(per_cycle, drift, rtol=0, atol=within)
    assert np.ptp(record[-n:, 0]) > 5e-6  # it does move


def test_elastoplastic_returns_from_below_break_away_and_not_from_above():
    for reach, left in ((0.99, False), (1.5, True)):
        steps = np.full(100, reach * 0.7 * FC / S0 / 100)
        z, x = pulled(
            "elastoplastic",
            np.concatenate([steps, -steps]),
            h=1.0,
            record=("alone.z", "alone.x"),
            sigma1=0.0,
        )
        assert abs(x[-1]) < 1e-9
        assert (abs(z[-1]) > 1e-5) == left


@pytest.mark.parametrize("share", [0.999, -0.999, 0.6])
def test_static_friction_holds_to_the_last_bit_up_to_fs(share):
    native = Native(servo("stribeck_static"), {"theta_start": 0.123456789})
    record, _ = native.run(H, {"u": np.full(500, share * FS / B)}, ["theta", "v", "F"])
    assert np.all(record[:, 0] == 0.123456789)
    assert np.all(record[:, 1] == 0.0)
    assert record[-1, 2] == pytest.approx(share * FS, abs=1e-15)


def test_static_friction_breaks_away_above_fs_and_is_caught_below_fc():
    """What holds Fs does not hold 5 % more; once it slides fast, it goes on as long as the drive is
    stronger than Fc.
    """
    volts = (
        np.concatenate([np.full(700, 1.05 * FS), np.full(800, 1.1 * FC), np.full(4000, 0.9 * FC)])
        / B
    )
    record, _ = Native(servo("stribeck_static"), {"a2": 0.0}).run(H, {"u": volts}, ["v"])
    assert np.all(np.diff(record[:1501, 0]) > 0)
    assert record[-1, 0] == 0.0


@pytest.mark.parametrize("name", ["elastoplastic", "gms", "lugre"])
def test_load_scales_stiffness(name):
    """Held by springs, a servo moves back to half the deflection when the load doubles: nothing
    slips, nothing is lost.
    """
    torque, stiffness = 5e-4, sum(K) if name == "gms" else S0
    n = 3000
    given = {"a2": 0.05} | ({"lugre.Fs": 1e3, "lugre.Fc": 1e3} if name == "lugre" else {})
    load = np.where(np.arange(2 * n) < n, 1.0, 2.0)
    record, _ = Native(servo(name), given).run(
        H, {"tau_load": np.full(2 * n, torque), "load_scale": load}, ["theta", "F"]
    )
    for row, scale in ((n, 1.0), (2 * n, 2.0)):
        assert record[row, 0] == pytest.approx(torque / (scale * stiffness), rel=1e-4)
        assert record[row, 1] == pytest.approx(torque, rel=1e-4)


@pytest.mark.parametrize("name", MEMORY)
def test_load_scales_friction_at_once_and_leaves_the_motion_alone(name):
    """The load trebles while it slides: the torque does at that instant, position and velocity do
    not jump.
    """
    native = Native(servo(name), {"a2": 0.0})
    first, _ = native.run(H, {"u": np.full(400, 1.5)}, ["theta", "v", "F"])
    values, index = native.values, native.program.index
    values[index["load_scale"]] = 3.0
    native.write(values)
    native.library.batch_outputs(native.core)
    theta, v, force = (native.values[index[each]] for each in ("theta", "v", "F"))
    assert (theta, v) == (first[-1, 0], first[-1, 1])
    assert force == pytest.approx(3 * first[-1, 2], rel=1e-12)
    second, _ = native.run(1e-5, {"u": np.full(10, 1.5)}, ["v"])
    assert np.max(np.abs(np.diff(second[:, 0]))) < 2e-4 * abs(v)


# -- whole runs against independent solutions ------------------------------------------------------


def volts(n):
    """Return held voltages with reversals, some too weak to slide."""
    k = np.arange(0, n, 20)
    return np.repeat(4.0 * np.sin(0.035 * k) + np.sin(0.11 * k + 0.3), 20)


def dahl(x, u):
    _, v, z = x
    return S0 * z, [v - S0 * abs(v) * z / FC]


def lugre_velocity_damping(x, u):
    _, v, z = x
    dz = v - abs(v) * z * S0 / level(v)
    return S0 * z + FADING * math.exp(-((v / 0.5) ** 2)) * dz, [dz]


def elastoplastic(x, u):
    _, v, z = x
    zmax, zba = level(v) / S0, 0.7 * FC / S0
    if z * v <= 0 or abs(z) <= zba:
        alpha = 0.0
    elif abs(z) >= zmax:
        alpha = 1.0
    else:
        alpha = 0.5 * math.sin(math.pi * (abs(z) - (zmax + zba) / 2) / (zmax - zba)) + 0.5
    dz = v * (1 - alpha * math.copysign(1, v) * z / zmax)
    return S0 * z + S1 * dz, [dz]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "equations", [dahl, lugre_velocity_damping, elastoplastic], ids=lambda e: e.__name__
)
def test_a_run_agrees_with_radau(equations):
    name, n, x = equations.__name__, 800, np.zeros(3)
    u, rows = volts(n), [np.zeros((1, 3))]

    def rates(t, x, torque):
        force, inner = equations(x, torque)
        return [x[1], (torque - A2 * x[1] - force) / J, *inner]

    for k in range(0, n, 20):
        times = H * np.arange(21)
        done = solve_ivp(
            rates, times[[0, -1]], x, "Radau", times, args=(B * u[k],), rtol=1e-9, atol=1e-12
        )
        x = done.y[:, -1]
        rows.append(done.y.T[1:])
    compare(name, u, np.concatenate(rows), ["theta", "v", f"{name}.z"], 1e-6)


def compare(name, u, expected, record, limit):
    """Compare a run with an independent one, and with itself at half the step and a tenth of the
    tolerance.
    """
    found, _ = Native(servo(name)).run(H, {"u": u}, record)
    finer, _ = Native(servo(name), {"solver.max_step": H / 2, "solver.tolerance": 2e-9}).run(
        H, {"u": u}, record
    )
    size = np.ptp(expected, axis=0)
    assert np.sum(np.diff(np.sign(expected[1:, 1])) != 0) >= 4
    assert np.all(np.abs(found - expected) <= limit * size)
    assert np.all(np.abs(found - finer) <= limit * size)


def gms_rates(mode, torque):
    def rates(t, x):
        v, s = x[1], level(x[1])
        inner = [
            K[i] * v if mode[i] == 0 else C * (ALPHA[i] * mode[i] - x[2 + i] / s) for i in range(4)
        ]
        return [v, (torque - A2 * v - sum(x[2:])) / J, *inner]

    return rates


def rising(function):
    """Return a function that stops solve_ivp where it rises through zero."""
    function.terminal, function.direction = True, 1
    return function


def gms_events(mode):
    """Return what rises through zero where an element switches, and (element, new mode) for
    each.
    """

    def full(i, side):
        return rising(
            lambda t, x: side * x[2 + i] - ALPHA[i] * level(x[1]) if side * x[1] > 0 else -FC
        )

    def reversal(m):
        return rising(lambda t, x: -m * x[1])

    targets = [(i, side) for i in range(4) for side in ((1, -1) if mode[i] == 0 else (0,))]
    return [full(i, side) if side else reversal(mode[i]) for i, side in targets], targets


def test_a_run_of_gms_agrees_with_radau_and_located_events():
    n, x, mode = 600, np.zeros(6), [0, 0, 0, 0]
    u, rows, switched = volts(n), [np.zeros((1, 6))], 0
    for k in range(0, n, 20):
        begin, times = 0.0, H * np.arange(1, 21)
        while True:
            events, targets = gms_events(mode)
            rates = gms_rates(tuple(mode), B * u[k])
            done = solve_ivp(
                rates,
                (begin, times[-1]),
                x,
                "Radau",
                events=events,
                dense_output=True,
                rtol=1e-9,
                atol=1e-12,
            )
            x, end = done.y[:, -1], done.t[-1]
            passed = times[(times > begin) & (times <= end)]
            rows += [done.sol(passed).T] if len(passed) else []
            if done.status != 1:
                break
            hits = [
                target
                for target, times_hit in zip(targets, done.t_events, strict=True)
                if len(times_hit)
            ]
            for i, side in hits:
                mode[i] = side
            # all that slip stick together when the motion reverses
            if any(side == 0 for _, side in hits):
                mode = [0, 0, 0, 0]
            switched, begin = switched + len(hits), end
    assert switched >= 8
    compare(
        "gms", u, np.concatenate(rows), ["theta", "v", *(f"gms.F{i}" for i in range(1, 5))], 1e-6
    )


def test_a_run_of_leuven_agrees_with_stops_carried_along():
    """Classical Runge-Kutta in steps of 25 us; each element is a stop in z, cut to its limit, with
    no mode to switch.
    """
    n, parts = 600, 40
    u, h, forces, sigma1, exponent = volts(n), H / 40, [0.0] * 4, S1, 2.0
    theta = v = 0.0
    rows = [(0.0, 0.0, 0.0)]

    def rates(v, dz, torque):
        total = sum(min(max(f + k * dz, -w), w) for f, k, w in zip(forces, K, W, strict=True))
        rate = v - abs(v) * math.copysign((abs(total) / level(v)) ** exponent, total)
        return v, (torque - A2 * v - total - sigma1 * rate) / J, rate

    for volt in u:
        for _ in range(parts):
            a = rates(v, 0.0, B * volt)
            b = rates(v + h / 2 * a[1], h / 2 * a[2], B * volt)
            c = rates(v + h / 2 * b[1], h / 2 * b[2], B * volt)
            d = rates(v + h * c[1], h * c[2], B * volt)
            steps = [h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]) for i in range(3)]
            theta, v = theta + steps[0], v + steps[1]
            forces = [
                min(max(f + k * steps[2], -w), w) for f, k, w in zip(forces, K, W, strict=True)
            ]
        rows.append((theta, v, sum(forces)))
    expected, record = np.array(rows), ["theta", "v", *(f"leuven.F{i}" for i in range(1, 5))]
    found, _ = Native(servo("leuven")).run(H, {"u": u}, record)
    finer, _ = Native(servo("leuven"), {"solver.max_step": H / 2, "solver.tolerance": 2e-9}).run(
        H, {"u": u}, record
    )
    found, finer = (
        np.column_stack([each[:, :2], each[:, 2:].sum(axis=1)]) for each in (found, finer)
    )
    size = np.ptp(expected, axis=0)
    assert np.all(np.abs(found - expected) <= 1e-6 * size)
    assert np.all(np.abs(found - finer) <= 1e-6 * size)


def test_static_friction_slides_and_stops_as_radau_says_to_second_order():
    """Drawn against its friction and let go: J v' = T - a2 v - N(|v|) sgn v until it stops, located
    by an event.
    """

    def rates(t, x):
        return [x[1], (-A2 * x[1] - level(x[1])) / J]

    stop = rising(lambda t, x: -x[1])
    done = solve_ivp(
        rates, (0, 2), [0.0, 3.0], "Radau", events=stop, dense_output=True, rtol=1e-10, atol=1e-13
    )
    rest, where = done.t_events[0][0], done.y_events[0][0][0]
    times = H * np.arange(1001)
    expected = np.array([done.sol(t)[1] if t < rest else 0.0 for t in times])
    errors = []
    for step in (1e-3, 5e-4, 2.5e-4):
        native = Native(servo("stribeck_static"), {"v_start": 3.0, "solver.friction_step": step})
        record, _ = native.run(H, {"u": np.zeros(1000)}, ["theta", "v"])
        errors.append(np.max(np.abs(record[:, 1] - expected)))
        assert record[-1, 1] == 0.0
    assert record[-1, 0] == pytest.approx(where, rel=1e-6)
    assert errors[0] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.3)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.3)


def test_static_friction_is_coulomb_with_the_stribeck_effect():
    """Two ways to the same equation: Fc (1 + e exp(-(v/vs)^2)) as an effect on another law."""
    u, record = volts(1500), ["theta", "v", "F"]
    whole, _ = Native(servo("stribeck_static")).run(H, {"u": u}, record)
    program = servo_program("coulomb", encoder=False, effects=("stribeck",))
    parts, _ = Native(
        program, {"coulomb.Fc": FC, "stribeck.excess": FS / FC - 1, "stribeck.speed": VS}
    ).run(H, {"u": u}, record)
    np.testing.assert_allclose(whole, parts, rtol=0, atol=1e-11)


# -- derivatives by parameters ---------------------------------------------------------------------

FITTED = {
    "dahl": ("J", "dahl.sigma0", "dahl.Fc"),
    "elastoplastic": ("elastoplastic.share", "elastoplastic.Fs", "elastoplastic.sigma1"),
    "lugre_velocity_damping": ("lugre_velocity_damping.vd",),
    "gms": ("J", "gms.k1", "gms.C", "gms.Fs", "gms.alpha3"),
    "leuven": ("leuven.n", "leuven.k4", "leuven.W2"),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", list(FITTED))
def test_derivatives_are_those_of_the_motion_over_every_switch(name):
    """Exact derivatives of the steps against differences of whole runs, in which the switching
    instants move.
    """
    program, fine = (
        servo_program(name, encoder=False, sensitivities=FITTED[name]),
        {"solver.tolerance": 1e-10},
    )
    u, record, defaults = volts(800), ["theta", "v"], program.variants[0].system.parameters
    _, sens = Native(program, fine).run(H, {"u": u}, record, sensitivities=True)
    for k, parameter in enumerate(FITTED[name]):
        value = defaults[parameter].default
        ends = [
            Native(program, fine | {parameter: (1 + d) * value}).run(H, {"u": u}, record)[0]
            for d in (1e-4, -1e-4)
        ]
        difference = (ends[0] - ends[1]) / (2e-4 * value)
        assert np.all(
            np.abs(sens[:, :2, k] - difference) <= 1e-4 * np.max(np.abs(difference), axis=0)
        ), parameter


def started(law: str, **states: float) -> Native:
    """Return a servo with a law whose own states have given values."""
    program = servo_program(law)
    native = Native(program)
    values = native.values
    for name, value in states.items():
        values[program.index[f"{law}.{name}"]] = value
    values[program.index["v"]] = states["v"]
    native.write(values)
    return native


def test_elements_that_overshot_their_limit_slip_again_after_two_reversals():
    """Elements let go together are at their limits together, each past it by an overshoot that the
    tolerance allows.
    """
    limits = {
        f"F{i}": share * 0.0072 + 4e-10 for i, share in enumerate((0.1, 0.2, 0.3, 0.4), start=1)
    }
    rows, _ = started("gms", v=-1e-4, **limits).run(
        1e-3, {"u": np.full(20, 3.0)}, ["v", "gms.slip1", "gms.slip4"]
    )
    assert rows[-1, 0] > 0.1
    assert rows[-1, 1:].tolist() == [1, 1]
    # of a controlled servo
    states = {
        "v": 0.757608,
        "F1": 0.00079398,
        "F2": 0.00159624,
        "F3": 0.00109585,
        "F4": 0.000668428,
    }
    u = np.array([0.603, 0.3842, 1.027, 0.3509, 0.3397, 0.7043, 0.8012, 1.521, 0.5799])
    rows, _ = started("leuven", **states).run(1e-3, {"u": u}, ["v", "leuven.F1", "leuven.F2"])
    assert 0.74 < rows[-1, 0] < 0.77
    assert rows[-1, 1:] == pytest.approx([0.0008, 0.0016], rel=1e-6)
