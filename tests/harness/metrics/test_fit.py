"""Fits of the lean plants: they find what made the record, from starts that do not know it."""

from __future__ import annotations

import numpy as np
import pytest

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.loop import simulate
from bristle.harness.metrics.fit import Data, LeanModel, fit, regression, starts
from bristle.harness.metrics.validation import (
    MODEL_PARAMETERS,
    identified_model,
    lean_fmus,
    validate,
)

H = 1e-3
SET_R = {
    "b": 0.0065,
    "a2": 0.002,
    "modified.sigma0": 800.0,
    "modified.sigma1": 1067.0,
    "modified.sigma2": 400.0,
    "modified.c": 200.0,
}


def voltage(seed: int, n: int = 5000) -> np.ndarray:
    """Filtered noise that drives the plant through many reversals."""
    rng = np.random.default_rng(seed)
    out = np.zeros(n)
    for k in range(1, n):
        out[k] = 0.99 * out[k - 1] + 0.35 * rng.normal()
    return out


def record(law: str, values: dict[str, float], seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    u = voltage(seed)
    bus = Bus(
        (BusUnit("p", Fmu(obtain("plant", law=law)), values),),
        len(u) - 1,
        H,
        series={("p", "u"): u[:-1]},
        record=(("p", "v"),),
    )
    return u, simulate(bus)["p", "v"]


def test_regression_finds_viscous_and_coulomb_friction() -> None:
    u, v = record("coulomb", {"b": 0.0065, "a2": 0.002, "coulomb.Fc": 0.004})
    assert regression(Data(u, v, H)) == pytest.approx((2.0, 6.5, 4.0), rel=0.1)


def test_the_right_model_is_found_exactly() -> None:
    u, v = record("coulomb", {"b": 0.0065, "a2": 0.002, "coulomb.Fc": 0.004})
    with LeanModel("coulomb", Fmu(obtain("plant", law="coulomb"))) as model:
        found = fit(model, Data(u, v, H))
    assert found.mse_percent < 1e-6
    assert found.parameters == pytest.approx({"b": 6.5, "a2": 2.0, "coulomb.Fc": 4.0}, rel=1e-3)
    assert found.at_bound == []


def test_a_record_of_position_is_fitted_by_its_increments() -> None:
    """Encoder counts: the fit is as good although single increments are as coarse as the friction's
    details.
    """
    values = {"b": 0.0065, "a2": 0.002, "coulomb.Fc": 0.004}
    u = voltage(1)
    unit = BusUnit("p", Fmu(obtain("plant", law="coulomb")), values)
    v_enc = simulate(
        Bus((unit,), len(u) - 1, H, series={("p", "u"): u[:-1]}, record=(("p", "v_enc"),))
    )["p", "v_enc"]
    with LeanModel("coulomb", Fmu(obtain("plant", law="coulomb"))) as model:
        found = fit(model, Data(u, v_enc, H, increments=True))
    assert found.parameters == pytest.approx({"b": 6.5, "a2": 2.0, "coulomb.Fc": 4.0}, rel=0.01)


@pytest.mark.sampled(4)
def test_floor_finds_set_r_and_says_tau_vanishes() -> None:
    u, v = record("modified", SET_R)
    data = Data(u, v, H)
    with LeanModel("modified", Fmu(obtain("plant", law="modified"))) as model:
        found = fit(model, data)
    truth = {"b": 6.5, "a2": 2.0, "modified.sigma0": 800.0, "modified.c": 200.0}
    assert {name: found.parameters[name] for name in truth} == pytest.approx(truth, rel=1e-3)
    assert found.parameters["modified.tau"] == pytest.approx(0.0, abs=1e-4)
    assert found.mse_percent < 1e-6


def test_starts_come_from_the_record_alone() -> None:
    """A plant scaled in time and angle gives starts scaled alike: there is no absolute size in
    them.
    """
    u, v = record("modified", SET_R)
    plain, scaled = starts("modified", Data(u, v, H)), starts("modified", Data(u, 100 * v, H))
    for one, other in zip(plain, scaled, strict=True):
        assert other["b"] == pytest.approx(100 * one["b"], rel=1e-6)
        assert other["modified.c"] == pytest.approx(one["modified.c"] / 100, rel=1e-6)
        assert other["modified.sigma0"] == pytest.approx(one["modified.sigma0"], rel=1e-6)


@pytest.mark.sampled(4)
def test_validation_ranks_model_floor_and_baselines() -> None:
    u, v = record("modified", SET_R)
    u2, v2 = record("modified", SET_R, seed=2)
    fmus = lean_fmus()
    finals = {
        "alpha2": 2.0,
        "b": 6.5,
        "sigma0": 800.0,
        "sigma1": 1067.0,
        "sigma2": 400.0,
        "c": 210.0,
    }
    estimates = {name: {"final": value, "valid": True} for name, value in finals.items()}
    identified = identified_model(estimates, {}, fmus)
    assert identified.law == "modified"
    result = validate(Data(u, v, H), Data(u2, v2, H), identified, fmus, baselines=True)
    scores = result.scores
    assert scores["floor"] < scores["model"] < scores["coulomb"] < scores["linear"]
    found = result.as_dict(seed=2)
    assert found["mse_over_coulomb"] == pytest.approx(scores["model"] / scores["coulomb"])


def test_a_model_needs_enough_valid_estimates() -> None:
    fmus = lean_fmus()

    def law(known: dict[str, float] | None = None, **finals: float) -> str | None:
        estimates = {
            name: {"final": value, "valid": value == value} for name, value in finals.items()
        }
        return identified_model(estimates, known or {}, fmus).law

    assert law(alpha2=2.0, b=6.5) == "viscous"
    assert law(alpha2=2.0, b=6.5, Fc=4.0) == "coulomb"
    assert law(alpha2=2.0, b=float("nan"), Fc=4.0) is None
    presliding = {"sigma0": 600.0, "sigma1": 800.0, "sigma2": 300.0, "c": 150.0}
    assert law(**presliding) is None
    assert law({"alpha2": 2.0, "b": 6.5}, **presliding) == "modified"
    outside = identified_model(
        {n: {"final": -1.0, "valid": True} for n in ("alpha2", "b", *presliding)}, {}, fmus
    )
    assert outside.problem is not None
    assert "outside" in outside.problem


def test_the_models_know_their_fmus() -> None:
    for law, fmu in lean_fmus().items():
        for parameter in MODEL_PARAMETERS[law]:
            assert fmu.has(parameter, "parameter")
