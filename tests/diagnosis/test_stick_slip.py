"""Axes that rest between samples, simulated as masses on springs with dry friction."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis import stick_slip

Array = np.ndarray
SECONDS = 1500
STEP = 2e-3  # s


def told(seed: int, sd: float = 0.15, swing: float = 15.0) -> Array:
    """Return an input, one value a second: a slow wave and a random walk."""
    rng = np.random.default_rng(seed)
    wave = swing * np.sin(2 * np.pi * np.arange(SECONDS) / 240)
    return np.asarray(50 + wave + np.cumsum(sd * rng.standard_normal(SECONDS)))


def valve(u: Array, static: float, kinetic: float, damping: float = 0.2) -> Array:
    """Return the position at each second of a mass on a spring of stiffness 1, by Karnopp's law."""
    x, v, mass, seen = float(u[0]), 0.0, 0.02, []
    for target in u.tolist():
        for _ in range(round(1 / STEP)):
            force = target - x
            if abs(v) < 1e-3 and abs(force) <= static:
                v = 0.0
                break
            held = math.copysign(kinetic, v if abs(v) >= 1e-3 else force)
            v += STEP / mass * (force - held - damping * v)
            x += STEP * v
        seen.append(x)
    return np.array(seen)


def test_a_valve_that_sticks() -> None:
    u = told(1)
    found = stick_slip(u, valve(u, 4.0, 1.5))
    assert found.behaviour == "stick and slip"
    assert found.static_interval[0] <= 4.0 <= found.static_interval[1]
    assert found.static == pytest.approx(4.0, rel=0.03)
    assert found.kinetic == pytest.approx(1.5, rel=0.1)
    assert found.jump == pytest.approx(2.5, rel=0.1)
    assert found.gain == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize("resolution", [0.0, 0.1, 0.5])
def test_noise_and_coarse_sensors_widen_the_intervals(resolution: float) -> None:
    u = told(2)
    y = valve(u, 4.0, 1.5) + 0.05 * np.random.default_rng(3).standard_normal(SECONDS)
    y = resolution * np.round(y / resolution) if resolution else y
    found = stick_slip(u, y)
    assert found.behaviour == "stick and slip"
    assert found.static_interval[0] <= 4.0 <= found.static_interval[1]
    assert found.kinetic == pytest.approx(1.5, abs=0.15)
    fine = stick_slip(u, valve(u, 4.0, 1.5)).static_interval
    assert np.diff(found.static_interval) > np.diff(fine)


@pytest.mark.parametrize("gain", [1.0, -0.2])
def test_a_play_is_a_dead_band(gain: float) -> None:
    """A thermostat's: the output is taken along at either end."""
    u = told(4)
    at, seen = u[0], []
    for target in u:
        at = min(max(at, target - 3.0), target + 3.0)
        seen.append(at)
    y = gain * np.array(seen) + 0.01 * np.random.default_rng(5).standard_normal(SECONDS)
    found = stick_slip(u, y)
    assert found.behaviour == "dead band"
    assert found.kinetic == pytest.approx(3.0, rel=0.02)
    assert found.gain == pytest.approx(gain, rel=0.01)


def test_an_axis_without_friction_follows() -> None:
    u = told(6)
    found = stick_slip(u, 2 * u + 3 + 0.05 * np.random.default_rng(7).standard_normal(SECONDS))
    assert found.behaviour == "follows"
    assert found.gain == pytest.approx(2.0, rel=0.01)
    assert found.offset == pytest.approx(3.0, abs=0.1)


def lagging(u: Array) -> Array:
    x, seen = u[0], []
    for target in valve(u, 4.0, 1.5):
        x += 0.3 * (target - x)
        seen.append(x)
    return np.array(seen)


@pytest.mark.parametrize(
    ("output", "said"),
    [
        (lagging, "it lags"),
        (lambda u: valve(told(99, 0.5), 4.0, 1.5), "does not follow this input"),
        (np.zeros_like, "begins to move 0 times up"),
        (lambda u: u[1:], "have shapes"),
        (lambda u: np.where(np.arange(SECONDS) < 19, u, np.nan), "19 samples; give 20"),
    ],
    ids=["a flow behind it", "another", "none", "shorter", "short"],
)
def test_what_is_no_such_axis_is_refused(output: Callable[[Array], Array], said: str) -> None:
    u = told(8)
    with pytest.raises(BristleError, match=said):
        stick_slip(u, output(u))


def test_missing_samples_are_left_out() -> None:
    u = told(9)
    y = valve(u, 4.0, 1.5)
    whole = stick_slip(u, y)
    u[100:110] = np.nan
    assert stick_slip(u, y).kinetic == pytest.approx(whole.kinetic, rel=0.05)
