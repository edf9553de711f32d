"""Model Exchange and directional derivatives of the smooth plants."""

import ctypes
import math

import numpy as np
import pytest
from fmpy import simulate_fmu

from bristle.fmus.build import program_of
from bristle.fmus.interface import Interface
from bristle.model.python import casadi_tables
from bristle.model.runtime import Core

SMOOTH = (
    "dahl",
    "elastoplastic",
    "lugre",
    "lugre_velocity_damping",
    "modified",
    "modified_parallel",
    "modified_polynomial",
    "viscous",
)


def rates(raw, handle, n):
    dx = (ctypes.c_double * n)()
    assert (
        raw.call(
            "GetDerivatives" if raw.fmi == 2 else "GetContinuousStateDerivatives", handle, dx, n
        )
        == 0
    ), raw.messages
    return list(dx)


def set_states(raw, handle, x):
    assert raw.call("SetContinuousStates", handle, (ctypes.c_double * len(x))(*x), len(x)) == 0, (
        raw.messages
    )


def exchange(raw):
    """Return an instance in continuous-time mode."""
    handle = raw.instantiate("me")
    assert handle, raw.messages
    assert raw.start(handle) == 0
    update(raw, handle)
    assert raw.call("EnterContinuousTimeMode", handle) == 0
    return handle


def update(raw, handle):
    block = (ctypes.c_double * 8)()
    if raw.fmi == 2:
        assert raw.call("NewDiscreteStates", handle, block) == 0
    else:
        assert (
            raw.call(
                "UpdateDiscreteStates", handle, *[ctypes.byref(block, 8 * k) for k in range(6)]
            )
            == 0
        )


@pytest.fixture(params=[(law, fmi) for law in SMOOTH for fmi in (2, 3)], ids=str)
def lean(request, built, Raw):
    """A library, the program behind it, and the numbers of states, inputs and outputs."""
    law, fmi = request.param
    return Raw(built("plant", law=law, fmi=fmi, encoder=False).info), Interface(
        program_of("plant", law, encoder=False)
    )


def point(interface):
    """A point in the thick of friction: moving, bristles bent."""
    states = [state.name for _, state in interface.rates]
    # a friction acceleration, or a deflection
    bent = [2.0 if ".w" in state else 0.002 for state in states[2:]]
    return dict(zip(states, [0.3, 0.25, *bent], strict=True))


def exact_jacobian(interface, x, inputs):
    """The Jacobian of the same program, computed by CasADi."""
    program = interface.program
    core = Core(casadi_tables(program))
    core.initialise(0.0)
    for name, value in {**x, **inputs}.items():
        core.v[program.index[name]] = value
    kernel = program.variants[0].kernels["jacobian"]
    out = [0.0] * kernel.blocks[0][0].numel_out()
    core.variant["jacobian"](core.v, 0.0, out)
    return np.array(out).reshape(-1, len(x) + len(inputs))


@pytest.mark.sampled(4)
def test_derivatives_are_the_jacobian(lean):
    """Columns of the directional derivative, in Model Exchange, against CasADi's Jacobian and
    finite differences.
    """
    raw, interface = lean
    x, inputs = point(interface), {"u": 2.0, "tau_load": 0.001, "load_scale": 1.2}
    unknowns = [der.name for der, _ in interface.rates] + [e.name for e in interface.of("output")]
    knowns = [*x, *inputs]
    handle = exchange(raw)
    set_states(raw, handle, list(x.values()))
    for name, value in inputs.items():
        assert raw.set(handle, name, value) == 0
    columns = [raw.derivative(handle, unknowns, [name], [1.0]) for name in knowns]
    assert all(status == 0 for status, _ in columns)
    jacobian = np.array([column for _, column in columns]).T
    exact = exact_jacobian(interface, x, inputs)
    np.testing.assert_allclose(jacobian, exact, rtol=1e-12, atol=1e-12 * np.abs(exact).max())
    np.testing.assert_allclose(
        jacobian,
        differences(raw, handle, interface, x, inputs),
        rtol=1e-5,
        atol=1e-6 * np.abs(exact).max(),
    )
    assert np.count_nonzero(exact) > 5
    seed = np.linspace(-1.0, 2.0, len(knowns))
    status, combined = raw.derivative(handle, unknowns, knowns, list(seed))
    assert status == 0
    np.testing.assert_allclose(
        combined, jacobian @ seed, rtol=1e-12, atol=1e-12 * np.abs(exact).max()
    )


