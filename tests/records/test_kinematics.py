"""Columns by what they are to each other: a velocity, its position, the goal that leads it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from bristle.records.kinematics import motion_in

H = 0.005
T = H * np.arange(4000)
RNG = np.random.default_rng(1)
SPEED = np.cumsum(RNG.standard_normal(len(T))) * 0.02
SPEED -= SPEED.mean()
PLACE = H * np.cumsum(SPEED)
LAGGED = np.interp(T - 0.03, T, PLACE)


@pytest.mark.parametrize("factor", [1.0, 180 / np.pi, 1 / (2 * np.pi)], ids=["rad", "deg", "turns"])
def test_a_velocity_is_told_by_the_changes_of_its_position(factor):
    columns = {"a": factor * PLACE, "b": SPEED + 0.05 * RNG.standard_normal(len(T)), "c": SPEED**2}
    motion = motion_in(T, columns)
    assert motion.velocities == {"b": "a"}
    assert [motion.quantity(name) for name in "abc"] == ["position", "velocity", None]


def test_a_torque_that_a_fast_motor_follows_is_no_velocity():
    """Friction and a factor that no units have: the voltage is not taken for the speed."""
    voltage = 3.7 * SPEED + 0.4 * np.sign(SPEED)
    assert motion_in(T, {"place": PLACE, "voltage": voltage}).velocities == {}
    assert motion_in(T, {"place": PLACE, "voltage": 3.7 * SPEED}).velocities == {}


def test_an_opposite_sign_is_no_velocity():
    assert motion_in(T, {"place": PLACE, "speed": -SPEED}).velocities == {}


def test_a_goal_leads_its_position():
    columns = {"goal": PLACE, "q": LAGGED, "dq": np.gradient(LAGGED, H)}
    motion = motion_in(T, columns)
    assert motion.velocities == {"dq": "q"}
    assert motion.goals == {"goal": "q"}
    late = motion_in(T, {"echo": np.interp(T - 0.06, T, PLACE), **columns})
    assert "echo" not in late.goals  # what follows is none


def test_a_goal_with_its_own_velocity_is_still_a_goal():
    columns = {"a": PLACE, "b": SPEED, "c": LAGGED, "d": np.gradient(LAGGED, H)}
    motion = motion_in(T, columns)
    assert motion.velocities == {"b": "a", "d": "c"}
    assert motion.goals == {"a": "c"}


def test_a_spring_that_follows_at_another_size_is_no_goal():
    smooth = lfilter([0.1], [1, -0.9], PLACE)
    columns = {"spring": 3.0 * PLACE, "q": smooth, "dq": np.gradient(smooth, H)}
    assert motion_in(T, columns).goals == {}


def test_constant_and_missing_values_are_nothing():
    empty = np.full(len(T), np.nan)
    assert motion_in(T, {"a": empty, "b": np.ones(len(T)), "c": SPEED}).velocities == {}
