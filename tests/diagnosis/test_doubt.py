"""What was found and is in doubt is suspected, and not named: no name stands in amber."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
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
from bristle.diagnosis.selection import refinement
from bristle.diagnosis.sliding.stretches import stretches_of
from bristle.diagnosis.stages.doubt import suspected

H = 1e-3
UNUSED: Any = None  # of a stage's arguments


def moving(*speeds: float, effects: tuple[str, ...] = (), torque: float = 1.0) -> Any:
    """Return what the doubts need of a case: records that move at these speeds [rad/s], nearly,
    driven by this torque [N.m].
    """
    t = H * np.arange(3000)
    records = [(t, np.full_like(t, torque), v * t + 0.1 * np.sin(3 * t)) for v in speeds]
    over = stretches_of(records, H, False, 1e-5)
    servo = SimpleNamespace(law="coulomb", effects=effects, fixed={"b": 1.0, "u_max": 1e9}, free=())
    values = {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.5}
    final = SimpleNamespace(servo=servo, fit=SimpleNamespace(values=values))
    dataset = SimpleNamespace(stretches=over, resolution=1e-5)
    return SimpleNamespace(dataset=dataset, base=final, final=final)


def judged(diagnosis: Diagnosis, case: Any = None) -> list[Reason]:
    """Return the doubts about an answer; check that it names its effects if there is none."""
    found = suspected(case or moving(3.0, -3.0), diagnosis, UNUSED)
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
    assert suspected(moving(3.0), tie, UNUSED) is tie


@pytest.mark.parametrize(
    ("low", "high", "at_bound", "doubted"),
    [
        (0.3, 3.9, False, False),
        (0.2, 1.5, False, True),
        (0.6, 4.1, False, True),
        (0.9, 1.1, True, True),
    ],
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
    worse = replace(named, whole=whole(0.1, 1.2, 1.3, 0.9))
    assert judged(worse) == [Reason.DOUBT_WHOLE]
    play = {"play": Estimate(0.02, "rad", (0.019, 0.021))}
    loose = replace(named.effects[0], name="backlash", parameters=play)
    assert judged(replace(worse, effects=(loose,))) == []
    # less than an effect must lower the error by
    assert judged(replace(named, whole=whole(0.1, 1.05, 1.05, 1.05))) == []
    assert "worse than without what was found" in open_loop_line(whole(0.1, 1.5), 0.4)
    assert "worse" not in open_loop_line(whole(0.1, 0.5), 0.4)


def test_what_slides_as_an_effect_says_may_drift_in_an_open_simulation(answer):
    """In a loop, it drifts by the disturbance that the loop has answered."""
    worse, t = replace(answer("named"), whole=whole(0.1, 1.2, 1.3, 0.9)), H * np.arange(3000)
    y = 3.0 * t + 0.1 * np.sin(3.0 * t)
    v, a = 3.0 + 0.3 * np.cos(3.0 * t), -0.9 * np.sin(3.0 * t)
    noise = 1e-5 * np.random.default_rng(1).standard_normal(len(t))
    case = moving(3.0)
    values = case.final.fit.values | {"gravity.amplitude": 0.3, "gravity.phase": 0.0}
    carries = SimpleNamespace(**vars(case.final.servo) | {"effects": ("gravity",)})
    case.final = SimpleNamespace(servo=carries, fit=SimpleNamespace(values=values))
    for amplitude, doubts in ((0.3, []), (0.0, [Reason.DOUBT_WHOLE])):
        u = 0.01 * a + 0.02 * v + 0.5 + amplitude * np.sin(y)
        case.dataset.stretches = stretches_of([(t, u, y + noise)], H, False, 1e-5)
        assert judged(worse, case) == doubts


def test_what_is_left_may_be_what_was_taken_for_an_effect(answer):
    named = answer("named")
    for doubtful, doubts in ((True, [Reason.DOUBT_REST]), (False, [])):
        left = Unexplained(True, "t", 0.6, doubtful=doubtful)
        assert judged(replace(named, remains=left)) == doubts


def of(diagnosis: Diagnosis, name: str, key: str, value: float) -> Diagnosis:
    """Return an answer with one effect of so much alone."""
    estimate = Estimate(value, "", (0.9 * value, 1.1 * value))
    effect = replace(diagnosis.effects[0], name=name, group=name, parameters={key: estimate})
    fitted = {f"{name}.{key}": estimate, "coulomb.Fc": Estimate(0.0246, "N.m", (0.02, 0.03))}
    return replace(diagnosis, effects=(effect,), fitted=fitted)


def test_what_cancels_the_friction_wherever_the_servo_moves_is_no_name(answer):
    """Of an axis that never reverses, a constant torque may undo its friction."""
    bias = of(answer("named"), "bias", "torque", 0.0251)
    opposed = [Reason.DOUBT_CANCELLING]
    assert judged(bias, moving(3.0, 2.0, effects=("bias",))) == opposed
    assert judged(bias, moving(3.0, -2.0, effects=("bias",))) == []
    assert judged(bias, moving(-3.0, effects=("bias",))) == []


def test_a_torque_that_is_small_beside_others_is_no_name(answer):
    """Drive of 1 N.m and friction of .0246: a bias of 1.5 % of both may be an error of either."""
    for share, doubts in ((0.015, [Reason.DOUBT_FAINT]), (0.025, [])):
        bias = of(answer("named"), "bias", "torque", share * (1.0 + 0.0246))
        assert judged(bias, moving(3.0, -2.0, effects=("bias",))) == doubts
    # the same torque of a drive that hardly does more
    weak = of(answer("named"), "bias", "torque", 0.015)
    case = moving(3.0, effects=("bias",), torque=0.1)
    assert judged(weak, case) == []


def test_what_is_small_beside_a_later_effect_is_removed(monkeypatch):
    """However certain it was when it was found alone; it would take the name from the other."""
    case = moving(3.0, -3.0, effects=("bias", "gravity"))
    values = case.final.fit.values | {"gravity.amplitude": 0.5, "gravity.phase": 0.0}
    less = SimpleNamespace(servo=None)
    monkeypatch.setattr(refinement, "_without", lambda fitted, base, name: less)
    base: Any = SimpleNamespace(servo=SimpleNamespace(effects=()))
    for torque, removed in ((0.01, ["bias"]), (0.1, [])):
        fit = SimpleNamespace(values=values | {"bias.torque": torque})
        fitted = SimpleNamespace(servo=case.final.servo, fit=fit)
        context: Any = SimpleNamespace(dataset=case.dataset, fitted=fitted, fit=fit)
        found = refinement.backward_elimination(context, base, 20.0, certain=("bias",))
        assert found == (less if removed else fitted, removed)


@pytest.mark.parametrize(("share", "doubts"), [(0.1, []), (-0.35, [Reason.DOUBT_SIZE])])
def test_a_size_that_no_hardware_has_is_no_name(answer, share, doubts):
    assert judged(of(answer("named"), "gain_asymmetry", "share", share)) == doubts


def test_a_suspect_gives_its_reasons_and_a_model_only_if_chosen(answer):
    left = Unexplained(True, "t", 0.6, doubtful=True)
    found = suspected(moving(3.0), replace(answer("named"), remains=left), UNUSED)
    assert any(line.startswith("Suspected: cogging torque (cogging)") for line in found.statement)
    assert any("is suspected, but 60% of the residual" in line for line in found.statement)
    content = found.to_dict()
    assert content["effects"] == []
    [suspect] = content["suspects"]
    assert (suspect["name"], suspect["class"]) == ("cogging", "cogging")
    assert suspect["parameters"]["amplitude"]["value"] > 0
    assert suspect["why"] == ["60% of the residual can still be predicted"]
    assert augment(found) is None
    chosen = augment(found, "cogging")
    assert chosen is not None
    assert chosen.added == ("cogging",)
    with pytest.raises(BristleError, match="bias"):
        augment(found, "bias")
