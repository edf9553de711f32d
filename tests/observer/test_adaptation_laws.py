"""Kreisselmeier, Luders-Narendra, Marino, Martinez-Poznyak and mixing: identities, what they find,
and where they fail.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.loop import simulate
from bristle.model.basis import gaussian
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.variables import State
from bristle.observer import (
    bastin_gevers,
    besancon_position,
    drem,
    marino,
    martinez_poznyak,
    methods,
    observer_program,
)
from bristle.observer.method import Method, Update, observer, stack, unstack, vector_states
from bristle.plant.servo import servo_program

SX = ca.SX
STEP = 1e-3
COUNT = 2 * np.pi / 40000  # rad
STEP1 = ("alpha2", "b", "Fc")
STEP2 = ("sigma0", "sigma1", "sigma2", "c")
TRUE = {
    "alpha2": 2.0,
    "b": 6.5,
    "Fc": 4.0,
    "sigma0": 600.0,
    "sigma1": 800.0,
    "sigma2": 300.0,
    "c": 150.0,
}
LUGRE = {"lugre.sigma0": 0.8, "lugre.Fc": 0.004, "lugre.Fs": 0.0072, "lugre.vs": np.deg2rad(25.0)}
PLANTS = {
    "S": ("modified", {}),
    "L0": ("lugre", LUGRE | {"lugre.sigma1": 0.0}),
    "L1": ("lugre", LUGRE | {"lugre.sigma1": 0.02}),
}
NEW = (
    "drem",
    "drem_position",
    "kreisselmeier",
    "kreisselmeier_position",
    "luders_narendra",
    "luders_narendra_position",
    "marino",
    "martinez_poznyak",
    "martinez_poznyak_position",
    "two_step_drem",
    "two_step_martinez",
)


@cache
def record(name, seconds=100.0, order=1):
    """Return u, position, velocity and encoder of a plant under the reference controller, from
    rest.
    """
    law, parameters = PLANTS[name]
    servo = {"J": 0.001, "b": 0.0065, "a2": 0.002} | parameters
    plant = BusUnit("plant", Fmu(obtain("plant", law=law)), servo)
    controller = BusUnit(
        "controller", Fmu(obtain("controller")), {"seed": 7.0, "order": float(order)}
    )
    links = ((("controller", "u"), ("plant", "u")), (("plant", "v"), ("controller", "y_v")))
    taps = {"u": ("controller", "u"), "y_theta": ("plant", "theta"), "y_v": ("plant", "v")}
    trace = simulate(
        Bus((plant, controller), round(seconds / STEP), STEP, links, record=tuple(taps.values()))
    )
    assert trace.failure is None
    data = {name: np.ascontiguousarray(trace[port]) for name, port in taps.items()}
    return data | {"encoder": np.floor(data["y_theta"] / COUNT) * COUNT}


def known(method):
    """Give alpha2 and b to the methods that take them as known."""
    return {
        p.name: TRUE[p.symbol] for p in methods()[method].parameters if "known" in p.description
    }


def run(program, data, names, parameters=None, encoder=True):
    """Return estimates, row k for t_k, seen through the encoder."""
    seen = {
        "u": data["u"],
        "y_v": data["y_v"],
        "y_theta": data["encoder" if encoder else "y_theta"],
    }
    out, _ = Native(program, parameters).run(STEP, seen, [f"{name}_hat" for name in names])
    return out[1:]


def errors(method, data, names, parameters=None):
    """Return the error of each parameter over time in %."""
    estimates = run(observer_program(method), data, names, known(method) | (parameters or {}))
    return 100 * (estimates / [TRUE[name] for name in names] - 1)


def alone(name, reads, states, equations, parameters=()):
    """Return a method of the test as a program."""
    return Program(
        name, [observer(Method(name, "of a test", "none", reads, parameters, states, equations))]
    )


CASES = [  # limits of about twice what was measured
    ("luders_narendra", "S", STEP1, 0.05),
    ("luders_narendra", "L0", STEP1, 0.05),
    ("luders_narendra_position", "S", STEP1, 4.0),
    ("luders_narendra_position", "L0", STEP1, 4.0),
    ("kreisselmeier", "S", STEP1, 0.1),
    ("kreisselmeier", "L0", STEP1, 0.35),
    ("kreisselmeier_position", "S", STEP1, 0.25),
    ("kreisselmeier_position", "L0", STEP1, 0.25),
    ("marino", "S", STEP1, 7.0),
    ("marino", "L0", STEP1, 7.0),
    ("martinez_poznyak", "S", STEP2, 0.45),
    ("martinez_poznyak_position", "S", STEP2, 2.0),
    ("drem", "S", STEP2, 0.7),
    ("drem_position", "S", STEP2, 2.5),
    ("two_step_drem", "S", STEP1 + STEP2, 2.5),
    ("two_step_martinez", "S", STEP1 + STEP2, 2.0),
]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("method", "plant", "names", "limit"), CASES)
def test_method_finds_the_true_parameters(method, plant, names, limit):
    final = errors(method, record(plant), names)[-1]
    assert np.all(np.abs(final) < limit), dict(zip(names, final, strict=True))


DELAYED = ("kreisselmeier", "kreisselmeier_position")  # find a delay, so that nothing else is wrong


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ["rls", *DELAYED])
def test_a_shift_of_the_input_by_one_sample_is_found(method):
    data = record("S")
    for shift in (-1, 0, 1):
        shifted = data | {"u": np.roll(data["u"], shift)}
        final = run(observer_program(method), shifted, (*STEP1, "delay"))[-1]
        assert final[3] == pytest.approx(-shift, abs=0.1)
        assert np.max(np.abs(final[:3] / [TRUE[name] for name in STEP1] - 1)) < 0.005


FAST = [("kreisselmeier", STEP1, 25.0), ("martinez_poznyak", STEP2, 3.0), ("drem", STEP2, 5.0)]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("method", "names", "seconds"), FAST)
def test_fast_laws_settle_fast(method, names, seconds):
    late = errors(method, record("S"), names)[round(seconds / STEP) :]
    assert np.max(np.abs(late)) < 5.0


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("method", "names"),
    [
        (method, names)
        for method, plant, names, _ in CASES
        if plant == "S" and method not in DELAYED
    ],
)
def test_a_shift_of_the_input_by_one_sample_is_seen(method, names):
    data = record("S")
    shifted = data | {"u": np.concatenate([data["u"][1:], data["u"][-1:]])}
    right, wrong = (np.max(np.abs(errors(method, each, names)[-1])) for each in (data, shifted))
    assert wrong > 3 * right
    assert wrong > 1.5


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("method", "names", "seconds"),
    [
        ("kreisselmeier", STEP1, 15.0),
        ("kreisselmeier_position", STEP1, 15.0),
        ("martinez_poznyak", STEP2, 1.0),
        ("martinez_poznyak_position", STEP2, 20.0),
        ("drem", STEP2, 4.0),
        ("drem_position", STEP2, 20.0),
    ],
)
def test_a_record_may_begin_in_motion(method, names, seconds):
    data = record("S")
    fastest = 10000 + int(np.argmax(np.abs(data["y_v"][10000:20000])))
    rest = {name: values[fastest : fastest + 40000] for name, values in data.items()}
    assert abs(rest["y_v"][0]) > 5.0
    late = errors(method, rest, names)[round(seconds / STEP) :]
    assert np.max(np.abs(late)) < 5.0


# -- identities ------------------------------------------------------------------------------------


def test_marino_of_order_one_is_the_observer_of_bastin_and_gevers():
    def first_order(context, s):
        p = context.p
        gate = bastin_gevers.fast(s, 85.0 * bastin_gevers.DEGREE)
        c = marino.chain(1, SX(100.0), SX(1.0), s.period)
        x, theta = ca.if_else(p.gate > 0, p.x, s.y0), stack(p, "theta", 3)
        psi = s.period * bastin_gevers.regressor(s).T
        gamma = SX(ca.DM([400.0, 400.0, 800.0]))
        x_new, _, new = marino.advance(c, (x, SX(1, 3), theta), psi, s.y1, gamma)
        step = {
            "x": ca.if_else(gate, x_new, s.y1),
            "gate": gate,
            **unstack("theta", ca.if_else(gate, new, theta)),
        }
        return Update(
            step, dict(zip(STEP1, ca.vertsplit(theta), strict=True)), {"v": p.x}, first={"x": s.y1}
        )

    states = (
        State("x", "1", "x"),
        State("gate", "1", "gate"),
        *vector_states("theta", "1", "estimate", 3),
    )
    data, names = record("S"), (*STEP1, "v")
    ours = run(alone("first_order", "y_v", states, first_order), data, names)
    theirs = run(
        observer_program("bastin_gevers"),
        data,
        names,
        {"bastin_gevers.vc": 85.0 * bastin_gevers.DEGREE},
    )
    assert np.ptp(theirs[:, 0]) > 1.0
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


def analytic(period, end=1.0):
    """Return t, u in the middle of samples, position and velocity of a motion well above the
    gate.
    """
    t = np.arange(0, end + 1.5 * period, period)
    u = np.cos(2 * (t + period / 2))
    return t, u, 4 * t - 0.2 * np.cos(3 * t), 4 + 0.6 * np.sin(3 * t)


def test_marino_of_order_two_tends_to_the_printed_observer_of_bastin_and_gevers():
    lam, zero, gamma, v0 = 20.0, 30.0, np.array([3e5, 2e5, 4e5]), 3.0

    def printed(t, s):  # (3) for x1 = q, x2 = v + alpha2 q - zero q: k = 1, F = -zero
        (x1, x2), v, theta = s[:2], s[2:5], s[5:]
        q, u = 4 * t - 0.2 * np.cos(3 * t), np.cos(2 * t)
        first, others = np.array([-q, 0, 0]), np.array([zero * q, u, -1.0])
        phi, e = v + first, q - x1
        rate = gamma * phi * e
        dx1 = x2 + zero * q + first @ theta + lam * e
        dx2 = -zero * x2 - zero**2 * q + others @ theta + v @ rate
        return [dx1, dx2, *(-zero * v + others), *rate]

    def second_order(context, s):
        p = context.p
        c = marino.chain(2, SX(lam), SX(zero), s.period)
        psi = marino.driven((s.y0 + s.y1) / 2, s.u, SX(1), s.period)
        m = ca.vertcat(SX(1, 3), stack(p, "m", 1, 3))
        memory = stack(p, "x", 2), m, stack(p, "theta", 3)
        x, m, theta = marino.advance(c, memory, psi, s.y1, SX(ca.DM(gamma)))
        step = {**unstack("x", x), **unstack("m", m[1, :]), **unstack("theta", theta)}
        return Update(
            step,
            dict(zip(STEP1, ca.vertsplit(stack(p, "theta", 3)), strict=True)),
            first={"x0": s.y1, "x1": SX(v0)},
        )

    states = (
        *vector_states("x", "1", "x", 2),
        *vector_states("m", "1", "M", 3),
        *vector_states("theta", "1", "estimate", 3),
    )
    start = [-0.2, v0 + zero * 0.2, *np.zeros(6)]
    reference = solve_ivp(printed, (0, 1.0), start, rtol=1e-10, atol=1e-12).y[5:, -1]
    assert np.min(np.abs(reference)) > 0.5  # all three moved
    assert tends_to(reference, alone("second_order", "y_theta", states, second_order), {})


def tends_to(reference, program, parameters):
    """Whether the estimates at 1 s come closer to a differential equation's in proportion to the
    sampling period.
    """
    gaps = []
    for period in (1e-3, 2.5e-4):
        _, u, q, v = analytic(period)
        inputs = {"u": u, "y_theta": q, "y_v": v}
        out, _ = Native(program, parameters | {"sample_time": period}).run(
            period, inputs, [f"{name}_hat" for name in STEP1]
        )
        gaps.append(np.max(np.abs(out[-2] - reference) / np.max(np.abs(reference))))
    return gaps[0] < 0.03 and gaps[1] < 0.3 * gaps[0]


@pytest.mark.parametrize("law", ["luders_narendra", "kreisselmeier"])
def test_filtered_laws_tend_to_their_differential_equations(law):
    a, q, g, gamma = 30.0, 0.5, 4.0, np.array([20.0, 10.0, 15.0])

    def filters(t, f):
        v, dv, u = 4 + 0.6 * np.sin(3 * t), 1.8 * np.cos(3 * t), np.cos(2 * t)
        return a * (np.array([dv, -v, u, -1.0, 1.0, -2 * np.sin(2 * t)])[: len(f)] - f)

    def gradient(t, s):
        f, theta = s[:4], s[4:]
        return [*filters(t, f), *(gamma * f[1:] * (f[0] - f[1:] @ theta))]

    def integral(t, s):
        f, r, y, theta = s[:6], s[6:31].reshape(5, 5), s[31:36], s[36:]
        dr = -q * r + np.outer(f[1:], f[1:])
        return [*filters(t, f), *dr.ravel(), *(-q * y + f[1:] * f[0]), *(-g * (r @ theta - y))]

    parameters = {"cutoff": a, "vc": 1.0} | {
        "luders_narendra": {},
        "kreisselmeier": {"fading": q, "gain": g},
    }[law]
    if law == "luders_narendra":
        parameters |= {f"gamma{i}": x for i, x in enumerate(gamma, start=1)}
    rhs, order = {"luders_narendra": (gradient, 7), "kreisselmeier": (integral, 41)}[law]
    reference = solve_ivp(rhs, (0, 1.0), np.zeros(order), rtol=1e-10, atol=1e-12).y[:, -1]
    reference = reference[4:7] if law == "luders_narendra" else reference[36:39]
    assert tends_to(
        reference, observer_program(law), {f"{law}.{name}": x for name, x in parameters.items()}
    )


@pytest.mark.parametrize(
    ("method", "limit"), [("bastin_gevers", 0.5), ("luders_narendra", 0.5), ("marino", 100.0)]
)
def test_no_gain_is_too_large(method, limit):
    """Marino's reads an encoder here, whose noise a large gain lets through; it must not grow."""
    largest = {p.name: p.maximum for p in methods()[method].parameters if ".gamma" in p.name}
    assert np.max(np.abs(errors(method, record("S"), STEP1, largest)[-1])) < limit


