"""Sampling, modes and communication steps: the same time stepping in C, in Python and around
CasADi's arithmetic.
"""

import math

import casadi as ca
import numpy as np
import pytest

from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.python import casadi_tables, python_tables
from bristle.model.runtime import Core
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.servo import servo_program

LOW, HIGH = 0.3, 0.7


class InPython:
    """`Core` with the face of `Native`."""

    def __init__(self, program, tables, **parameters):
        self.program, self.core = program, Core(tables)
        for name, value in parameters.items():
            self.core.v[program.index[name]] = value
        self.core.initialise(0.0)

    def write(self, name, value):
        self.core.v[self.program.index[name]] = value

    def read(self, name):
        return self.core.v[self.program.index[name]]

    def advance(self, h):
        self.core.advance(h)


class InC:
    def __init__(self, program, **parameters):
        self.program, self.native = program, Native(program, parameters)

    def write(self, name, value):
        values = self.native.values
        values[self.program.index[name]] = value
        self.native.write(values)

    def read(self, name):
        return float(self.native.values[self.program.index[name]])

    def advance(self, h):
        self.native.advance(h)


def machines(program, **parameters):
    """Return one instance a way of evaluation, all three started alike."""
    python = InPython(program, python_tables(program), **parameters)
    symbolic = InPython(program, casadi_tables(program), **parameters)
    return {"c": InC(program, **parameters), "python": python, "casadi": symbolic}


# -- modes -----------------------------------------------------------------------------------------


def thermostat():
    system = System("thermostat")
    x = system.state(State("x", "1", "temperature", initial=0.5))
    q = system.mode(State("q", "1", "heater", initial=1.0))
    system.rate("x", q - x)
    system.update("q", ca.if_else(x > HIGH, 0.0, ca.if_else(x < LOW, 1.0, q)))
    system.output(Variable("x", "1", "temperature"), x)
    system.output(Variable("q", "1", "heater"), q)
    return Program("Thermostat", [system])


def test_a_relay_switches_at_the_ends_of_internal_steps():
    h, found = 2e-3, {}
    for name, machine in machines(thermostat(), **{"solver.max_step": h}).items():
        rows = []
        for _ in range(200):
            machine.advance(10 * h)  # ten internal steps to a communication step
            rows.append((machine.read("x"), machine.read("q")))
        found[name] = np.array(rows)
    x, q, expected = 0.5, 1.0, []
    for k in range(2000):
        x = q + (x - q) * math.exp(-h)
        q = 0.0 if x > HIGH else 1.0 if x < LOW else q
        if k % 10 == 9:
            expected.append((x, q))
    expected = np.array(expected)
    assert np.sum(np.abs(np.diff(expected[:, 1]))) >= 4
    for rows in found.values():
        np.testing.assert_array_equal(rows[:, 1], expected[:, 1])
        np.testing.assert_allclose(rows[:, 0], expected[:, 0], rtol=0, atol=1e-7)
    np.testing.assert_array_equal(found["c"], found["python"])


STIFF, SLIP = 200.0, 1.5


def maxwell_slip():
    """One spring that slips at SLIP, pulled at a given speed: stick or slip is remembered in a
    mode.
    """
    system = System("element")
    v = system.input(Variable("v", "m/s", "speed"))
    f = system.state(State("f", "N", "spring force", scale=SLIP))
    slip = system.mode(State("slip", "1", "direction of slip, 0 while sticking"))
    system.rate("f", ca.if_else(slip == 0, STIFF * v, 0.0))
    caught = ca.if_else(ca.fabs(f) >= SLIP, ca.sign(f), 0.0)
    system.update("slip", ca.if_else(slip == 0, caught, ca.if_else(slip * v < 0, 0.0, slip)))
    system.output(Variable("force", "N", "force"), f)
    return Program("Element", [system])