def differences(raw, handle, interface, x, inputs):
    n, outputs = len(x), [e.name for e in interface.of("output")]

    def evaluate(values):
        set_states(raw, handle, values[:n])
        for name, value in zip(inputs, values[n:], strict=True):
            assert raw.set(handle, name, value) == 0
        return np.array(rates(raw, handle, n) + raw.get(handle, *outputs))

    base = [*x.values(), *inputs.values()]
    columns = []
    for k, value in enumerate(base):
        step = 1e-6 * max(abs(value), 1e-2)
        up, down = ([*base[:k], value + sign * step, *base[k + 1 :]] for sign in (1, -1))
        columns.append((evaluate(up) - evaluate(down)) / (2 * step))
    evaluate(base)
    return np.array(columns).T


def test_derivatives_in_co_simulation(lean):
    """At a communication point the same numbers; parameters and outputs are no knowns, inputs no
    unknowns.
    """
    raw, interface = lean
    handle = raw.running()
    for k in range(30):
        assert raw.set(handle, "u", 3.0) == 0
        assert raw.step(handle, 1e-3 * k, 1e-3) == 0
    states = [state.name for _, state in interface.rates]
    x = dict(zip(states, raw.get(handle, *states), strict=True))
    exact = exact_jacobian(interface, x, {"u": 3.0, "tau_load": 0.0, "load_scale": 1.0})
    status, column = raw.derivative(handle, ["F", "v"], ["load_scale"], [2.0])
    assert status == 0
    order = [der.name for der, _ in interface.rates] + [e.name for e in interface.of("output")]
    assert column == pytest.approx(
        [2.0 * exact[order.index(n), -1] for n in ("F", "v")], rel=1e-12, abs=1e-15
    )
    for unknowns, knowns, seed in (
        (["F"], ["J"], [1.0]),
        (["F"], ["v"], [1.0]),
        (["u"], ["u"], [1.0]),
        (["F"], ["u"], [math.nan]),
    ):
        assert raw.derivative(handle, unknowns, knowns, seed)[0] == 3
        assert len(raw.messages) == 1, raw.messages
        raw.messages.clear()


def test_misuse_of_model_exchange(lean):
    raw, interface = lean
    handle, n = exchange(raw), len(interface.rates)
    array = (ctypes.c_double * 8)()
    null = ctypes.c_void_p(None)
    derivatives = "GetDerivatives" if raw.fmi == 2 else "GetContinuousStateDerivatives"
    for name in (
        "GetContinuousStates",
        derivatives,
        "SetContinuousStates",
        "GetNominalsOfContinuousStates",
    ):
        for pointer, count in ((array, n + 1), (array, n - 1), (array, n + 2**32), (null, n)):
            assert raw.call(name, handle, pointer, count) == 3
    array[0] = math.nan
    assert raw.call("SetContinuousStates", handle, array, n) == 3
    assert raw.call("SetTime", handle, math.nan) == 3
    assert raw.step(handle, 0.0, 1e-3) == 3
    assert raw.set(handle, "J", 1.0) == 3
    assert raw.call("EnterContinuousTimeMode", handle) == 3
    assert raw.call("CompletedIntegratorStep", handle, True, null, null) == 3
    assert len(raw.messages) == 22  # one a refusal
    assert raw.call("EnterEventMode", handle) == 0
    assert raw.call("SetContinuousStates", handle, (ctypes.c_double * n)(), n) == 3
    update(raw, handle)
    assert raw.call("EnterContinuousTimeMode", handle) == 0
    assert (
        raw.call(
            "CompletedIntegratorStep", handle, True, ctypes.byref(array), ctypes.byref(array, 8)
        )
        == 0
    )
    assert raw.call("Terminate", handle) == 0
    assert raw.set(handle, "u", 1.0) == 3