def gain_of(poles, period):
    return np.array(ca.evalf(marino.innovation_gain([SX(p) for p in poles], SX(period)))).ravel()


@pytest.mark.parametrize(
    "poles", [(0.9,), (0.0, 0.8), (0.95, 0.8), (0.9, 0.7, 0.5), (0.2, 0.4, 0.6, 0.8)]
)
def test_innovation_gain_places_the_poles(poles):
    n, h = len(poles), 0.01
    phi = np.array(ca.evalf(marino.integrators(n, SX(h))))
    error = phi - np.outer(gain_of(poles, h), phi[0])
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(error).real), sorted(poles), atol=1e-9)


def test_innovation_gain_with_a_triple_pole_is_that_of_the_third_order_observer():
    lam, h = 85.0, STEP
    closed_form = np.array(ca.evalf(besancon_position.innovation_gain(SX(lam), SX(h)))).ravel()
    np.testing.assert_allclose(gain_of([np.exp(-lam * h)] * 3, h), closed_form, rtol=1e-6)


def test_mixing_gives_the_determinant_and_the_adjugate():
    random = np.random.default_rng(2)
    for n in (1, 2, 3, 4):
        a = random.standard_normal((n, n + 1))
        phi, y = a @ a.T, random.standard_normal(n)
        delta, mixed = (
            np.array(ca.evalf(x)).ravel() for x in drem.mix(SX(ca.DM(phi)), SX(ca.DM(y)))
        )
        assert delta[0] == pytest.approx(np.linalg.det(phi), rel=1e-9)
        np.testing.assert_allclose(mixed / delta, np.linalg.solve(phi, y), rtol=1e-8)
        singular = np.outer(y, y)
        assert np.all(
            np.isfinite(np.array(ca.evalf(drem.mix(SX(ca.DM(singular)), SX(ca.DM(y)))[1])))
        )


