"""The Rosenbrock step by itself: order, stiff decay, time dependence, the closed form of the
bristle at constant speed.
"""

import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bristle.common.errors import SimulationError
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.friction import law

# a state of this size makes every error acceptable: the step stays as long as it is
UNCONTROLLED = 1e12


def one_state(name, rate, start=1.0, scale=UNCONTROLLED, parameters=()):
    system = System(name)
    symbols = [system.parameter(p) for p in parameters]
    system.input(Variable("pace", "1", "only counts the steps"))
    x = system.state(State("x", "1", "state", initial=start, scale=scale))
    system.rate("x", rate(x, system.time, *symbols))
    system.output(Variable("y", "1", "state"), x)
    return Program(name, [system])


def end_value(program, seconds, h, **parameters):
    native = Native(program, {"solver.max_step": h} | parameters)
    native.advance(seconds)
    assert native.steps == round(seconds / h)
    return native.values[program.index["y"]]


def observed_order(program, exact, seconds=1.0):
    steps = [seconds / 2**k for k in range(4, 9)]
    errors = [abs(end_value(program, seconds, h) - exact) for h in steps]
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def test_order_four_on_a_logistic_equation():
    program = one_state("logistic", lambda x, t: 2.0 * x * (1.0 - x), start=0.1)
    assert observed_order(program, 1.0 / (1.0 + 9.0 * math.exp(-2.0))) == pytest.approx(
        4.0, abs=0.35
    )


def test_order_four_on_a_pendulum():
    system = System("pendulum")
    a = system.state(State("a", "rad", "angle", initial=1.5, scale=UNCONTROLLED))
    r = system.state(State("r", "rad/s", "rate", scale=UNCONTROLLED))
    system.rate("a", r)
    system.rate("r", -ca.sin(a))
    system.output(Variable("y", "rad", "angle"), a)
    program = Program("Pendulum", [system])
    exact = solve_ivp(
        lambda t, s: [s[1], -math.sin(s[0])], (0, 2), [1.5, 0.0], "DOP853", rtol=1e-13, atol=1e-13
    ).y[0, -1]
    assert observed_order(program, exact, 2.0) == pytest.approx(4.0, abs=0.35)


def test_order_four_where_the_right_hand_side_depends_on_time():
    program = one_state("driven", lambda x, t: -x * x * (1.0 + ca.cos(3.0 * t)), start=1.0)
    assert observed_order(program, 1.0 / (2.0 + math.sin(3.0) / 3.0)) == pytest.approx(
        4.0, abs=0.35
    )


def test_a_stiff_transient_is_damped_in_one_step():
    rate = Parameter(
        "rate", "L", "1/s", 1e9, 0.0, 1e12, "relaxation rate", "hairer1996 section IV.3"
    )
    program = one_state("stiff", lambda x, t, k: -k * (x - 1.0), start=2.0, parameters=(rate,))
    # h L = 1e6; a Gauss or trapezoidal step would leave -1
    assert abs(end_value(program, 1e-3, 1e-3) - 1.0) < 1e-5
    # and along a slow solution it stays on it
    moving = one_state("tracking", lambda x, t: -1e6 * (x - ca.sin(t)) + ca.cos(t), start=0.0)
    assert end_value(moving, 1.0, 1e-2) == pytest.approx(math.sin(1.0), abs=1e-8)


def test_error_control_meets_the_tolerance():
    program = one_state("decay", lambda x, t: -50.0 * x, scale=1.0)
    errors, steps = [], []
    for tolerance in (1e-4, 1e-6, 1e-8, 1e-10):
        native = Native(program, {"solver.max_step": 0.1, "solver.tolerance": tolerance})
        native.advance(0.1)
        errors.append(abs(native.values[program.index["y"]] - math.exp(-5.0)))
        steps.append(native.steps)
    assert all(e < 10 * t for e, t in zip(errors, (1e-4, 1e-6, 1e-8, 1e-10), strict=True))
    assert steps == sorted(steps)
    assert steps[-1] > 20 * steps[0]


