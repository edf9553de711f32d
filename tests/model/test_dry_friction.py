"""The proximal step: exact sticking, exact stops, break-away, second order against event-located
solutions.
"""

import math
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

from bristle.common.errors import BristleError
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.python import python_tables
from bristle.model.runtime import Core
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.servo import servo_program

J, B, A2, FC = 0.001, 0.0065, 0.002, 0.004  # the defaults of the servo and of the law


@pytest.fixture(scope="module")
def coulomb():
    return servo_program("coulomb")


@pytest.mark.parametrize("tau_load", [0.0, 0.003, -0.0035])
@pytest.mark.parametrize("share", [0.999, -0.999, 0.5, 0.0])
def test_below_the_bound_nothing_moves_by_a_single_bit(coulomb, share, tau_load):
    u = (share * FC - tau_load) / B  # drive and load together are `share` of the bound
    native = Native(coulomb, {"theta_start": 0.123456789})
    inputs = {"u": np.full(5000, u), "tau_load": np.full(5000, tau_load)}
    record, _ = native.run(1e-3, inputs, ["theta", "v", "F"])
    assert np.all(record[:, 0] == 0.123456789)
    assert np.all(record[:, 1] == 0.0)
    assert record[-1, 2] == pytest.approx(share * FC, abs=1e-15)  # friction balances the torque


def test_sticking_is_exact_in_python_too(coulomb):
    core = Core(python_tables(coulomb))
    core.v[coulomb.index["theta_start"]] = 0.3
    core.initialise(0.0)
    core.v[coulomb.index["u"]] = 0.99 * FC / B
    for _ in range(500):
        core.advance(1e-3)
        assert core.v[coulomb.index["theta"]] == 0.3
        assert core.v[coulomb.index["v"]] == 0.0


@pytest.mark.parametrize("v0", [3.0, -3.0])
def test_a_free_run_stops_exactly_and_in_time(coulomb, v0):
    native = Native(coulomb, {"v_start": v0})
    record, _ = native.run(1e-3, {"u": np.zeros(3000)}, ["theta", "v"])
    stop = J / A2 * math.log(1.0 + abs(v0) * A2 / FC)  # J v' = -a2 v - Fc
    distance = J / A2 * (abs(v0) - FC / A2 * math.log(1.0 + abs(v0) * A2 / FC))
    resting = int(np.argmax(record[:, 1] == 0.0))
    assert stop - 0.5e-3 < 1e-3 * resting < stop + 2e-3
    assert np.all(record[resting:, 1] == 0.0)
    assert np.all(record[resting:, 0] == record[resting, 0])
    assert abs(record[-1, 0]) == pytest.approx(distance, rel=5e-4)
    assert np.all(record[:resting, 1] * np.sign(v0) > 0.0)  # no overshoot through zero


def test_above_the_bound_it_breaks_away(coulomb):
    torque = 1.01 * FC
    record, _ = Native(coulomb).run(1e-3, {"u": np.full(2000, torque / B)}, ["v"])
    expected = (torque - FC) / A2 * (1.0 - np.exp(-A2 / J * 1e-3 * np.arange(2001)))
    assert record[1, 0] > 0.0
    assert np.max(np.abs(record[:, 0] - expected)) < 2e-4 * expected[-1]


def test_normal_load_scales_the_bound(coulomb):
    inputs = {
        "u": np.full(100, 1.5 * FC / B),
        "load_scale": np.where(np.arange(100) < 50, 2.0, 1.0),
    }
    v = Native(coulomb).run(1e-3, inputs, ["v"])[0][:, 0]
    assert np.all(v[:51] == 0.0)
    assert np.all(np.diff(v[51:]) > 0.0)


# -- references with located events ----------------------------------------------------------------


def held(torques, period):
    """Return v at the end of every period: J v' = T - a2 v - Fc Sgn v in closed form, zero
    crossings located exactly.
    """
    v, out = 0.0, [0.0]
    for torque in torques:
        left = period
        while left > 0.0:
            if v == 0.0 and abs(torque) <= FC:
                break
            side = math.copysign(1.0, v if v != 0.0 else torque)
            goal = (torque - side * FC) / A2
            end = goal + (v - goal) * math.exp(-A2 / J * left)
            if end * side > 0.0:
                v = end
                break
            left -= J / A2 * math.log((v - goal) / -goal)  # time until v = 0
            v = 0.0
        out.append(v)
    return np.array(out)