def test_drem_follows_the_solution_of_the_extended_equation():
    names = [*(f"drem.phi{i}" for i in range(15)), *(f"drem.y{i}" for i in range(5))]
    data = record("S")
    inputs = {"u": data["u"][:20000], "y_v": data["y_v"][:20000]}
    instance = Native(
        observer_program("drem"), known("drem") | {"drem.gain": 1e6, "drem.kappa": 1e-12}
    )
    out, _ = instance.run(STEP, inputs, [*names, *(f"{name}_hat" for name in STEP2)])
    lower, y, estimates = out[-1, :15], out[-1, 15:20], out[-1, 20:]
    phi = np.zeros((5, 5))
    phi[np.tril_indices(5)] = lower
    phi = phi + np.tril(phi, -1).T
    np.testing.assert_allclose(estimates, np.linalg.solve(phi, y)[:4], rtol=1e-6)


def test_the_regression_of_drem_is_exact_to_second_order_in_the_period():
    theta = SX(ca.DM([*(TRUE[name] for name in STEP2), 0.0]))

    def residual(context, s):
        p = context.p
        z, h, filters = drem.regression(
            p, drem.means(s, SX(TRUE["alpha2"]), SX(TRUE["b"]), gaussian), s.period
        )
        return Update(
            filters | {"z": z, "residual": z - ca.dot(h, theta)}, {"b": p.residual}, {"v": p.z}
        )

    states = (*drem.FILTER_STATES[:12], State("z", "1", "z"), State("residual", "1", "z - h theta"))
    program = alone("residual", "y_v", states, residual, drem.parameters("residual", 20.0)[:1])
    fine = 2.5e-4
    u = np.repeat(np.random.default_rng(4).standard_normal(1000).cumsum() * 0.3, 8)  # held for 2 ms
    servo = Native(
        servo_program("modified", encoder=False),
        {"b": 0.0065, "a2": 0.002, "J": 0.001, "solver.tolerance": 1e-11},
    )
    v = servo.run(fine, {"u": u}, ["v"])[0][:-1, 0]
    left = []
    for every in (4, 2, 1):
        inputs = {"u": u[::every], "y_v": v[::every]}
        out, _ = Native(program, {"sample_time": fine * every}).run(
            fine * every, inputs, ["b_hat", "v_hat"]
        )
        left.append(np.sqrt(np.mean(out[:, 0] ** 2) / np.mean(out[:, 1] ** 2)))
    assert left[0] < 0.02
    assert left[1] < 0.35 * left[0]
    assert left[2] < 0.35 * left[1]


