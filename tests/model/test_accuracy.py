"""The smooth plants against LSODA at 1e-12 restarted at every input change, and where explicit RK4
fails.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

LIMITS = np.array([1e-6, 1e-6, 1e-5])  # of the range of theta, v and the friction state
SETS = ("S", "R", "L0", "L1", "T")
SCENARIOS = ("reversals", "stick-slip", "saturated")
LENGTH = 6000


def relative_error(found, expected):
    return np.max(np.abs(found - expected), axis=0) / np.ptp(expected, axis=0)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("name", SETS)
def test_default_tolerance_meets_the_limits_with_margin(reference, closed_loop, name, scenario):
    plant, make = reference.REFERENCE_PLANTS[name], reference.scenarios(name, LENGTH)[scenario]
    expected, u = reference.solve(plant, make(), LENGTH)
    found, _ = closed_loop(plant, make(), LENGTH)
    assert np.all(relative_error(found, expected) <= LIMITS / 3)
    # the scenario shows what it claims to
    moving = expected[np.abs(expected[:, 1]) > 1e-3 * np.ptp(expected[:, 1]), 1]
    reversals = int(np.sum(np.diff(np.sign(moving)) != 0))
    if scenario == "reversals":
        assert reversals >= 10
    elif scenario == "saturated":
        assert np.mean(np.abs(u) > 24.0) > 0.2
        assert reversals >= 4
    else:
        stuck = np.abs(expected[1000:, 1]) < 0.05 * np.max(expected[:, 1])
        assert np.sum(np.diff(stuck.astype(int)) == 1) >= 3  # stops again and again


@pytest.mark.sampled(4)
def test_a_looser_tolerance_is_not_enough(reference, closed_loop):
    plant, make = reference.REFERENCE_PLANTS["T"], reference.scenarios("T", LENGTH)["stick-slip"]
    expected, _ = reference.solve(plant, make(), LENGTH)
    found, _ = closed_loop(plant, make(), LENGTH, tolerance=1e-4)
    assert np.any(relative_error(found, expected) > LIMITS)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", SETS)
def test_the_reference_agrees_with_radau(reference, name):
    plant, n = reference.REFERENCE_PLANTS[name], 60
    u = 20.0 * np.sign(np.sin(np.arange(n) / 8.0))
    expected, _ = reference.solve(plant, lambda k, _theta, _v: u[k], n)
    x = np.zeros(3)
    scale = np.ptp(expected, axis=0)
    for k in range(n):
        done = solve_ivp(
            plant.rhs,
            (0.0, 1e-3),
            x,
            "Radau",
            args=(plant.gain * u[k],),
            rtol=1e-10,
            atol=1e-12 * scale,
        )
        x = done.y[:, -1]
    assert np.all(np.abs(x - expected[-1]) <= 2e-8 * scale)


# -- explicit Runge-Kutta --------------------------------------------------------------------------


def end_speeds(reference, closed_loop, name, volts, seconds):
    n = round(seconds * 1000)
    plant = reference.REFERENCE_PLANTS[name]
    ours, _ = closed_loop(plant, lambda *_: volts, n)
    explicit = reference.rk4(plant, volts, seconds)
    tight, _ = reference.solve(plant, lambda *_: volts, n)
    return ours[-1, 1], explicit[1], tight[-1, 1]


@pytest.mark.parametrize(
    ("name", "volts", "seconds", "verdict"),
    [
        pytest.param("T", 5.0, 10.0, "wrong", marks=pytest.mark.slow),
        ("L1", 20.0, 5.0, "wrong"),
        ("L0", 18.0, 5.0, "overflow"),
        ("S", 6.0, 5.0, "right"),
    ],
)
def test_explicit_rk4_fails_where_the_bristle_is_stiff(
    reference, closed_loop, name, volts, seconds, verdict
):
    ours, explicit, tight = end_speeds(reference, closed_loop, name, volts, seconds)
    assert ours == pytest.approx(tight, rel=1e-7)
    if verdict == "wrong":  # and finite, without any sign of it
        assert abs(explicit - tight) > 0.02 * tight
    elif verdict == "overflow":
        assert not np.isfinite(explicit)
    else:
        assert explicit == pytest.approx(tight, rel=1e-6)