def order(steps, errors):
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def test_second_order_against_held_torques_with_located_stops(coulomb):
    volts = np.random.default_rng(8).normal(0.0, 1.2, 4000)
    period = 0.013
    expected = held(volts * B, period)
    assert np.sum(expected == 0.0) > 100
    assert np.sum(expected < 0.0) > 50
    assert np.sum(expected > 0.0) > 50
    steps, errors = [period / (10 * 2**k) for k in range(7)], []
    for h in steps:
        native = Native(
            coulomb, {"solver.friction_step": h, "solver.max_step": period, "sample_time": period}
        )
        found = native.run(period, {"u": volts}, ["v"])[0][:, 0]
        errors.append(np.mean(np.abs(found - expected)))
    assert 1.9 <= order(steps, errors) <= 2.2
    for coarse, fine in pairwise(errors):
        assert 1.7 <= math.log2(coarse / fine) <= 2.4
    assert errors[-1] < 1e-7 * np.max(np.abs(expected))


# just above the bound: the mass sticks for a good part of every half period
AMPLITUDE, OMEGA = 0.005, 9.0


def forced(times):
    """Return v(t) of J v' = A sin(w t) - Fc Sgn v from rest: closed form between break-away and
    located stop.
    """
    breaking = math.asin(FC / AMPLITUDE) / OMEGA

    def speed(t):
        return (
            AMPLITUDE / OMEGA * (math.cos(OMEGA * breaking) - math.cos(OMEGA * t))
            - FC * (t - breaking)
        ) / J

    stop = brentq(speed, math.pi / 2 / OMEGA, math.pi / OMEGA + breaking, xtol=1e-15)
    assert stop < math.pi / OMEGA + breaking  # it comes to rest before it breaks away backwards
    half = math.pi / OMEGA
    values = []
    for t in times:
        phase = t % half
        sign = 1.0 if int(t / half) % 2 == 0 else -1.0
        values.append(sign * speed(phase) if breaking < phase < stop else 0.0)
    return np.array(values)


def shaker():
    system = System("shaker", "a mass on a rough table under a sinusoidal force")
    bound = system.parameter(
        Parameter("Fc", "Fc", "N", FC, 0.0, 1.0, "friction", "acary2008 section 1.3")
    )
    x = system.state(State("x", "m", "position"))
    v = system.state(State("v", "m/s", "velocity"))
    system.rate("x", v)
    system.rate("v", AMPLITUDE * ca.sin(OMEGA * system.time) / J)
    system.dry_friction("v", J, bound)
    system.output(Variable("position", "m", "position"), x)
    system.output(Variable("speed", "m/s", "velocity"), v)
    return Program("Shaker", [system])


def test_second_order_against_a_sinusoidal_force_with_located_stops():
    program, period = shaker(), 0.01
    expected = forced(period * np.arange(201))
    assert 20 < np.sum(expected == 0.0) < 180
    steps, errors = [period / (5 * 2**k) for k in range(7)], []
    for h in steps:
        native = Native(program, {"solver.friction_step": h, "solver.max_step": period})
        record = [native.values[program.index["speed"]]]
        for _ in range(200):
            native.advance(period)
            record.append(native.values[program.index["speed"]])
        errors.append(np.mean(np.abs(np.array(record) - expected)))
    assert 1.8 <= order(steps, errors) <= 2.2


def test_a_second_dry_row_is_refused():
    system = System("two")
    system.state(State("v", "rad/s", "velocity"))
    system.dry_friction("v", 1.0, 1.0)
    with pytest.raises(BristleError, match="already has a dry-friction row"):
        system.dry_friction("v", 1.0, 1.0)


def test_a_force_that_depends_on_time_is_taken_at_the_middle_of_the_step():
    """Without friction a ramp k t gives the integral exactly, as the trapezoidal rule should."""
    system = System("ramp")
    x = system.state(State("v", "m/s", "velocity"))
    system.rate("v", 3.0 * system.time)
    system.dry_friction("v", 1.0, 0.0)
    system.output(Variable("speed", "m/s", "velocity"), x)
    program, h, n = Program("Ramp", [system]), 1e-2, 50
    native = Native(program, {"solver.friction_step": h, "solver.max_step": 1.0})
    native.advance(n * h)
    assert native.values[program.index["speed"]] == pytest.approx(1.5 * (n * h) ** 2, rel=1e-12)


def test_a_rate_too_fast_for_the_step_dies_out_instead_of_ringing():
    system = System("fast")
    fast = system.state(State("fast", "1", "a fast lag"))
    v = system.state(State("v", "m/s", "velocity", initial=1.0))
    system.rate("fast", 1e5 * (v - fast))
    system.rate("v", 0.0 * fast)
    system.dry_friction("v", 1.0, 0.0)
    system.output(Variable("lagged", "m/s", "the lag"), fast)
    native = Native(Program("Fast", [system]), {"solver.friction_step": 1e-3})
    found = []
    for _ in range(5):
        native.advance(1e-3)
        found.append(native.values[native.program.index["lagged"]])
    assert np.abs(np.array(found) - 1.0).max() < 0.02