def test_the_switching_correction_stops_at_zero_and_does_not_chatter():
    k, rho, h = 10.0, 100.0, STEP
    e = SX.sym("e")
    nu, slides = martinez_poznyak.switching(e, SX(k), SX(rho), SX(h))
    correct = ca.Function("correct", [e], [nu, slides])
    for start in np.concatenate([np.linspace(-0.3, 0.3, 61), [1e6, -1e6]]):
        correction, slid = (float(x) for x in correct(start))
        after = start - h * correction
        assert after * start >= -1e-18  # it never overshoots
        assert bool(slid) == (abs(start) * np.exp(-k * h) <= rho * h)
        if slid:
            assert abs(after) < 1e-15
        else:  # the differential equation, which keeps its sign
            exact = np.sign(start) * ((abs(start) + rho / k) * np.exp(-k * h) - rho / k)
            assert after == pytest.approx(exact, abs=k * h * rho * h)


# -- what the theory says fails --------------------------------------------------------------------


def test_marino_needs_the_wait_after_the_gate_opens():
    data = record("S")
    hurried = errors("marino", data, STEP1, {"marino.hold_off": 0.0})[-1]
    assert np.max(np.abs(hurried)) > 3 * np.max(np.abs(errors("marino", data, STEP1)[-1]))


