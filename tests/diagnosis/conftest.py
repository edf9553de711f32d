"""Shared by the tests of the diagnosis: a model, a simulated record, made-up answers, and what
checks a line of an error.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from bristle.diagnosis import Model, Record, records_from_arrays
from bristle.diagnosis.answer import Diagnosis
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel, fit_with_noise
from bristle.diagnosis.selection import stepwise
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.plant.effects import effect, effects
from bristle.plant.friction import law
from bristle.plant.servo import servo

H = 1e-3
STEP = 2 * np.pi / 16384
TREE: dict[str, Any] = {
    "friction": "coulomb",
    "parameters": {"J": 0.01, "a2": 0.02, "Fc": 0.12},
    "bounds": {"J": [0.002, 0.05], "a2": [0.0, 0.2], "Fc": [0.0, 0.6]},
    "time": {"column": "t", "unit": "s"},
    "input": {"column": "u", "kind": "torque", "unit": "N.m"},
    "output": {"column": "theta", "kind": "position", "unit": "rad"},
}
STRONG = {  # effects, each as strong as the friction or so
    "bias": {"torque": 0.05},
    "asymmetric_coulomb": {"share": 0.4},
    "quadratic_drag": {"coefficient": 0.002},
    "stribeck": {"excess": 1.0},
    "presliding": {"stiffness": 8.0},
    "bristle_damping": {"stiffness": 8.0, "damping": 0.05},
    "cogging": {"amplitude": 0.08},
    "gravity": {"amplitude": 0.3},
    "dead_zone": {"width": 0.08},
    "saturation": {"limit": 0.3},
    "gain_asymmetry": {"share": 0.2},
    "input_delay": {"delay": 0.01},
    "electrical_pole": {"time_constant": 0.01},
    "backlash": {"stiffness": 50.0, "play": 0.03},
    "compliance": {"stiffness": 40.0},
    "load_friction": {"coefficient": 0.2},
    "hard_stop": {"upper": 0.3, "stiffness": 3.0},
    "friction_drift": {"rate": 0.05},
    "disturbance_step": {"torque": 0.1},
    "eccentric_encoder": {},
    "position_friction": {},
    "back_emf": {"constant": 0.03},
    "encoder_play": {"play": 0.02},
    "asymmetric_viscous": {"coefficient": 0.01},
    "gear_loss": {"driving": 0.2, "driven": 0.05},
    "return_spring": {"stiffness": 0.3, "rest": 0.2},
}


@pytest.fixture
def tree() -> dict[str, Any]:
    """The content of a model file, to be changed."""
    return deepcopy(TREE)


@pytest.fixture
def search_among(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return what lets the search try the named effects alone."""

    def restrict(*names: str) -> None:
        monkeypatch.setattr(
            stepwise, "all_effects", lambda: {name: effects()[name] for name in names}
        )

    return restrict


@pytest.fixture
def few(search_among: Callable[..., None]) -> None:
    """Search among a quarter of the effects, where which of them explains most is not what is
    tested.
    """
    search_among("gravity", "bias", "stribeck", "quadratic_drag", "input_delay", "gain_asymmetry")


@pytest.fixture
def model() -> Model:
    """A servo driven by a torque, with its position measured."""
    return Model.from_dict(TREE)


@pytest.fixture(scope="session")
def measured() -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Return what simulates 12 s of a servo with an effect: time, torque, position in counts,
    velocity.

    Parameters of the effect that are `given` take the place of those in `STRONG`.
    """
    systems = [servo(law("coulomb"), True, [effect(name)]) for name in effects()]
    for system, name in zip(systems, effects(), strict=True):
        system.name = name
    program = Program("Every_diagnosed", systems, "case")

    def run(
        name: str = "bias", seed: int = 1, **given: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        values = {"torque": 0.0} if given.pop("plain", None) else STRONG.get(name, {}) | given
        setting = {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12, "b": 1.0, "u_max": 1e6}
        native = Native(
            program, setting | {f"{name}.{key}": value for key, value in values.items()}, name
        )
        rng = np.random.default_rng(seed)
        t = np.arange(12000) * H
        f = np.array([0.15, 0.37, 0.61, 0.93, 1.7, 2.9, 4.3, 7.1, 11.0])
        size = 0.12 * np.array([1.0, 1.5, 1.5, 1.5, 1.5, 1.2, 1.0, 0.7, 0.5])
        u = np.sum(
            size[:, None]
            * np.sin(2 * np.pi * f[:, None] * t + rng.uniform(0, 2 * np.pi, len(f))[:, None]),
            axis=0,
        )
        pole = np.exp(-2 * np.pi * 10 * H)
        noise = lfilter([1 - pole], [1, -pole], rng.standard_normal(len(t)))
        out, _ = native.run(
            H, {"u": u, "tau_load": 0.03 * 0.12 * noise / np.std(noise)}, ["theta", "v"]
        )
        return t, u, np.floor(out[:-1, 0] / STEP) * STEP, out[:-1, 1]

    return run


OFF = {"J": 0.012, "a2": 0.016, "Fc": 0.1}  # nominal values of the model that is to be corrected
SECONDS = 8.0


@dataclass(frozen=True)
class Case:
    """Two short records of a servo with an effect (or None), simulated at a tenth of the diagnosis'
    step, and a model.
    """

    model: Model
    records: list[Record]
    dataset: Dataset
    base: FittedModel


@pytest.fixture(scope="session")
def case(
    measured: Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]],
) -> Callable[..., Case]:
    """Return what makes the case of an effect (with `given` parameters, as of `measured`), each
    once.
    """
    made: dict[tuple[Any, ...], Case] = {}

    def of(name: str | None, **given: float) -> Case:
        key = (name, *sorted(given.items()))
        if key not in made:
            model = Model.from_dict(TREE | {"parameters": OFF})
            runs = {
                seed: measured(name, seed, **given) if name else measured(seed=seed, plain=1)
                for seed in (1, 2)
            }
            n = round(SECONDS / H)
            records = records_from_arrays(
                model, [(f"run {k}", t[:n], u[:n], y[:n]) for k, (t, u, y, _) in runs.items()]
            )
            dataset = dataset_of(model, records)
            made[key] = Case(
                model, records, dataset, fit_with_noise(dataset, *base_servo_of(model, dataset))
            )
        return made[key]

    return of


def _load(name: str) -> ModuleType:
    """Import a neighbouring file; tests are no package."""
    full = f"bristle_tests_diagnosis_{name}"
    if full not in sys.modules:
        spec = importlib.util.spec_from_file_location(full, Path(__file__).parent / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[full] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[full])
    return sys.modules[full]


@pytest.fixture(scope="session")
def fabricated() -> ModuleType:
    """The module fabricated.py."""
    return _load("fabricated")


@pytest.fixture
def answer(fabricated: ModuleType) -> Callable[[str], Diagnosis]:
    """Return a maker of diagnoses by case: named, tie, none, not_identifiable, proposals."""
    return lambda case: fabricated.CASES[case]()
