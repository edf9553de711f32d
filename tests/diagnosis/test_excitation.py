"""Excitation: the numbers are those of a known motion, and a caveat appears when, and only when, it
applies.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from bristle.diagnosis import Model, records_from_arrays
from bristle.diagnosis.checks.excitation import excitation as excited
from bristle.diagnosis.checks.preparation import excluded_effects as reasons_to_exclude
from bristle.diagnosis.report.content import excitation_content
from bristle.diagnosis.report.text.said import said
from bristle.plant.effect import BOTH_DIRECTIONS, BOTH_SIGNS, REVERSALS
from bristle.plant.effects import effects

H = 1e-3


def excitation(model, records):
    """Return what records excite as diagnosis.json holds it."""
    return excitation_content(excited(model, records))


def excluded_effects(model, lacks=()):
    """Return why effects are no candidates, in words."""
    return {name: said(why) for name, why in reasons_to_exclude(model, lacks).items()}


def described(model, t, u, y):
    return excitation(model, records_from_arrays(model, [("run", t, u, y)]))


def swing(seconds=40.0, hertz=0.5, size=1.0):
    t = np.arange(round(seconds / H)) * H
    return t, np.cos(2 * np.pi * hertz * t), size * np.sin(2 * np.pi * hertz * t)


def has(found, words):
    return any(words in line for line in found["caveats"])


def test_numbers_of_a_sine(model):
    found = described(model, *swing())
    top = 2 * np.pi * 0.5
    assert found["speed_range"]["highest"] == pytest.approx(top, rel=0.01)
    assert found["speed_range"]["lowest"] == pytest.approx(-top, rel=0.01)
    assert found["speed_rms"] == {
        "value": pytest.approx(top / np.sqrt(2), rel=0.01),
        "unit": "rad/s",
    }
    assert found["range_travelled"] == {"value": pytest.approx(2.0, rel=0.01), "unit": "rad"}
    assert found["path_travelled"]["value"] == pytest.approx(80.0, rel=0.01)
    assert found["turns_travelled"] == pytest.approx(1 / np.pi, rel=0.01)
    assert found["reversals"] == 40
    assert found["forward_share"] == pytest.approx(0.5, abs=0.02)
    assert found["rest_share"] < 0.02
    assert found["input_bandwidth"]["value"] == pytest.approx(0.5, abs=0.25)
    assert found["samples"] == 40000
    assert found["duration"]["value"] == pytest.approx(40.0)
    json.dumps(found, allow_nan=False)


def test_an_input_that_changes_between_the_samples_is_a_field(model):
    [record] = records_from_arrays(model, [("run", *swing())])
    assert excitation(model, [record])["input_between_samples"] == "held"
    assert (
        excitation(model, [record, replace(record, ahead=0.25)])["input_between_samples"]
        == "changing"
    )


def test_caveats_of_a_sine(model):
    found = described(model, *swing())
    for words in (
        "hardly ever at rest",
        "less than half a turn",
        "one dominant frequency",
        "below 5 Hz",
        "input bandwidth",
    ):
        assert has(found, words), words
    for words in ("one direction", "one sign", "reversals", "speed hardly varies", "slow drift"):
        assert not has(found, words), words


def test_a_rich_record_has_few_caveats(model):
    rng = np.random.default_rng(1)
    t = np.arange(60000) * H
    y = np.where(t % 20 < 15, 8 * np.sin(0.7 * t) + 3 * np.sin(2.9 * t), 0.0)
    y = np.cumsum(np.where(t % 20 < 15, 8 * np.sin(0.7 * t) + 3 * np.sin(2.9 * t), 0.0)) * H
    u = np.repeat(rng.standard_normal(6000), 10)
    found = described(model, t, u, y)
    assert found["rest_share"] == pytest.approx(0.25, abs=0.03)
    assert found["caveats"] == [line for line in found["caveats"] if "input bandwidth" in line]


@pytest.mark.parametrize(
    ("y", "u", "words"),
    [
        (lambda t: 3 * t + 0.1 * np.sin(t), lambda t: 1 + 0.5 * np.sin(20 * t), "one direction"),
        (
            lambda t: 3 * t + 0.1 * np.sin(t),
            lambda t: 1 + 0.5 * np.sin(20 * t),
            "speed hardly varies",
        ),
        (lambda t: 3 * t + 0.1 * np.sin(t), lambda t: 1 + 0.5 * np.sin(20 * t), "only 0 reversals"),
        (
            lambda t: 3 * t + 0.1 * np.sin(t),
            lambda t: 1 + 0.5 * np.sin(20 * t),
            "input of one sign",
        ),
        (lambda t: np.where(t < 30, 0.0, np.sin(t - 30)), lambda t: np.sin(t), "at rest for"),
        (
            lambda t: 0.5 * np.abs((t % 2) - 1),
            lambda t: np.sign((t % 2) - 1) + 0.01 * np.sin(t),
            "hardly ever slow",
        ),
    ],
)
def test_each_caveat_when_it_applies(y, u, words, model):
    t = np.arange(40000) * H
    assert has(described(model, t, u(t), y(t)), words)
    assert not has(described(model, *swing(size=4.0)), words)


def test_a_short_record_sees_no_drift(model):
    assert has(described(model, *swing(10.0)), "slow drift")


def test_counts_are_no_motion(model):
    """A resting encoder that flickers between two counts does not reverse."""
    t, u, y = swing()
    step = 2 * np.pi / 4096
    rest = np.where(
        t > 20, step * (np.random.default_rng(1).random(len(t)) < 0.5), np.floor(y / step) * step
    )
    found = described(model, t, u, rest)
    assert found["reversals"] == pytest.approx(20, abs=1)
    assert found["rest_share"] == pytest.approx(0.5, abs=0.06)


def test_a_drive_has_a_torque_range_and_an_axis_no_turns(tree):
    tree["parameters"] = {"J": 95.0, "a2": 200.0, "Fc": 20.0, "b": 35.0}
    tree.pop("bounds")
    tree["input"] = {"column": "u", "kind": "voltage", "unit": "V"}
    tree["output"]["unit"] = "m"
    found = described(Model.from_dict(tree), *swing())
    assert found["torque_range"] == {
        "lowest": pytest.approx(-35.0),
        "highest": pytest.approx(35.0),
        "unit": "N",
    }
    assert found["range_travelled"]["unit"] == "m"
    assert "turns_travelled" not in found
    assert not has(found, "turn")


def test_a_velocity_gives_the_same(tree, model):
    t, u, y = swing()
    tree["output"] |= {"kind": "velocity", "unit": "rad/s"}
    one = described(model, t, u, y)
    two = described(Model.from_dict(tree), t, u, np.gradient(y, H))
    for key in ("reversals", "forward_share", "rest_share"):
        assert two[key] == pytest.approx(one[key], abs=0.01)
    assert two["range_travelled"]["value"] == pytest.approx(
        one["range_travelled"]["value"], rel=1e-3
    )


def test_noise_does_not_reverse(tree):
    tree["output"] |= {"kind": "velocity", "unit": "rad/s"}
    t, u, y = swing()
    v = np.gradient(y, H) + 1.0 * np.random.default_rng(1).standard_normal(len(t))
    assert described(Model.from_dict(tree), t, u, v)["reversals"] == pytest.approx(40, abs=2)


def test_little_was_recorded(model):
    """Too short in all, or too seldom for an input that moves between the samples; three seconds
    twice are enough.
    """
    rng = np.random.default_rng(2)
    t = np.arange(3000) * H
    u, y = np.repeat(rng.standard_normal(300), 10), 3 * np.sin(2 * t) + np.sin(5.3 * t)
    assert described(model, t, u, y)["narrow"].startswith("the records last 3 s in all")
    twice = records_from_arrays(model, [("a", t, u, y), ("b", t, -u, y)])
    assert excitation(model, twice)["narrow"] == ""
    t = np.arange(600) * 0.05
    slow = records_from_arrays(
        model, [("a", t, rng.standard_normal(600), 3 * np.sin(2 * t) + np.sin(5.3 * t))]
    )
    assert excitation(model, slow)["narrow"] == ""
    moving = [replace(record, ahead=0.4) for record in slow]
    assert excitation(model, moving)["narrow"].startswith(
        "the input changes between samples that are 50 ms apart"
    )


def test_a_small_range_is_too_uniform_only_where_nothing_accelerates(model):
    """The same quarter of a radian: slowly there is friction alone, quickly the inertia takes its
    share too.
    """
    t = np.arange(20000) * H
    for pace, uniform in ((0.2, True), (3.0, False)):
        y = 0.15 * np.sin(2 * np.pi * pace * t) + 0.1 * np.sin(2 * np.pi * 0.61 * pace * t + 1)
        v = np.gradient(y, H)
        u = model.parameters["J"] * np.gradient(v, H) + 0.1 * np.sign(v)
        found = described(model, t, u, y)
        assert (found["inertia_share"] < 0.3) is uniform
        assert found["narrow"].startswith("the servo moves less than a quarter turn") is uniform


def test_records_beside_each_other_have_caveats(tree, model):
    t, u, y = swing()
    overlap, begin = (
        "times of the records overlap",
        "position 0 is assumed at the beginning of each record",
    )
    for second, reported in ((t + 41.0, False), (t, True), (t + 20.0, True)):
        found = excitation(
            model, records_from_arrays(model, [("a", t, u, y), ("b", second, u, -y)])
        )
        assert has(found, overlap) is reported
        assert not has(found, begin)
    tree["output"] |= {"kind": "velocity", "unit": "rad/s"}
    speeds = Model.from_dict(tree)
    assert has(
        excitation(speeds, records_from_arrays(speeds, [("a", t, u, y), ("b", t + 41, u, -y)])),
        begin,
    )
    assert not has(described(speeds, t, u, y), begin)


NO_COLUMN = {"temperature_friction": "the records lack a column of the temperature"}


def test_what_the_records_lack_excludes_the_effects_that_need_it(model):
    """A motion to and fro excludes nothing; one that never comes back all that differs between the
    directions, and all memory.
    """
    t, u, y = swing()
    both = excluded_effects(model, described(model, t, u, y)["lacks"])
    one = excluded_effects(model, described(model, t, u, 3 * t + 0.2 * y)["lacks"])
    assert both == NO_COLUMN
    assert set(one) - set(both) == {
        name
        for name, effect in effects().items()
        if {BOTH_DIRECTIONS, REVERSALS} & set(effect.needs)
    }
    assert {
        "asymmetric_coulomb",
        "gain_asymmetry",
        "load_friction",
        "backlash",
        "encoder_play",
    } <= set(one)
    assert one["backlash"] == "the records lack reversals"
    assert described(model, t, np.abs(u), y)["lacks"] == [BOTH_SIGNS]
    assert set(excluded_effects(model, [BOTH_SIGNS])) - set(both) == {"gain_asymmetry"}


def test_an_effect_that_only_shows_in_a_position_is_none_for_a_velocity(tree):
    tree["output"] = {"column": "v", "kind": "velocity", "unit": "rad/s"}
    assert excluded_effects(Model.from_dict(tree)) == NO_COLUMN | {
        "encoder_play": "needs a measured position: the output is a velocity"
    }