def test_bristle_damping_drives_drem_to_its_bounds():
    """With sigma1 the true w enters v' through w + tau w', of which z = h' theta knows nothing."""
    estimates = run(observer_program("drem"), record("L1"), ("sigma0", "c"), known("drem"))
    assert np.all(estimates[-1] == 1.0)
    assert np.all(
        run(observer_program("drem"), record("L0"), ("sigma0", "c"), known("drem"))[-1] > 50.0
    )


@pytest.mark.sampled(4)
def test_an_error_of_b_hurts_mixing_most_and_the_switching_observer_least():
    data = record("S")
    laws = ("drem", "besancon", "martinez_poznyak")
    worst = {
        law: np.max(np.abs(errors(law, data, STEP2, {f"{law}.b": 1.01 * TRUE["b"]})[-1]))
        for law in laws
    }
    assert worst["drem"] > 1.5 * worst["besancon"] > 2 * worst["martinez_poznyak"]
    assert worst["drem"] > 25.0


# -- nothing but numbers comes out -----------------------------------------------------------------


def wild():
    """Yield inputs that no servo gives."""
    n, random = 4000, np.random.default_rng(5)
    yield {name: 1e6 * random.standard_normal(n) for name in ("u", "y_theta", "y_v")}
    yield {name: np.where(np.arange(n) % 2, 1e6, -1e6) for name in ("u", "y_theta", "y_v")}
    yield {"u": np.full(n, 24.0), "y_theta": 1e6 * np.arange(n) * STEP, "y_v": np.full(n, 1e6)}
    yield {name: np.zeros(n) for name in ("u", "y_theta", "y_v")}
    k = np.arange(n)
    yield {
        "u": np.zeros(n),
        "y_theta": np.where(k > n // 2, 1e6, 0.0),
        "y_v": np.where(k == n // 2, 1e6, 0.0),
    }


@pytest.mark.parametrize("method", [*NEW, "bastin_gevers", "rls"])
def test_wild_inputs_leave_finite_estimates(method):
    names = [f"{name}_hat" for name in (*STEP1, *STEP2, "v")]
    instance = Native(observer_program(method))
    out, _ = instance.run(STEP, {name: np.zeros(2) for name in ("u", "y_theta", "y_v")}, names)
    published = [name for name, value in zip(names, out[-1], strict=True) if np.isfinite(value)]
    for inputs in wild():
        instance.reset()
        assert np.all(np.isfinite(instance.run(STEP, inputs, [*published, "convergence"])[0]))


@pytest.mark.parametrize(
    ("method", "names"), [("drem", STEP2), ("martinez_poznyak", STEP2), ("kreisselmeier", STEP1)]
)
@pytest.mark.parametrize("fading", [0.02, 50.0])
def test_a_long_rest_moves_nothing(method, names, fading):
    data = record("S")
    rest = 60000
    inputs = {
        "u": np.r_[data["u"][:20000], np.zeros(rest)],
        "y_v": np.r_[data["y_v"][:20000], np.zeros(rest)],
    }
    instance = Native(observer_program(method), known(method) | {f"{method}.fading": fading})
    out, _ = instance.run(STEP, inputs, [f"{name}_hat" for name in names])
    assert np.all(np.isfinite(out))
    np.testing.assert_allclose(out[-1], out[25000], rtol=0.02)


def test_least_squares_at_constant_speed_do_not_run_away():
    """What is not excited is forgotten, and its covariance grows, but not without end."""
    n = 20000
    inputs = {"u": np.ones(n), "y_theta": 3.0 * np.arange(n) * STEP}
    out, _ = Native(observer_program("rls"), {"rls.memory": 0.01}).run(
        STEP, inputs, [f"{name}_hat" for name in STEP1]
    )
    assert np.all(np.isfinite(out))
    assert np.max(np.abs(out[-1])) < 1e3
