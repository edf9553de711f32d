"""Whether the records agree on the parameters: they do where nothing was changed, and where something was, it is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bristle.diagnosis import Model, records_from_arrays
from bristle.diagnosis.agreement import agreement, with_agreement
from bristle.diagnosis.estimation.fitted_model import fit_with_noise
from bristle.diagnosis.estimation.optimiser import resume
from bristle.diagnosis.preparation import base_servo_of, dataset_of
from bristle.diagnosis.report.headline import NOT_ENOUGH, headline, mark
from bristle.diagnosis.report.result import HALVES, Agreement
from bristle.records.record import Record

H = 1e-3


def found_in(model: Model, records: list[Record]) -> Agreement:
    """Return what the records say of the model fitted to them without further effects."""
    dataset = dataset_of(model, records)
    base = fit_with_noise(dataset, *base_servo_of(model, dataset))
    whole = resume(base.problem.only(dataset.segments.counted), base.fit)
    found = agreement(SimpleNamespace(model=model, dataset=dataset), SimpleNamespace(proposal="", final=base, fit=whole))
    assert found is not None
    return found


@pytest.fixture
def run(model: Model, measured: Callable[..., Any]) -> Callable[..., Record]:
    """Return what makes a record of 8 s of a servo without any effect, or with one; the input is logged `lead` samples early."""

    def of(name: str, seed: int, effect: str = "bias", lead: int = 0, seconds: float = 8.0, **given: float) -> Record:
        t, u, y, _ = measured(effect, seed, **(given or {"plain": 1}))
        n = round(seconds / H)
        [record] = records_from_arrays(model, [(name, t[:n], u[lead : n + lead], y[:n])])
        return record

    return of


def test_records_of_one_servo_agree(model: Model, run: Callable[..., Record]) -> None:
    found = found_in(model, [run("first", 1), run("second", 2)])
    assert found.holds
    assert found.gain < 0.5 * found.level
    assert set(found.values) == {"J", "a2", "coulomb.Fc"}
    assert found.values["J"] == pytest.approx({"first": 0.01, "second": 0.01}, rel=0.02)


def test_friction_that_differs_between_records_is_named_with_its_values(model: Model, run: Callable[..., Record]) -> None:
    found = found_in(model, [run("warm", 1), run("cool", 2), run("dry", 3, "friction_drift", rate=0.06)])
    assert not found.holds
    assert found.differs == "coulomb.Fc"
    assert found.values["coulomb.Fc"] == pytest.approx({"warm": 0.12, "cool": 0.12, "dry": 0.134}, rel=0.03)


def test_halves_of_a_single_record_stand_for_records(model: Model, measured: Callable[..., Any]) -> None:
    t, u, y, _ = measured("friction_drift", 1, rate=0.06)
    found = found_in(model, records_from_arrays(model, [("alone", t, u, y)]))
    assert not found.holds
    assert tuple(found.values[found.differs]) == HALVES
    assert found.differs == "coulomb.Fc"
    first, second = (found.values["coulomb.Fc"][half] for half in HALVES)
    assert first < second


def test_an_input_that_leads_by_different_times_is_seen(model: Model, run: Callable[..., Record]) -> None:
    """The delay of one is an effect that the model has not; it bends the parameters of that record."""
    same = found_in(model, [run("a", 1, lead=6), run("b", 2, lead=6)])
    apart = found_in(model, [run("a", 1), run("b", 2, lead=6)])
    assert apart.gain > apart.level
    assert apart.gain > 3 * same.gain


def test_a_disagreement_is_said_and_is_not_enough(answer: Callable[[str], Any]) -> None:
    named = answer("named")
    values = {"Fc": {"warm": 0.1, "cold": 0.13, "dry": 0.12}}
    apart = Agreement(85.0, 24.0, values, {"Fc": "N.m"}, "Fc")
    said = with_agreement(named, apart)
    assert mark(named)[0] == "good"
    assert mark(said)[0] == "open"
    assert headline(said).startswith(NOT_ENOUGH)
    assert (
        "85 nats likelier, and chance gives 24 at most. Most differs Fc: 0.1 N.m in warm, 0.13 N.m in cold." in said.statement[-1]
    )
    assert said.to_dict()["agreement"]["holds"] is False
    agreed = with_agreement(named, replace(apart, gain=20.0))
    assert agreed.statement == named.statement
    assert mark(agreed)[0] == "good"
    assert with_agreement(named, None).to_dict()["agreement"] is None
    halves = {"Fc": dict(zip(HALVES, (0.1, 0.13), strict=True))}
    assert "The record does not agree with itself" in with_agreement(named, replace(apart, values=halves)).statement[-1]


def test_nothing_is_compared_before_bounds_are_widened() -> None:
    assert agreement(SimpleNamespace(), SimpleNamespace(proposal="wider bounds")) is None
    assert np.isfinite(Agreement(0.0, 1.0, {}, {}, "").level)