def test_the_cap_on_internal_steps_is_an_error_with_its_time():
    program = one_state("decay", lambda x, t: -50.0 * x, scale=1.0)
    native = Native(program, {"solver.max_step": 1e-4, "solver.max_steps": 10.0})
    with pytest.raises(
        SimulationError, match=r"more internal steps than solver\.max_steps"
    ) as caught:
        native.advance(0.1)
    assert caught.value.time == 0.0


def test_finite_escape_ends_with_an_error_and_not_with_numbers():
    program = one_state("escape", lambda x, t: x * x, scale=1.0)  # x = 1/(1 - t)
    native = Native(program, {"solver.max_step": 1e-2})
    with pytest.raises(SimulationError) as caught:
        native.run(1e-2, {"pace": np.zeros(200)}, [])
    assert caught.value.time == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("h", [0.0, -1e-3, math.nan, math.inf])
def test_a_step_that_is_no_step_is_refused(h):
    native = Native(one_state("decay", lambda x, t: -x, scale=1.0))
    with pytest.raises(SimulationError, match="greater than 0"):
        native.advance(h)


# -- the bristle at constant velocity --------------------------------------------------------------


def bristle_at_speed(name):
    """Return a program in which the law sees a given velocity: its states alone, and its force."""
    system, which = System("bristle"), law(name)
    system.parameter(Parameter("J", "J", "kg.m2", 0.001, 1e-9, 1e6, "inertia", "dixit2008 eq. (7)"))
    for parameter in which.parameters:
        system.parameter(parameter)
    v = system.input(Variable("v", "rad/s", "velocity"))
    for state in which.states:
        system.state(
            State(
                state.name,
                state.unit,
                state.description,
                scale=state.scale(system.namespace(f"{name}.")),
            )
        )
    friction = which.equations(system.namespace(f"{name}."), v)
    for state, rate in friction.rates.items():
        system.rate(state, rate)
    system.output(Variable("force", "N.m", "friction"), friction.force)
    return Program("Bristle", [system])


@pytest.mark.parametrize("v", [1e-3, 0.3, -0.3, 5.0, -200.0])
def test_lugre_relaxes_exponentially_at_constant_speed(v):
    program = bristle_at_speed("lugre")
    s0, s1, fc, fs, vs = 0.8, 0.013, 0.004, 0.0072, 0.4363323129985824
    native = Native(program, {"lugre.sigma1": s1})
    n = 400
    record, _ = native.run(1e-3, {"v": np.full(n, v)}, ["bristle.z", "force"])
    g = fc + (fs - fc) * math.exp(-((v / vs) ** 2))
    decay = np.exp(-s0 * abs(v) / g * 1e-3 * np.arange(n + 1))
    np.testing.assert_allclose(
        record[:, 0], math.copysign(g / s0, v) * (1.0 - decay), rtol=0, atol=1e-7 * fs / s0
    )
    force = math.copysign(g, v) * (1.0 - decay) + s1 * v * decay
    np.testing.assert_allclose(record[1:, 1], force[1:], rtol=0, atol=1e-7 * (fs + s1 * abs(v)))


@pytest.mark.parametrize("v", [0.05, 0.4, -0.4, 30.0])
def test_modified_law_relaxes_exponentially_at_constant_speed(v):
    program, n = bristle_at_speed("modified"), 400
    record, _ = Native(program).run(1e-3, {"v": np.full(n, v)}, ["bristle.w"])
    deg = math.degrees(abs(v))
    k = 600.0 + 800.0 * math.exp(-((deg / 10) ** 2)) + 300.0 * math.exp(-(((deg - 20) / 20) ** 2))
    decay = np.exp(-150.0 * abs(v) * 1e-3 * np.arange(n + 1))
    np.testing.assert_allclose(
        record[:, 0], math.copysign(k / 150.0, v) * (1.0 - decay), rtol=0, atol=1e-6
    )