def test_a_maxwell_slip_element_closes_its_hysteresis_loop():
    h, n = 1e-3, 400
    speed = np.where((np.arange(4 * n) // n) % 2 == 0, 0.1, -0.1)
    force, out = 0.0, []
    for k in range(4 * n):  # elastic-plastic in closed form
        force = min(max(force + STIFF * speed[k] * h, -SLIP), SLIP)
        out.append(force)
    step = STIFF * 0.1 * h  # what one internal step may add after the limit
    for machine in machines(maxwell_slip()).values():
        found = []
        for k in range(4 * n):
            machine.write("v", float(speed[k]))
            machine.advance(h)
            found.append(machine.read("force"))
        assert np.max(np.abs(np.array(found) - out)) <= 2.0 * step
        late = np.array(found[2 * n :])
        assert late.max() == pytest.approx(SLIP, abs=step)
        assert late.min() == pytest.approx(-SLIP, abs=step)


# -- sampling --------------------------------------------------------------------------------------


def delays():
    """An integrator with a two-sample delay of its input before it, and a sampler of its state
    behind it.
    """
    system = System("delays")
    u = system.input(Variable("u", "1", "input"))
    d1 = system.sampled(State("d1", "1", "one sample old"))
    d2 = system.sampled(State("d2", "1", "two samples old"))
    x = system.state(State("x", "1", "integral"))
    s = system.sampled(State("s", "1", "sample of the integral"), after=True)
    n = system.sampled(State("n", "1", "samples taken"), after=True)
    m = system.sampled(State("m", "1", "updates before an interval"))
    system.update("d1", u)
    system.update("d2", d1)
    system.update("m", m + 1)
    system.rate("x", d2)
    system.update("s", x)
    system.update("n", n + 1)
    for name, expression in {
        "delayed": d2,
        "integral": x,
        "sampled": s,
        "count_after": n,
        "count_before": m,
    }.items():
        system.output(Variable(name, "1", name), expression)
    return Program("Delays", [system])


def test_before_and_after_updates_meet_the_documented_instants():
    h = 1e-3
    u = np.random.default_rng(2).normal(size=50)
    for machine in machines(delays()).values():
        delayed, integral = [], 0.0
        for k in range(50):
            machine.write("u", float(u[k]))
            machine.advance(h)
            # on [k, k+1) the state is driven by the input of one step before: d1 takes u_k, d2 the
            # old d1 = u_(k-1)
            integral += h * (u[k - 1] if k >= 1 else 0.0)
            delayed.append(machine.read("delayed"))
            assert machine.read("integral") == pytest.approx(integral, abs=1e-15)
            # `after` sees the end of the interval
            assert machine.read("sampled") == machine.read("integral")
            assert machine.read("count_before") == machine.read("count_after") == k + 1
        np.testing.assert_array_equal(delayed[1:], u[:-1])


@pytest.mark.parametrize("parts", [2, 3, 5])
def test_samples_fall_on_their_grid_however_the_interval_is_cut(parts):
    program = delays()
    whole, cut = InC(program), InC(program)
    for k in range(200):
        for machine in (whole, cut):
            machine.write("u", math.sin(0.1 * k))
        whole.advance(1e-3)
        for part in range(parts):
            cut.advance(1e-3 / parts)
            if part < parts - 1:
                assert cut.read("count_after") == k  # no sample in the middle of the interval
        for name in ("delayed", "count_after", "count_before"):
            assert cut.read(name) == whole.read(name)
        assert cut.read("sampled") == pytest.approx(whole.read("sampled"), abs=1e-14)


@pytest.mark.parametrize("law", ["lugre", "coulomb", "modified"])
def test_a_servo_step_cut_in_two_gives_the_same_motion_and_the_same_counts(law):
    program = servo_program(law)
    u = 3.0 * np.sin(0.02 * np.arange(1500))
    names = ["theta", "v", "theta_enc", "v_enc"]
    whole, _ = Native(program).run(1e-3, {"u": u}, names)
    cut, _ = Native(program).run(5e-4, {"u": np.repeat(u, 2)}, names)
    cut = cut[::2]
    size = np.ptp(whole, axis=0)
    assert np.all(np.abs(cut - whole)[:, :2] <= 1e-7 * size[:2])
    grid = 2 * math.pi / 40000
    off = np.abs(cut[:, 2] - whole[:, 2]) > 0.5 * grid
    assert np.mean(off) <= 0.002  # a count may flip where theta lies on the edge to 1e-7


def test_two_samples_in_one_step_equal_two_steps():
    program = servo_program("lugre")
    once, twice = InC(program), InC(program)
    for k in range(300):
        for machine in (once, twice):
            machine.write("u", 4.0 * math.sin(0.05 * k))
        once.advance(2e-3)
        twice.advance(1e-3)
        twice.advance(1e-3)
        np.testing.assert_allclose(once.native.values, twice.native.values, rtol=1e-12, atol=1e-15)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", ["c", "python"])
def test_no_sample_is_lost_or_late_in_half_an_hour(kind):
    """Adding 1 ms a million times drifts by more than an instant is wide; the clock must not."""
    system = System("counter")
    n = system.sampled(State("n", "1", "updates before"))
    m = system.sampled(State("m", "1", "updates after"), after=True)
    u = system.input(Variable("u", "1", "input"))
    last = system.sampled(State("last", "1", "input seen"))
    system.update("n", n + 1)
    system.update("m", m + 1)
    system.update("last", u)
    for name, expression in {"before": n, "after": m, "seen": last}.items():
        system.output(Variable(name, "1", name), expression)
    program, steps = Program("Counter", [system]), 1_800_000 if kind == "c" else 450_000
    k = np.arange(steps)
    if kind == "c":
        record, _ = Native(program).run(1e-3, {"u": k}, ["before", "after", "seen"])
        np.testing.assert_array_equal(record[1:, 0], k + 1)
        np.testing.assert_array_equal(record[1:, 1], k + 1)
        np.testing.assert_array_equal(record[1:, 2], k)
        return
    core = Core(python_tables(program))
    core.initialise(0.0)
    before, after, seen, into = (program.index[name] for name in ("before", "after", "seen", "u"))
    for i in range(steps):
        core.v[into] = float(i)
        core.advance(1e-3)
        assert core.v[before] == core.v[after] == i + 1
        assert core.v[seen] == i
    assert core.v[0] == pytest.approx(1e-3 * steps, abs=1e-7)


def test_a_late_start_keeps_the_grid():
    native = Native(delays())
    native.reset(time=12.3456)
    for _ in range(10):
        native.advance(1e-3)
    assert native.values[0] == pytest.approx(12.3556, abs=1e-12)
    assert native.values[delays().index["count_after"]] == 10


def test_parameters_reach_constants_and_calculated_values():
    system = System("constants")
    a = system.parameter(Parameter("a", "a", "1", 2.0, 0.0, 10.0, "factor", "dixit2008 eq. (7)"))
    first = system.constant({"square": a * a})
    second = system.constant({"fourth": first.square**2})
    system.calculate(Variable("public", "1", "fourth power"), second.fourth)
    system.input(Variable("u", "1", "input"))
    x = system.state(State("x", "1", "state", initial=second.fourth))
    system.rate("x", 0 * x)
    system.output(Variable("y", "1", "state"), x)
    for machine in machines(Program("Constants", [system]), a=3.0).values():
        assert machine.read("public") == 81.0
        assert machine.read("y") == 81.0