def test_what_is_not_finite_is_refused(lean):
    """States so large that the equations overflow give an error, never infinities with status
    OK.
    """
    raw, interface = lean
    handle, n = exchange(raw), len(interface.rates)
    dx = (ctypes.c_double * n)()
    name = "GetDerivatives" if raw.fmi == 2 else "GetContinuousStateDerivatives"
    set_states(raw, handle, [0.0, 1e308, *[1e308] * (n - 2)] if n > 2 else [0.0, 1.7e308])
    assert raw.call(name, handle, dx, n) == 3
    value = (ctypes.c_double * 1)()
    get, count = ("GetReal", ()) if raw.fmi == 2 else ("GetFloat64", (1,))
    assert raw.call(get, handle, raw.references("F"), 1, value, *count) == 3 or math.isfinite(
        value[0]
    )
    set_states(raw, handle, list(point(interface).values()))
    assert raw.call(name, handle, dx, n) == 0


def test_values_follow_what_is_set(lean):
    """Outputs and derivatives are those of the states, inputs and time set last, whatever was asked
    before.
    """
    raw, interface = lean
    handle, n = exchange(raw), len(interface.rates)
    x = list(point(interface).values())
    set_states(raw, handle, x)
    assert raw.call("SetTime", handle, 2.5) == 0
    assert raw.get(handle, "theta", "v") == x[:2]
    assert raw.get(handle, *(state.name for _, state in interface.rates)) == x
    before = rates(raw, handle, n)
    assert raw.get(handle, *(der.name for der, _ in interface.rates)) == before
    assert raw.set(handle, "u", 1.0) == 0
    after = rates(raw, handle, n)
    assert after[1] - before[1] == pytest.approx(0.0065 / 0.001, rel=1e-9)
    nominals = (ctypes.c_double * n)()
    assert raw.call("GetNominalsOfContinuousStates", handle, nominals, n) == 0
    assert all(0.0 < value < math.inf for value in nominals)
    if raw.fmi == 3:
        count = ctypes.c_size_t()
        assert raw.call("GetNumberOfContinuousStates", handle, ctypes.byref(count)) == 0
        assert count.value == n
        assert raw.call("GetNumberOfEventIndicators", handle, ctypes.byref(count)) == 0
        assert count.value == 0


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("law", SMOOTH)
def test_model_exchange_is_close_to_co_simulation(built, law, fmi):
    """FMPy's CVode on our derivatives, against our own integrator, over a second with a
    reversal.
    """
    path = str(built("plant", law=law, fmi=fmi, encoder=False).path)
    signals = np.array(
        [(0.0, 5.0, 0.0, 1.0), (0.5, 5.0, 0.0, 1.0), (0.5, -5.0, 0.0, 1.0), (2.0, -5.0, 0.0, 1.0)],
        dtype=[("time", float), ("u", float), ("tau_load", float), ("load_scale", float)],
    )
    options = {
        "filename": path,
        "stop_time": 1.0,
        "output_interval": 1e-2,
        "input": signals,
        "output": ["theta", "v"],
    }
    ours = simulate_fmu(**options, fmi_type="CoSimulation", step_size=1e-3)
    theirs = simulate_fmu(**options, fmi_type="ModelExchange", relative_tolerance=1e-9)
    for name in ("theta", "v"):
        at = np.interp(theirs["time"], ours["time"], ours[name])
        kept = np.abs(theirs["time"] - 0.5) > 0.02  # where u jumps, the two hosts' samples differ
        assert np.ptp(ours[name]) > 0.1
        assert np.max(np.abs(at - theirs[name])[kept]) < 2e-3 * np.ptp(ours[name]), name
