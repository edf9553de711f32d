"""States of Model Exchange set like any variable, in event and continuous-time mode: CasADi's
DaeBuilder does so.
"""

import ctypes
import math

import casadi as ca
import numpy as np
import pytest

from bristle.fmus.build import program_of
from bristle.model.native import Native
from bristle.model.python import casadi_tables
from bristle.model.runtime import Core

H = 1e-3
LAWS = ["lugre", "modified"]


def equations(law):
    """Return x, u -> (rates, outputs) by our own Python core."""
    program = program_of("plant", law, encoder=False)
    [variant] = program.variants
    core = Core(casadi_tables(program))
    core.initialise(0.0)

    def evaluate(x, u):
        for place, value in zip(variant.states, x, strict=True):
            core.v[place] = value
        for name, value in zip(variant.system.inputs, u, strict=True):
            core.v[program.index[name]] = value
        core.outputs()
        return [core.v[p] for p in variant.ders], [
            core.v[program.index[name]] for name in variant.system.outputs
        ]

    return evaluate


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("law", LAWS)
def test_dae_builder_evaluates_our_equations(built, law, fmi):
    """Rates and outputs to the last digit, and their derivatives, at points in and out of
    sliding.
    """
    dae = ca.DaeBuilder(law, str(built("plant", law=law, fmi=fmi, encoder=False).path))
    f, ours = dae.create("f", ["x", "u"], ["ode", "y"]), equations(law)
    jacobian = dae.create("j", ["x", "u"], ["jac_ode_x", "jac_ode_u"])
    for x, u in (([0.3, 0.25, 0.002], [1.0, 0.0, 1.0]), ([-0.1, -2.0, -0.01], [-5.0, 0.002, 1.3])):
        found = [np.array(each).ravel().tolist() for each in f(x, u)]
        assert found == [list(each) for each in ours(x, u)]
        step = 1e-6
        for k, column in enumerate(np.array(ca.horzcat(*jacobian(x, u))).T):
            up, down = ([*x, *u] for _ in range(2))
            up[k], down[k] = up[k] + step, down[k] - step
            slope = (np.array(ours(up[:3], up[3:])[0]) - np.array(ours(down[:3], down[3:])[0])) / (
                2 * step
            )
            np.testing.assert_allclose(
                column, slope, rtol=1e-5, atol=1e-6 * max(1.0, np.abs(slope).max())
            )


@pytest.mark.parametrize("fmi", [2, 3])
def test_dae_builder_simulates_like_our_integrator(built, fmi):
    """CVODES over the FMU's rates, 50 ms under a constant voltage, against our steps of 1 ms."""
    dae = ca.DaeBuilder("lugre", str(built("plant", law="lugre", fmi=fmi, encoder=False).path))
    grid = H * np.arange(10, 60, 10)
    options = {"abstol": 1e-12, "reltol": 1e-10}
    x, voltage = ca.MX.sym("x", 3), ca.MX.sym("u", 3)
    rates = dae.create("f", ["x", "u"], ["ode"])(x, voltage)
    solve = ca.integrator(
        "solve", "cvodes", {"x": x, "u": voltage, "ode": rates}, 0.0, grid, options
    )
    u = np.array([[6.0], [0.0], [1.0]])
    theirs = np.array(solve(x0=[0.0, 0.0, 0.0], u=np.tile(u, len(grid)))["xf"])[:2].T
    native = Native(program_of("plant", "lugre", encoder=False), {"solver.tolerance": 1e-10})
    ours, _ = native.run(H, {"u": np.full(50, 6.0)}, ["theta", "v"])
    assert np.ptp(ours[:, 1]) > 0.1
    np.testing.assert_allclose(theirs, ours[10::10], rtol=1e-6)


# -- the calls behind it ---------------------------------------------------------------------------


def events_done(raw, handle):
    block = (ctypes.c_double * 8)()
    pointers = [block] if raw.fmi == 2 else [ctypes.byref(block, 8 * k) for k in range(6)]
    return raw.call(
        "NewDiscreteStates" if raw.fmi == 2 else "UpdateDiscreteStates", handle, *pointers
    )


def seen(raw, handle):
    """Return states, rates and friction torque."""
    x, dx = (ctypes.c_double * 3)(), (ctypes.c_double * 3)()
    assert raw.call("GetContinuousStates", handle, x, 3) == 0
    assert (
        raw.call(
            "GetDerivatives" if raw.fmi == 2 else "GetContinuousStateDerivatives", handle, dx, 3
        )
        == 0
    )
    return [*x, *dx, *raw.get(handle, "F")]


@pytest.mark.parametrize("fmi", [2, 3])
def test_states_are_set_one_by_one_in_event_and_continuous_time_mode(built, Raw, fmi):
    raw = Raw(built("plant", law="lugre", fmi=fmi, encoder=False).info)
    states = {"lugre.theta": 0.3, "lugre.v": 0.25, "lugre.z": 0.002}
    handle = raw.instantiate("me")
    assert raw.start(handle) == 0
    for name, value in states.items():
        assert raw.set(handle, name, value) == 0, raw.messages
    in_event_mode = raw.get(handle, *states, "F")
    assert events_done(raw, handle) == 0
    assert raw.call("EnterContinuousTimeMode", handle) == 0
    assert raw.call("SetContinuousStates", handle, (ctypes.c_double * 3)(), 3) == 0
    for name, value in states.items():
        assert raw.set(handle, name, value) == 0, raw.messages
    one_by_one = seen(raw, handle)
    assert raw.call("SetContinuousStates", handle, (ctypes.c_double * 3)(), 3) == 0
    assert seen(raw, handle) != one_by_one
    assert raw.call("SetContinuousStates", handle, (ctypes.c_double * 3)(*states.values()), 3) == 0
    assert seen(raw, handle) == one_by_one
    assert in_event_mode == [*states.values(), one_by_one[-1]]
    assert raw.messages == []
    for value in (math.nan, math.inf):
        assert raw.set(handle, "lugre.v", value) == 3
    assert raw.set(handle, "der(lugre.v)", 1.0) == 3
    assert len(raw.messages) == 3
    assert seen(raw, handle) == one_by_one


@pytest.mark.parametrize("fmi", [2, 3])
def test_states_are_not_set_elsewhere(built, Raw, fmi):
    """Neither before the simulation begins, where parameters give the start values, nor in
    Co-Simulation.
    """
    raw = Raw(built("plant", law="lugre", fmi=fmi, encoder=False).info)
    exchange = raw.instantiate("me")
    assert raw.set(exchange, "lugre.v", 1.0) == 3
    assert raw.enter(exchange) == 0
    assert raw.set(exchange, "lugre.v", 1.0) == 3
    assert raw.set(raw.running(), "lugre.v", 1.0) == 3
    assert len(raw.messages) == 3
