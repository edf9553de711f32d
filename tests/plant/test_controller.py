"""The controller of a setpoint, against loops whose solution is known."""

import math

import numpy as np
import pytest

from bristle.model.native import Native
from bristle.plant.servo import servo_program

H = 1e-3
J, A2 = 0.01, 0.02


def follow(goal, law="viscous", start=0.0, effects=(), record=("theta",), **gains):
    """Return what a servo does that follows a goal (n,)."""
    names = {"lag", "kd", "ki", "limit", "integral", "weight", "forward", "friction", "dead_band"}
    own = {f"controller.{k}" if k in names | {"kp"} else k: x for k, x in gains.items()}
    program = servo_program(law, encoder=False, effects=("controller", *effects))
    given = {"J": J, "a2": A2, "b": 1.0, "u_max": 1e6, "theta_start": start} | own
    u = np.asarray(goal, dtype=float)
    return Native(program, given).run(H, {"u": u}, list(record))[0][:-1]


def test_a_step_is_that_of_a_mass_on_a_spring_and_a_damper():
    omega, kd = 20.0, 0.18
    damping = (A2 + kd) / (2 * J * omega)
    measured = follow(np.ones(700), kp=J * omega**2, kd=kd, forward=0.0)[:, 0]
    t, wd = H * np.arange(700), omega * math.sqrt(1 - damping**2)
    decay = np.exp(-damping * omega * t)
    closed = 1 - decay * (np.cos(wd * t) + damping * omega / wd * np.sin(wd * t))
    assert damping < 1
    # the least lag that is simulated, 0.1 ms, is all that differs
    np.testing.assert_allclose(measured, closed, atol=2e-3)
    worse = follow(np.ones(700), kp=J * omega**2, kd=kd, forward=0.0, lag=3e-3)[:, 0]
    assert np.max(np.abs(worse - closed)) > 2e-2


@pytest.mark.parametrize("lag", [2e-3, 8e-3])
def test_a_lag_takes_from_the_damping_what_a_stiff_spring_makes_of_it(lag):
    """A position behind by a lag T is theta - T v: kp T is what the damping lacks."""
    kp = 1.0
    behind = follow(np.ones(1500), kp=kp, lag=lag, a2=0.1)[:, 0]
    plain = follow(np.ones(1500), kp=kp, lag=0.0, a2=0.1 - kp * lag)[:, 0]
    assert np.max(np.abs(behind - plain)) < 0.06 * np.ptp(plain)
    undamped = follow(np.ones(1500), kp=kp, lag=0.0, a2=0.1)[:, 0]
    assert np.max(np.abs(behind - undamped)) > 2 * np.max(np.abs(behind - plain))


def test_the_integral_holds_what_pulls_and_proportional_action_alone_does_not():
    pull = {"effects": ("bias",), "bias.torque": 0.3, "kp": 3.0, "kd": 0.3}
    goal = np.full(8000, 0.5)
    assert follow(goal, **pull)[-1, 0] == pytest.approx(0.5 + 0.3 / 3.0, rel=1e-6)
    assert follow(goal, **pull, ki=6.0)[-1, 0] == pytest.approx(0.5, abs=1e-5)
    # and it holds from the start where it starts with it
    held = follow(goal, start=0.5, **pull, ki=6.0, integral=-0.3)
    np.testing.assert_allclose(held[:, 0], 0.5, atol=1e-9)


def test_the_limit_is_the_acceleration_of_a_large_step_and_keeps_the_integral():
    goal = np.full(400, 1000.0)
    measured = follow(goal, kp=1.0, limit=0.05, a2=0.0)[:, 0]
    t = H * np.arange(400)
    np.testing.assert_allclose(measured, 0.5 * (0.05 / J) * t**2, rtol=1e-6, atol=1e-9)
    # back within reach, an integral that had gone on would push beyond the goal
    goal = np.where(np.arange(6000) < 2000, 30.0, 0.0)
    ends = [follow(goal, kp=1.0, kd=0.15, ki=0.2, limit=x)[:, 0].min() for x in (0.1, 1e6)]
    assert ends[0] > -25.0


def test_a_dead_band_leaves_an_error_within_it_alone():
    np.testing.assert_array_equal(follow(np.full(300, 0.01), kp=2.0, dead_band=0.02)[:, 0], 0.0)
    assert follow(np.full(300, 0.03), kp=2.0, dead_band=0.02)[-1, 0] > 0.0


def test_a_cascade_is_the_law_with_weights():
    """kv (kx (r - theta) - v) + ki int(kx (r - theta) - v), integrated apart from the package."""
    kx, kv, ki = 8.0, 0.15, 0.9
    goal = np.where(np.arange(1500) < 100, 0.0, 0.7)
    kp = kv * kx + ki
    gains = {"kp": kp, "ki": ki * kx, "kd": kv, "weight": kv * kx / kp, "forward": 0.0}
    measured = follow(goal, **gains)[:, 0]
    theta = v = held = 0.0
    steps, expected = 50, []
    for r in goal:
        expected.append(theta)
        for _ in range(steps):
            error = kx * (r - theta) - v
            held += ki * error * H / steps
            v += (kv * error + held - A2 * v) / J * H / steps
            theta += v * H / steps
    np.testing.assert_allclose(measured, expected, atol=3e-3)


def test_a_cascade_that_rests_away_from_0_stays_there():
    gains = {"kp": 3.0, "ki": 5.0, "kd": 0.2, "weight": 0.6, "forward": 0.0}
    still = follow(np.full(300, 2.0), start=2.0, **gains)
    np.testing.assert_allclose(still[:, 0], 2.0, atol=1e-9)
    # and follows from there as it does from 0
    goal = np.where(np.arange(800) < 50, 0.0, 0.5)
    moved = follow(goal + 2.0, start=2.0, **gains) - 2.0
    np.testing.assert_allclose(moved, follow(goal, **gains), atol=1e-6)
    # without integral action nothing holds what the weight leaves out
    assert follow(np.full(3000, 2.0), kp=3.0, kd=0.3, weight=0.6)[-1, 0] == pytest.approx(1.2)


def test_the_first_sample_is_no_step_of_the_goal():
    still = follow(np.full(50, 3.0), start=3.0, kp=1.0, kd=0.5)
    np.testing.assert_array_equal(still[:, 0], 3.0)
