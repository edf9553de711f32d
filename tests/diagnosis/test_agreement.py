"""Whether the records agree on the parameters: they do where nothing was changed, and where
something was, it is named.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bristle.diagnosis import Model, records_from_arrays
from bristle.diagnosis.answer import HALVES, Gap, RecordAgreement
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.estimation.fitted_model import fit_with_noise
from bristle.diagnosis.estimation.optimiser import resume
from bristle.diagnosis.free_parameter import free_parameters
from bristle.diagnosis.report.headline import NOT_ENOUGH, headline, mark
from bristle.diagnosis.stages.agreement import (
    _slides_agree,
    agreement,
    agreement_of,
    with_agreement,
)
from bristle.records.record import Record

H = 1e-3


def found_in(model: Model, records: list[Record]) -> RecordAgreement:
    """Return what the records say of the model fitted to them without further effects."""
    dataset = dataset_of(model, records)
    base = fit_with_noise(dataset, *base_servo_of(model, dataset))
    whole = resume(base.problem.only(dataset.segments.counted), base.fit)
    found = agreement_of(SimpleNamespace(model=model, dataset=dataset, final=base, fit=whole))
    assert found is not None
    return found


@pytest.fixture
def run(model: Model, measured: Callable[..., Any]) -> Callable[..., Record]:
    """Return what makes a record of 8 s of a servo without any effect, or with one; the input is
    logged `lead` samples early.
    """

    def of(
        name: str,
        seed: int,
        effect: str = "bias",
        lead: int = 0,
        seconds: float = 8.0,
        **given: float,
    ) -> Record:
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


@pytest.mark.sampled(4)
def test_friction_that_differs_between_records_is_named_with_its_values(
    model: Model, run: Callable[..., Record]
) -> None:
    found = found_in(
        model, [run("warm", 1), run("cool", 2), run("dry", 3, "friction_drift", rate=0.06)]
    )
    assert not found.holds
    assert found.differs == "coulomb.Fc"
    assert found.values["coulomb.Fc"] == pytest.approx(
        {"warm": 0.12, "cool": 0.12, "dry": 0.134}, rel=0.03
    )


@pytest.mark.sampled(4)
def test_halves_of_a_single_record_stand_for_records(
    model: Model, measured: Callable[..., Any]
) -> None:
    t, u, y, _ = measured("friction_drift", 1, rate=0.06)
    found = found_in(model, records_from_arrays(model, [("alone", t, u, y)]))
    assert not found.holds
    assert tuple(found.values[found.differs]) == HALVES
    assert found.differs == "coulomb.Fc"
    first, second = (found.values["coulomb.Fc"][half] for half in HALVES)
    assert first < second


@pytest.mark.sampled(4)
def test_an_input_that_leads_by_different_times_is_seen(
    model: Model, run: Callable[..., Record]
) -> None:
    """The delay of one is an effect that the model has not; it bends the parameters of that
    record.
    """
    same = found_in(model, [run("a", 1, lead=6), run("b", 2, lead=6)])
    apart = found_in(model, [run("a", 1), run("b", 2, lead=6)])
    assert apart.gain > apart.level
    assert apart.gain > 3 * same.gain


def test_what_slides_alike_agrees(model: Model, run: Callable[..., Record]) -> None:
    """Whatever segments in which the servo sticks may say; the friction of one may not differ."""
    for effect, given, agree in (
        ("bias", {"plain": 1}, True),
        ("friction_drift", {"rate": 0.06}, False),
    ):
        records = [run("first", 1), run("second", 3, effect, **given)]
        dataset = dataset_of(model, records)
        base = fit_with_noise(dataset, *base_servo_of(model, dataset))
        case: Any = SimpleNamespace(model=model, dataset=dataset, final=base, fit=base.fit)
        assert _slides_agree(case) == agree


def test_a_disagreement_is_said_and_is_not_enough(answer: Callable[[str], Any]) -> None:
    named = answer("named")
    values = {"Fc": {"warm": 0.1, "cold": 0.13, "dry": 0.12}}
    apart = RecordAgreement(85.0, 24.0, values, {"Fc": "N.m"}, "Fc")
    said = with_agreement(named, apart)
    assert mark(named)[0] == "good"
    assert mark(said)[0] == "good"
    assert headline(said).endswith("; the records do not agree on the parameters")
    line = (
        "85 nats likelier, and chance gives 24 at most (natural units of log-likelihood: a gain of"
        " 4.6 nats is odds of 100 to 1). "
    )
    line += "Most differs Fc: 0.1 N.m in warm, 0.13 N.m in cold."
    assert line in said.statement[0]
    assert said.experiment.startswith("Find out what was changed between the records")
    assert said.to_dict()["agreement"]["holds"] is False
    assert replace(apart, slides_agree=True).holds
    agreed = with_agreement(named, replace(apart, gain=20.0))
    assert agreed.statement == named.statement
    assert mark(agreed)[0] == "good"
    assert with_agreement(named, None).to_dict()["agreement"] is None
    halves = {"Fc": dict(zip(HALVES, (0.1, 0.13), strict=True))}
    said = with_agreement(named, replace(apart, values=halves))
    assert "The record does not agree with itself" in said.statement[0]
    assert said.experiment.startswith("Find out what changed during the record")


def test_records_without_any_effect_that_do_not_agree_are_not_called_unexplained(
    answer: Callable[[str], Any],
) -> None:
    apart = RecordAgreement(85.0, 24.0, {"Fc": {"warm": 0.1, "cold": 0.13}}, {"Fc": "N.m"}, "Fc")
    assert (
        headline(with_agreement(answer("none"), apart)) == f"{NOT_ENOUGH}: the records do not agree"
    )
    halves = replace(apart, values={"Fc": dict(zip(HALVES, (0.1, 0.13), strict=True))})
    assert (
        headline(with_agreement(answer("none"), halves))
        == f"{NOT_ENOUGH}: halves of the record do not agree"
    )
    for agreed, floor in ((None, 0.2), (replace(apart, gain=2.0), 0.2), (apart, None)):
        floored = replace(answer("none"), gap=Gap(1.0, 0.5, 0.2, "rad"))
        assert with_agreement(floored, agreed).gap.noise_floor == floor


def test_nothing_is_compared_before_bounds_are_widened(answer: Callable[[str], Any]) -> None:
    waiting = replace(answer("none"), corrections=("wider bounds",))
    assert agreement(SimpleNamespace(), waiting, SimpleNamespace()).agreement is None
    assert np.isfinite(RecordAgreement(0.0, 1.0, {}, {}, "").level)


@pytest.mark.sampled(4)
def test_a_record_that_says_nothing_of_a_parameter_has_no_value_of_it(
    model: Model, measured: Callable[..., Any]
) -> None:
    """A step in the second record: the first one says nothing of it, and it is not what differs."""
    parts = [measured("bias", 1, plain=1), measured("bias", 2, torque=0.05)]
    records = records_from_arrays(
        model,
        [(name, t, u, y) for name, (t, u, y, _) in zip(("without", "with"), parts, strict=True)],
    )
    dataset = dataset_of(model, records)
    base, values = base_servo_of(model, dataset)
    times = dataset.segments.consecutive([0, 1])
    assert times == (0.0, pytest.approx(12.0))  # with what follows the last segment
    timed = replace(dataset, segments=dataset.segments.timed(times))
    start = {"torque": 0.04, "onset": times[1] + 0.01}
    servo = replace(
        base,
        effects=("disturbance_step",),
        free=(*base.free, *free_parameters("disturbance_step", start, base.limits)),
    )
    fitted = fit_with_noise(
        timed, servo, {**values, **{f"disturbance_step.{name}": x for name, x in start.items()}}
    )
    whole = resume(fitted.problem.only(timed.segments.counted), fitted.fit)
    found = agreement_of(SimpleNamespace(model=model, dataset=timed, final=fitted, fit=whole))
    assert found is not None
    assert found.values["disturbance_step.torque"]["without"] is None
    assert found.values["disturbance_step.torque"]["with"] == pytest.approx(0.05, rel=0.05)
    assert found.differs != "disturbance_step.torque"


def test_refits_that_end_on_the_way_tell_nothing(
    model: Model, run: Callable[..., Record], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bristle.diagnosis.stages.agreement.predicted_gain", lambda _fit: 1e3)
    with pytest.raises(AssertionError):
        found_in(model, [run("first", 1), run("second", 2)])
