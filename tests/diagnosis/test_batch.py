"""Parameters from a whole record at once, as they stand beside an observer's estimates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bristle.diagnosis.sliding.batch import batch_estimates, batch_fit

TRUE = {"alpha2": 2.0, "b": 100.0, "Fc": 12.0}  # over the inertia, of the `measured` servo
STEP = 2 * np.pi / 16384


def intervals(found: Any) -> dict[str, float]:
    """Return by how many standard deviations estimates are off."""
    assert set(found) == set(TRUE)
    return {name: (value - TRUE[name]) / sd for name, (value, sd) in found.items()}


@pytest.mark.parametrize("name", ["bias", "gravity"])
def test_it_estimates_a_servo_beside_a_torque_of_its_position(
    name: str, measured: Callable[..., Any]
) -> None:
    _, u, y, _ = measured(name, 1)
    fit = batch_fit(u, y, 1e-3, False, STEP, True)
    assert fit is not None
    assert fit.model.effects == (name,)
    found = batch_estimates(u, y, 1e-3, False, STEP, True)
    assert all(abs(off) < 3.0 for off in intervals(found).values())
    assert all(sd < 0.05 * TRUE[key] for key, (_, sd) in found.items())


def test_another_input_gain_scales_the_estimate_of_it_alone(measured: Callable[..., Any]) -> None:
    _, u, y, _ = measured(plain=True)
    one, two = (batch_estimates(k * u, y, 1e-3, False, STEP, True) for k in (1.0, 4.0))
    assert two["b"][0] == pytest.approx(one["b"][0] / 4.0, rel=0.01)
    for name in ("alpha2", "Fc"):
        assert two[name][0] == pytest.approx(one[name][0], rel=0.01)


def test_a_record_that_does_not_slide_gives_nothing() -> None:
    rng = np.random.default_rng(1)
    still = STEP * rng.integers(0, 2, 3000)
    assert batch_estimates(rng.standard_normal(3000), still, 1e-3, False, STEP, True) == {}
    assert batch_estimates(np.ones(30), still[:30], 1e-3, False, None, True) == {}
