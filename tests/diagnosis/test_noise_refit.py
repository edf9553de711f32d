"""Parameters and noise estimated in turn: the noise model must not take up what the model explains
only in part.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from bristle.diagnosis import Model, Record, records_from_arrays
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.estimation import fitted_model as fitting
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.likelihood import Fit, FitPoint
from bristle.diagnosis.estimation.optimiser import refit
from bristle.diagnosis.free_parameter import Free, free_parameters
from bristle.model.native import Native
from bristle.plant.servo import servo_program

H, STEP = 1e-3, 2 * np.pi / 16384
TRUE = {"gravity.amplitude": 0.03, "asymmetric_coulomb.share": 0.1}


def simulated(model: Model, seed: int) -> Record:
    """Return 12 s of a servo with a weight, friction that differs by direction, and a disturbance
    of 10 Hz.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(12000) * H
    f = np.array([0.15, 0.37, 0.61, 0.93, 1.7, 2.9, 4.3, 7.1, 11.0])
    size = 0.12 * np.array([1.0, 1.5, 1.5, 1.5, 1.5, 1.2, 1.0, 0.7, 0.5])
    u = size @ np.sin(2 * np.pi * f[:, None] * t + rng.uniform(0, 2 * np.pi, len(f))[:, None])
    pole = np.exp(-2 * np.pi * 10 * H)
    noise = lfilter([1 - pole], [1, -pole], rng.standard_normal(len(t)))
    setting = {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12, "b": 1.0, "u_max": 1e6}
    native = Native(
        servo_program("coulomb", effects=tuple(name.split(".")[0] for name in TRUE)), setting | TRUE
    )
    out, _ = native.run(H, {"u": u, "tau_load": 0.003 * noise / np.std(noise)}, ["theta"])
    [record] = records_from_arrays(
        model, [(f"run {seed}", t, u, np.floor(out[:-1, 0] / STEP) * STEP)]
    )
    return record


@pytest.fixture(scope="module")
def asymmetric() -> tuple[Dataset, Fit]:
    """A dataset, and a fit with one of the two effects that hardly moves: the other one, unknown,
    passes as slow noise.
    """
    tree: dict[str, Any] = {
        "friction": "coulomb",
        "parameters": {"J": 0.01, "a2": 0.02, "Fc": 0.12},
        "time": {"column": "t", "unit": "s"},
        "input": {"column": "u", "kind": "torque", "unit": "N.m"},
        "output": {"column": "theta", "kind": "position", "unit": "rad"},
    }
    model = Model.from_dict(tree)
    own = dataset_of(model, [simulated(model, seed) for seed in (1, 2)])
    base = fitting.fit_with_noise(own, *base_servo_of(model, own))
    free = (*base.servo.free, *free_parameters("asymmetric_coulomb", {"share": 0.0}, {}))
    simulator = base.servo.simulator(own.segments, ("asymmetric_coulomb",))
    begin = {**base.fit.values, "asymmetric_coulomb.share": 0.0}
    return own, refit(base.problem, FitPoint(simulator, free, begin, base.fit.initial))


@pytest.mark.sampled(4)
def test_under_the_first_noise_the_effect_hardly_shows(asymmetric: tuple[Dataset, Fit]) -> None:
    _, first = asymmetric
    assert first.noise.corner < fitting.FAST_CORNER
    assert first.values["asymmetric_coulomb.share"] < 0.3 * TRUE["asymmetric_coulomb.share"]


@pytest.mark.sampled(4)
def test_converged_noise_and_fit_are_likelier_and_nearer_the_truth(
    asymmetric: tuple[Dataset, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    own, first = asymmetric
    end = fitting.refit_with_noise(own, first)
    monkeypatch.setattr(fitting, "FAST_CORNER", 0.0)  # as if no noise were slow
    timid = fitting.refit_with_noise(own, first)
    assert end.total > timid.total + 30
    true = TRUE["asymmetric_coulomb.share"]
    assert abs(end.values["asymmetric_coulomb.share"] - true) < 0.5 * abs(
        timid.values["asymmetric_coulomb.share"] - true
    )


@pytest.mark.sampled(4)
def test_a_converged_noise_refit_changes_nothing(asymmetric: tuple[Dataset, Fit]) -> None:
    own, first = asymmetric
    end = fitting.refit_with_noise(own, first)
    again = fitting.refit_with_noise(own, end)
    assert again.total == pytest.approx(end.total, abs=2.0)


def judged(
    monkeypatch: pytest.MonkeyPatch, diverged: bool, slides: dict[str, float] | None
) -> None:
    """Let every model fit poorly, and the sliding motion give these start values, if any."""
    monkeypatch.setattr(fitting, "fits_poorly", lambda dataset, fit: True)
    monkeypatch.setattr(fitting, "has_diverged", lambda dataset, fit: diverged)
    found = slides and SimpleNamespace(free_values=slides)
    monkeypatch.setattr(fitting, "sliding_fit", lambda dataset, servo, values: found)


@pytest.mark.parametrize(("gains", "chosen"), [((0.0, 3.0), 0), ((0.0, 9.0), 1), ((3.0, 0.0), 0)])
def test_of_two_ends_alike_the_one_inside_its_bounds_is_taken(
    gains: tuple[float, float], chosen: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A light motor turned slowly ended 0.3 nats higher without dry friction, at two bounds: on one
    machine, not on another.
    """
    free = (Free("J", 1e-4, 1e-2), Free("coulomb.Fc", 0.0, 0.6))
    ends = [
        SimpleNamespace(
            servo=SimpleNamespace(free=free), fit=SimpleNamespace(total=100.0 + gain, values=values)
        )
        for gain, values in zip(
            gains, ({"J": 1e-3, "coulomb.Fc": 0.1}, {"J": 1e-2, "coulomb.Fc": 0.0}), strict=True
        )
    ]
    several = iter(ends)
    monkeypatch.setattr(fitting, "fit_with_noise", lambda *_: next(several))
    judged(monkeypatch, diverged=False, slides={"J": 1e-3})
    dataset: Any = None
    assert fitting.fit_from_several_starts(dataset, ends[0].servo, {}) is ends[chosen]


@pytest.mark.parametrize("diverged", [True, False])
def test_a_model_that_diverges_is_fitted_from_less_dry_friction_too(
    diverged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dry friction holds an axis where a missing torque would; steps end where it sticks."""
    free, begun = (Free("J", 1e-4, 1e-2), Free("coulomb.Fc", 0.0, 0.6)), []

    def converge(stand: Any, servo: Any, values: dict[str, float]) -> SimpleNamespace:
        begun.append(values)
        found = {"J": 1e-3, "coulomb.Fc": 0.1}
        return SimpleNamespace(
            servo=servo, fit=SimpleNamespace(total=100.0 * len(begun), values=found)
        )

    monkeypatch.setattr(fitting, "fit_with_noise", converge)
    judged(monkeypatch, diverged=diverged, slides=None)
    dataset: Any = None
    servo: Any = SimpleNamespace(free=free)
    end = fitting.fit_from_several_starts(dataset, servo, {"J": 2e-3})
    assert begun == ([{"J": 2e-3}, {"J": 2e-3, "coulomb.Fc": 0.05}] if diverged else [{"J": 2e-3}])
    assert end.fit.total == 100.0 * len(begun)
