"""Published experiments with the LuGre parameters of canudas1995 Table I (set T), mass and friction
in one system.

Each figure is either printed in the paper named or was computed from its settings with Radau at a
tight tolerance.
"""

import math

import casadi as ca
import numpy as np
import pytest

from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.python import python_tables
from bristle.model.runtime import Core
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.friction import law

TABLE_I = {
    "lugre.sigma0": 1e5,
    "lugre.sigma1": math.sqrt(1e5),
    "lugre.Fc": 1.0,
    "lugre.Fs": 1.5,
    "lugre.vs": 1e-3,
}
SIGMA2, MASS = 0.4, 1.0
FINE = {"solver.tolerance": 1e-9}


def table_i(force, integral=None):
    """Return a mass with our LuGre law under force(t, x, v, i); i' = integral(x) if given."""
    system, lugre = System("mass"), law("lugre")
    for parameter in (
        Parameter("J", "m", "kg", MASS, 1e-9, 1e6, "mass", "canudas1995 Table I"),
        *lugre.parameters,
    ):
        system.parameter(parameter)
    system.input(Variable("pace", "1", "only counts the steps"))
    x = system.state(State("x", "m", "position", scale=1e-3))
    v = system.state(State("v", "m/s", "velocity", scale=1e-2))
    z = system.state(State("z", "m", "deflection", scale=1e-5))
    i = 0
    if integral is not None:
        i = system.state(State("i", "m.s", "integral of the error"))
        system.rate("i", integral(x))
    friction = lugre.equations(system.namespace("lugre."), v)
    total = friction.force + SIGMA2 * v
    system.rate("x", v)
    system.rate("v", (force(system.time, x, v, i) - total) / MASS)
    system.rate("z", friction.rates["z"])
    for name, unit, expression in (
        ("X", "m", x),
        ("V", "m/s", v),
        ("Z", "m", z),
        ("F", "N", total),
    ):
        system.output(Variable(name, unit, name), expression)
    return Program("TableI", [system])


def run(program, h, n):
    record, _ = Native(program, TABLE_I | FINE).run(
        h, {"pace": np.zeros(n)}, ["time", "X", "V", "F"]
    )
    return record.T


def upward(t, y, level):
    """Return the interpolated times at which y rises through a level."""
    k = np.nonzero((y[:-1] < level) & (y[1:] >= level))[0]
    return t[k] + (level - y[k]) / (y[k + 1] - y[k]) * (t[k + 1] - t[k])


def test_linearised_stick_mode():
    """Source: do2007: with K = 2 N/m about rest; in time scaled by sqrt(K/M) the pair is -111.94 +-
    193.57i.
    """
    program = table_i(lambda t, x, v, i: 2.0 * (0.0 - x))
    core = Core(python_tables(program))
    for name, value in TABLE_I.items():
        core.v[program.index[name]] = value
    core.initialise(0.0)
    columns = 4  # x, v, z and the input
    jacobian = [0.0] * (3 + 4) * columns
    core.variant["jacobian"](core.v, 0.0, jacobian)
    a = np.array(jacobian).reshape(-1, columns)[:3, :3]
    pole = max(np.linalg.eigvals(a), key=lambda p: p.imag)
    assert pole.real == pytest.approx(-158.31, abs=0.005)
    assert pole.imag == pytest.approx(273.75, abs=0.005)
    assert -pole.real / abs(pole) == pytest.approx(0.5006, abs=5e-5)
    assert pole / math.sqrt(2.0) == pytest.approx(-111.94 + 193.57j, abs=0.01)
    assert min(abs(np.linalg.eigvals(a))) == pytest.approx(0.0, abs=1e-3)


def test_stick_slip():
    """Source: canudas1995 Fig. 6: k = 2 N/m pulled at 0.1 m/s."""
    t, _, v, _ = run(table_i(lambda t, x, v, i: 2.0 * (0.1 * t - x)), 1e-3, 28_000)
    slips = upward(t, v, 0.01)
    assert len(slips) == 4
    assert slips[0] == pytest.approx(7.457, abs=0.002)
    np.testing.assert_allclose(np.diff(slips), 6.363, atol=0.001)
    assert np.max(v) == pytest.approx(0.3698, abs=1e-4)


def test_presliding_displacement():
    """Source: canudas1995 Fig. 2: force raised to 0.95 Fs at 0.1425 N/s."""
    _, x, _, _ = run(table_i(lambda t, x, v, i: 0.1425 * t), 1e-3, 10_000)
    assert x[-1] * 1e6 == pytest.approx(44.86, abs=0.01)
    # the limit v -> 0
    assert x[-1] * 1e6 == pytest.approx(1.5 / 1e5 * math.log(20.0) * 1e6, rel=0.003)


@pytest.mark.parametrize(
    ("rate", "expected"), [(1.0, 1.432), (5.0, 1.313), (10.0, 1.220), (20.0, 1.098)]
)
def test_break_away_force_falls_with_the_force_rate(rate, expected):
    """Source: canudas1995 Fig. 4: the largest friction before v reaches vs."""
    _, _, v, force = run(table_i(lambda t, x, v, i: rate * t), 1e-4, int(1.6 / rate / 1e-4))
    assert np.max(force[: np.argmax(v >= 1e-3) + 1]) == pytest.approx(expected, abs=0.001)


def test_pid_hunting():
    """Source: canudas1995 Fig. 8: Kp 3, Ki 4, Kv 6, set point 1 m."""
    program = table_i(
        lambda t, x, v, i: 3.0 * (1.0 - x) + 4.0 * i - 6.0 * v, integral=lambda x: 1.0 - x
    )
    t, x, _, _ = run(program, 2e-3, 75_000)
    late = t > 60.0
    assert (np.max(x[late]) - np.min(x[late])) / 2 == pytest.approx(0.0639, abs=2e-4)
    crossings = upward(t[late], x[late], 1.0)
    assert len(crossings) >= 3
    np.testing.assert_allclose(np.diff(crossings), 24.44, atol=0.02)


def test_drift_under_a_vibrating_load():
    """LuGre's known flaw: 0.6 + 0.3 sin(20 t) N stays below Fs and yet the mass creeps.

    Source: dupont2002, the experiment; 6.08 um a cycle in closed form for slow motion.
    """
    h = 2 * math.pi / 20 / 1000
    _, x, _, _ = run(table_i(lambda t, x, v, i: 0.6 + 0.3 * ca.sin(20.0 * t)), h, 20_000)
    per_cycle = np.diff(x[::1000])[5:] * 1e6
    np.testing.assert_allclose(per_cycle, 6.152, atol=0.01)
    # quasi-static: per radian of travel dz = 1 - z/z_s up and 1 + z/z_s down, z from .3 to .9 of
    # 1e-5 m, z_s = Fs/s0
    zs, low, high = 1.5e-5, 0.3e-5, 0.9e-5
    up, down = zs * math.log((zs - low) / (zs - high)), zs * math.log((zs + high) / (zs + low))
    assert (up - down) * 1e6 == pytest.approx(6.08, abs=0.01)
    assert per_cycle[-1] == pytest.approx((up - down) * 1e6, rel=0.02)
