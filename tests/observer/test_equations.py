"""The discrete observers against independent computations: matrix exponentials, the printed ODE,
batch least squares.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from bristle.model.native import Native
from bristle.model.system import System
from bristle.observer import observer_program, zhang
from bristle.observer.method import EquationContext

PERIOD = 1e-3


def exact_filter(k0, lam):
    """Return phi, m0, m1 by quadrature of the matrix exponential: another way than the augmented
    matrix.
    """
    n = len(k0)
    a = np.diag(np.ones(n - 1), 1)
    a[:, 0] -= [lam ** (i + 1) * k for i, k in enumerate(k0)]
    nodes, weights = np.polynomial.legendre.leggauss(20)
    s = (nodes + 1) / 2
    kernels = [expm(a * PERIOD * (1 - x)) * PERIOD * w / 2 for x, w in zip(s, weights, strict=True)]
    m0 = sum(k * (1 - x) for k, x in zip(kernels, s, strict=True))
    m1 = sum(k * x for k, x in zip(kernels, s, strict=True))
    return expm(a * PERIOD), m0, m1


@pytest.mark.parametrize(
    ("k0", "lam"), [((2.0, 1.0), 50.0), ((100.0, 1000.0), 50.0), ((3.0, 3.0, 1.0), 40.0)]
)
def test_filter_constants_are_the_exact_hold(k0, lam):
    system = System("filter")
    context = EquationContext(system, system.namespace())
    f = zhang.make_filter(context, ca.SX(ca.DM(list(k0))), ca.SX(lam), ca.SX(PERIOD))
    values = [system.expand(m) for m in (f.phi, f.m0, f.m1)]
    ours = [np.array(ca.evalf(value)) for value in values]
    for mine, reference in zip(ours, exact_filter(k0, lam), strict=True):
        np.testing.assert_allclose(mine, reference, rtol=1e-9, atol=1e-13 * np.abs(reference).max())


def gaussians(v):
    d = abs(v) * 180 / np.pi
    return np.exp(-((d / 10) ** 2)), np.exp(-(((d - 20) / 20) ** 2))


def printed_ode(gain, lam, k0, theta0, end):
    """Integrate (6) in Zhang's coordinates as it stands, on the signals v = 2 sin 3t + sin 7t, u =
    cos 2t.
    """
    k = np.array([lam * k0[0], lam**2 * k0[1]])
    a2, b = 2.0, 6.5

    def rhs(t, s):
        x, ups, theta = s[:2], s[2:10].reshape(2, 4), s[10:]
        v, u = 2 * np.sin(3 * t) + np.sin(7 * t), np.cos(2 * t)
        psi = -np.array([v, gaussians(v)[0] * v, gaussians(v)[1] * v, abs(v) * x[1]])
        e = v - x[0]
        dtheta = gain * ups[0] * e
        dx = np.array([x[1] - a2 * v + b * u, psi @ theta]) + k * e + ups @ dtheta
        dups = np.array([ups[1] - k[0] * ups[0], psi - k[1] * ups[0]])
        return [*dx, *dups.ravel(), *dtheta]

    return solve_ivp(
        rhs, (0, end), [*np.zeros(10), *theta0], rtol=1e-9, atol=1e-9, method="Radau"
    ).y[10:, -1]


def test_matrix_gain_observer_tends_to_the_printed_differential_equation():
    scales = np.array([1000.0, 1000.0, 1000.0, 100.0])
    reference = printed_ode(10.0 * scales**2, 50.0, (2.0, 1.0), (300.0, 300.0, 300.0, 100.0), 0.5)
    start = np.array([300.0, 300.0, 300.0, 100.0])
    errors = []
    for period in (4e-4, 1e-4):
        t = np.arange(0, 0.5 + 1.5 * period, period)
        data = {"u": np.cos(2 * (t + period / 2)), "y_v": 2 * np.sin(3 * t) + np.sin(7 * t)}
        parameters = {
            "besancon.alpha2": 2.0,
            "besancon.b": 6.5,
            "besancon.gain": 10.0,
            "besancon.averaging": 0.0,
        }
        parameters["besancon.c_load_scale"] = 0.0  # the printed observer knows of no load
        instance = Native(observer_program("besancon"), parameters | {"sample_time": period})
        out, _ = instance.run(period, data, ["sigma0_hat", "sigma1_hat", "sigma2_hat", "c_hat"])
        errors.append(np.max(np.abs(out[-2] - reference) / np.abs(reference - start)))
    assert errors[1] < 1e-3
    assert errors[1] < 0.3 * errors[0]  # first order in the sampling period


def test_recursive_least_squares_equals_the_batch_solution():
    random = np.random.default_rng(3)
    n, gain = 4000, 1 - np.exp(-150.0 * PERIOD)
    u = np.cumsum(random.standard_normal(n)) * 0.1 + 3.0
    v = np.empty(n)
    v[0] = 3.0
    for k in range(n - 1):  # exact solution of v' = -2 v + 6.5 u - 4 over a sample, while v > 0
        v[k + 1] = v[k] * np.exp(-2 * PERIOD) + (6.5 * u[k] - 4.0) / 2 * (1 - np.exp(-2 * PERIOD))
    # both directions, else load and friction are one
    u, v = np.concatenate([u, -0.9 * u]), np.concatenate([v, -0.9 * v])
    theta = np.cumsum(v) * PERIOD + 1e-4 * random.standard_normal(2 * n)
    parameters = {"rls.memory": 1e9, "rls.vc": np.deg2rad(85), "rls.hold_off": 0.0}
    names = ["alpha2_hat", "b_hat", "Fc_hat", "load_hat", "delay_hat"]
    out, _ = Native(observer_program("rls"), parameters).run(
        PERIOD, {"u": u, "y_theta": theta}, names
    )
    speed = np.diff(theta) / PERIOD
    rows = np.column_stack(
        [np.diff(speed) / PERIOD, -(speed[1:] + speed[:-1]) / 2, (u[1:-1] + u[:-2]) / 2]
    )
    for _ in range(2):
        filtered, state = np.empty_like(rows), np.zeros(3)
        for k, row in enumerate(rows):
            state = state + gain * (row - state)
            filtered[k] = state
        rows = filtered
    used = np.abs(rows[:, 1]) > np.deg2rad(85)
    rate = np.diff(rows[:, 2], prepend=0.0) / PERIOD
    regressors = np.column_stack(
        [rows[:, 1], rows[:, 2], np.sign(rows[:, 1]), np.ones(len(rows)), rate]
    )[used]
    batch = np.linalg.lstsq(regressors, rows[used, 0], rcond=None)[0]
    batch[4] /= -batch[1] * PERIOD
    np.testing.assert_allclose(out[-1], batch, rtol=1e-5, atol=1e-6)
