"""What a servo did: sticking, break-away, limit cycle and energy, on motions of which the answer is
known.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bristle.harness.metrics.behaviour import PlantMotion, behaviour
from bristle.harness.metrics.checks import CHECK_QUANTITIES

H = 1e-3
TIME = np.arange(0, 20, H)


def motion(v: np.ndarray, **signals: np.ndarray) -> PlantMotion:
    return PlantMotion(H, {"v": v, "theta": np.cumsum(v) * H, **signals}, None, None)


def test_every_number_is_one_that_a_check_may_demand() -> None:
    found = {f"behaviour.{name}.value" for name in behaviour(motion(np.sin(TIME)))}
    assert found == {path for path in CHECK_QUANTITIES if path.startswith("behaviour.")}


def test_a_standstill_is_counted_and_a_passage_through_zero_is_not() -> None:
    moving = behaviour(motion(np.sin(2 * math.pi * TIME)))
    assert moving["stick_share"].value is None
    assert moving["stick_share"].why == "it never stands still for 0.02 s"
    v = np.where(TIME % 4 < 1, 0.0, 1.0)
    force = np.where(TIME % 4 < 1, TIME % 4, 0.5)  # rises to 1 until the servo moves
    found = behaviour(motion(v, F=force))
    assert found["stick_share"].value == pytest.approx(0.25, abs=1e-3)
    assert found["break_away_torque"].value == pytest.approx(1.0, abs=2e-3)
    assert "no output F" in behaviour(motion(v))["break_away_torque"].why


def test_a_limit_cycle_needs_inputs_at_rest_and_equal_periods() -> None:
    v = 0.2 + 0.1 * np.sin(2 * math.pi * TIME / 0.8)
    found = behaviour(motion(v, reference=np.full_like(v, 0.2)))
    assert found["limit_cycle_amplitude"].value == pytest.approx(0.1, rel=1e-3)
    assert found["limit_cycle_period"].value == pytest.approx(0.8, rel=1e-3)
    driven = behaviour(motion(v, reference=v))
    assert driven["limit_cycle_period"].value is None
    assert driven["limit_cycle_period"].why.startswith("reference moves")
    applied = behaviour(replace(motion(v, u=v), open_loop=True))
    assert applied["limit_cycle_period"].why.startswith("u moves")
    chirp = behaviour(motion(0.2 + 0.1 * np.sin(TIME**2)))
    assert "does not repeat" in chirp["limit_cycle_period"].why
    assert "constant" in behaviour(motion(np.full_like(v, 0.2)))["limit_cycle_amplitude"].why


def test_the_energy_of_a_viscous_servo_is_balanced_and_a_wrong_inertia_is_seen() -> None:
    inertia, gain, viscous = 0.01, 0.5, 0.02
    v, u = np.empty_like(TIME), np.sin(TIME)
    v[0], decay = 0.0, math.exp(-viscous / inertia * H)
    for k in range(len(TIME) - 1):  # exact for a voltage that is held
        end = gain * u[k] / viscous
        v[k + 1] = end + (v[k] - end) * decay
    theta = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * H)])
    whole = PlantMotion(H, {"v": v, "theta": theta, "u": u, "F": viscous * v}, inertia, gain)
    found = behaviour(whole)
    assert abs(found["energy_residual_percent"].value or 1.0) < 1e-3
    assert (found["drive_work"].value or 0.0) > 0
    end = slice(0, 1500)  # while it still moves: the kinetic energy counts
    short = replace(whole, signals={name: each[end] for name, each in whole.signals.items()})
    assert abs(behaviour(short)["energy_residual_percent"].value or 1.0) < 1e-3
    assert (
        abs(behaviour(replace(short, inertia=2 * inertia))["energy_residual_percent"].value or 0.0)
        > 1.0
    )
    assert behaviour(replace(whole, inertia=None))["drive_work"].why == "the plant has no J"


def test_what_is_not_finite_is_no_number() -> None:
    v = np.where(TIME > 10, np.nan, 1.0)
    for each in behaviour(motion(v)).values():
        assert each.as_dict()["value"] is None
        assert each.as_dict()["why"]
