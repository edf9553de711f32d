"""What was found and is in doubt is suspected, and not named: no name stands in amber."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis.answer import (
    Diagnosis,
    Estimate,
    HorizonError,
    Reason,
    RecordError,
    Unexplained,
    WholeRecords,
)
from bristle.diagnosis.report.export import augment
from bristle.diagnosis.report.headline import headline, mark
from bristle.diagnosis.report.text.statement import open_loop_line
from bristle.diagnosis.stages.doubt import suspected

UNUSED: Any = None  # of a stage's arguments


def judged(diagnosis: Diagnosis) -> list[Reason]:
    """Return the doubts about an answer; check that it names its effects if there is none."""
    found = suspected(UNUSED, diagnosis, UNUSED)
    if not found.doubts:
        assert found is diagnosis
        assert mark(found)[0] == "good"
        return []
    assert (found.effects, found.suspects) == ((), diagnosis.effects)
    assert found.verdict == "not_identifiable"
    named = headline(diagnosis).split(": ", 1)[1].split(";")[0]
    assert headline(found) == f"Suspected, not shown: {named}"
    assert mark(found) == ("open", "suspects")
    return [doubt.reason for doubt in found.doubts]


def whole(*ratios: float) -> WholeRecords:
    """Return errors over whole records, by the ratios of after to before at growing horizons."""
    horizons = tuple(HorizonError(4.0**k, 1.0, x, x) for k, x in enumerate(ratios))
    record = RecordError("a", "rad", 1.0, ratios[-1], 0.0, 50.0)
    return WholeRecords((record,), horizons, 0.0, True, {}, ())


def test_what_is_certain_is_named(answer):
    assert judged(answer("named")) == []
    tie = answer("tie")
    assert suspected(UNUSED, tie, UNUSED) is tie


@pytest.mark.parametrize(
    ("low", "high", "at_bound", "doubted"),
    [(0.6, 1.4, False, False), (0.4, 1.5, False, True), (0.9, 1.1, True, True)],
)
def test_a_strength_must_be_known(answer, low, high, at_bound, doubted):
    named = answer("named")
    [effect, *_] = named.effects
    size = effect.parameters["amplitude"].value
    wide = Estimate(size, "N.m", (low * size, high * size), at_bound)
    unsure = replace(effect, parameters={**effect.parameters, "amplitude": wide})
    doubts = [Reason.DOUBT_STRENGTH] if doubted else []
    assert judged(replace(named, effects=(unsure,))) == doubts
    # a phase is no strength; the strength of a coupling with free play is the play
    phase = replace(effect, parameters={**effect.parameters, "phase": wide})
    assert judged(replace(named, effects=(phase,))) == []
    loose = replace(effect, name="backlash", parameters={"share": phase.parameters["amplitude"]})
    play = replace(loose, parameters={**loose.parameters, "play": wide})
    assert judged(replace(named, effects=(play,))) == doubts


def test_the_inertia_at_its_bound_makes_a_suspect_and_friction_of_0_none(answer):
    named = answer("named")

    def stuck(name: str, value: float) -> Diagnosis:
        return replace(named, fitted={**named.fitted, name: Estimate(value, "", None, True)})

    assert judged(stuck("J", 0.004)) == [Reason.DOUBT_BOUND]
    assert judged(stuck("a2", 0.0)) == []


def test_the_error_must_fall_where_an_effect_acts_throughout(answer):
    named = answer("named")
    same = replace(named, gap=replace(named.gap, after=named.gap.before / 1.1))
    assert judged(same) == [Reason.DOUBT_ERROR]
    [effect, *_] = named.effects
    limit = {"limit": Estimate(1.0, "N.m", (0.9, 1.1))}
    sparse = replace(effect, name="saturation", parameters=limit)
    assert judged(replace(same, effects=(sparse,))) == []


def test_drift_in_the_long_run_is_no_doubt(answer):
    """A raised arm drifts away with any model; what counts is most of the horizons."""
    named = answer("named")
    assert judged(replace(named, whole=whole(0.1, 0.2, 0.2, 1.5))) == []
    assert judged(replace(named, whole=whole(0.1, 1.2, 1.3, 0.9))) == [Reason.DOUBT_WHOLE]
    # less than an effect must lower the error by
    assert judged(replace(named, whole=whole(0.1, 1.05, 1.05, 1.05))) == []
    assert "worse than without what was found" in open_loop_line(whole(0.1, 1.5), 0.4)
    assert "worse" not in open_loop_line(whole(0.1, 0.5), 0.4)


def test_what_is_left_may_be_what_was_taken_for_an_effect(answer):
    named = answer("named")
    large = replace(named, remains=Unexplained(True, "t", 0.4))
    assert judged(large) == [Reason.DOUBT_REST]
    assert judged(replace(named, remains=Unexplained(True, "t", 0.2))) == []


def test_a_suspect_gives_its_reasons_and_a_model_only_if_chosen(answer):
    large = replace(answer("named"), remains=Unexplained(True, "t", 0.4))
    found = suspected(UNUSED, large, UNUSED)
    assert any(line.startswith("Suspected: cogging torque (cogging)") for line in found.statement)
    assert any("is suspected, but 40% of the residual" in line for line in found.statement)
    content = found.to_dict()
    assert content["effects"] == []
    [suspect] = content["suspects"]
    assert (suspect["name"], suspect["class"]) == ("cogging", "cogging")
    assert suspect["parameters"]["amplitude"]["value"] > 0
    assert suspect["why"] == ["40% of the residual can still be predicted"]
    assert augment(found) is None
    chosen = augment(found, "cogging")
    assert chosen is not None
    assert chosen.added == ("cogging",)
    with pytest.raises(BristleError, match="bias"):
        augment(found, "bias")
