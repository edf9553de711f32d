"""Start values from the sliding motion: model and effect are fitted together, where simulations
diverge from the start.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from bristle.diagnosis import Model, records_from_arrays
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of, limits
from bristle.diagnosis.estimation.fitted_model import fit_with_noise, sliding_fit
from bristle.diagnosis.selection.start_values import SearchContext, sliding_starts
from bristle.plant.effect import Evidence
from bristle.plant.effects import effect


@pytest.fixture(scope="module")
def joint(measured: Callable[..., Any]) -> Callable[[dict[str, Any], str], Any]:
    def make(tree: dict[str, Any], name: str) -> Any:
        model = Model.from_dict(tree)
        records = records_from_arrays(model, [("run", *measured(name, 1)[:3])])
        dataset = dataset_of(model, records)
        servo, values = base_servo_of(model, dataset)
        fitted, slides = fit_with_noise(dataset, servo, values), sliding_fit(dataset, servo, values)
        assert slides is not None
        return partial(sliding_starts, SearchContext(dataset, fitted), slides)

    return make


HIDDEN = [("gravity", "amplitude", 0.3), ("cogging", "amplitude", 0.08), ("bias", "torque", 0.05)]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("name", "parameter", "true"), HIDDEN)
def test_it_starts_near_the_truth(
    name: str, parameter: str, true: float, joint: Callable[..., Any], tree: dict[str, Any]
) -> None:
    tree["parameters"] = {"J": 0.02, "a2": 0.01, "Fc": 0.3}
    [(values, start)] = joint(tree, name)(name)
    assert abs(start[parameter]) == pytest.approx(true, rel=0.15)
    assert values["J"] == pytest.approx(0.01, rel=0.1)
    assert values["coulomb.Fc"] == pytest.approx(0.12, rel=0.15)


@pytest.mark.sampled(4)
def test_sliding_gives_no_starts_where_hidden_states_matter(
    joint: Callable[..., Any], tree: dict[str, Any]
) -> None:
    found = joint(tree, "bias")
    for name in ("compliance", "input_delay", "presliding", "eccentric_encoder"):
        assert found(name) == []


def test_limits_follow_the_axis_and_the_records(
    tree: dict[str, Any], measured: Callable[..., Any]
) -> None:
    model = Model.from_dict(tree)
    dataset = dataset_of(model, records_from_arrays(model, [("run", *measured("bias", 1)[:3])]))
    rotary = limits(dataset)
    assert rotary["cogging.periods"][0] == pytest.approx(2.0)
    assert "position_friction.periods" not in rotary
    strength = np.abs(dataset.motion.u)
    assert np.mean(strength > rotary["saturation.limit"][0]) == pytest.approx(0.8, abs=0.01)
    assert np.mean(strength < rotary["dead_zone.width"][1]) == pytest.approx(0.8, abs=0.01)
    assert 0.0 < rotary["disturbance_step.onset"][0] < rotary["disturbance_step.onset"][1] < 12.0
    tree["input"] = {"column": "u", "kind": "force", "unit": "N"}
    tree["output"] = {"column": "theta", "kind": "position", "unit": "m"}
    model = Model.from_dict(tree)
    dataset = dataset_of(model, records_from_arrays(model, [("run", *measured("bias", 1)[:3])]))
    span = float(np.ptp(dataset.motion.theta))
    assert limits(dataset)["cogging.periods"][0] == pytest.approx(4 * np.pi / span)
    assert limits(dataset)["position_friction.periods"][0] == pytest.approx(4 * np.pi / span)


@pytest.mark.parametrize("teeth", [3, 19, 47])
def test_friction_of_each_tooth_of_a_gear_is_looked_for(teeth: int) -> None:
    """As of cogging, up to 60 periods a turn."""
    t = 1e-3 * np.arange(20_000)
    theta, v = 5 * np.sin(0.7 * t), 3.5 * np.cos(0.7 * t)
    left = -0.12 * 0.3 * np.sin(teeth * theta + 0.4) * np.sign(v)

    def regress(torques: np.ndarray) -> tuple[np.ndarray, float]:
        found = np.linalg.lstsq(torques, left, rcond=None)[0]
        return found, float(left @ (torques @ found))

    evidence = Evidence(theta, v, 0 * t, 0 * t, t, 1e-3, 1e-4, 0.01, 0.12, 1.0, regress)
    derive = effect("position_friction").starts
    assert derive is not None
    best = derive(evidence)[0]
    assert best["periods"] == pytest.approx(teeth)
    assert best["amplitude"] == pytest.approx(0.3, rel=1e-6)
    assert best["phase"] == pytest.approx(0.4, abs=1e-6)
