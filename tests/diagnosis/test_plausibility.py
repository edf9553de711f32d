"""Plausibility: silent on plausible data with any effect and nominal values off by two, loud on
mistakes.
"""

import math
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.diagnosis import Model, records_from_arrays
from bristle.diagnosis.checks.plausibility import check
from bristle.diagnosis.report.text.said import said as words_of
from bristle.plant.effects import effects

SHIPPED = tomllib.loads((Path(__file__).parents[1] / "shipped.toml").read_text(encoding="utf-8"))[
    "effects"
]
# those of effects that came later are 0
PLACES = {name: place for place, name in enumerate(sorted(SHIPPED[:22]))}
OFF = [(2.0, 2.0, 2.0), (0.5, 0.5, 0.5), (2.0, 0.5, 2.0)]


def declared(tree, kind="position", off=(1.0, 1.0, 1.0), **changed):
    tree["output"] = {
        "column": "theta",
        "kind": kind,
        "unit": "rad" if kind == "position" else "rad/s",
    }
    tree["parameters"] = {"J": 0.01 * off[0], "a2": 0.02 * off[1], "Fc": 0.12 * off[2]}
    tree.pop("bounds", None)
    tree |= changed
    return Model.from_dict(tree)


def said(model, data, change=lambda t, u, y: (t, u, y)):
    """Return proposals and findings in words."""
    found = check(
        model,
        records_from_arrays(model, [(f"run{i}", *change(*each)) for i, each in enumerate(data)]),
    )
    lines = {"proposals": found.corrections, "findings": found.notes}
    words = {key: tuple(map(words_of, value)) for key, value in lines.items()}
    return SimpleNamespace(**words, fit=found.fit)


@pytest.fixture(scope="module")
def positions(measured):
    return {name: [measured(name, 1)[:3]] for name in effects()}


@pytest.fixture(scope="module")
def velocities(measured):
    return {name: [(t, u, v) for t, u, _, v in [measured(name, 1)]] for name in effects()}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", list(effects()))
@pytest.mark.parametrize("off", OFF)
def test_plausible_data_are_not_reported(name, off, positions, velocities, tree):
    model = declared(tree, off=off)
    assert said(model, positions[name]).proposals == ()
    model = declared(tree, "velocity", off)
    assert said(model, velocities[name]).proposals == ()


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", list(effects()))
def test_each_mistake_is_reported(name, positions, velocities, tree):
    off = OFF[PLACES.get(name, 0) % 3]
    mistakes = {
        "input sign looks flipped": lambda t, u, y: (t, -u, y),
        "torque looks a factor": lambda t, u, y: (t, u * 1e3, y),
        "torque looks": lambda t, u, y: (t, u / 1e3, y),
        "position looks a factor": lambda t, u, y: (t, u, np.degrees(y)),
        # swapped: over a motion like this one it may be taken for another reading
        "": lambda t, u, y: (t, y, u),
    }
    for words, change in mistakes.items():
        [line] = said(declared(tree, off=off), positions[name], change).proposals
        assert words in line, line
        assert "\n" not in line
    [line] = said(declared(tree, "velocity"), positions[name]).proposals
    assert "output looks like a position, not a velocity" in line
    [line] = said(declared(tree), velocities[name]).proposals
    assert "output looks like a velocity, not a position" in line


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", list(effects()))
def test_a_mistake_in_one_of_two_records_is_said_of_that_one(name, positions, measured, tree):
    model, [(t, u, y)] = declared(tree), positions[name]
    second = measured(name, 2)[:3]
    assert said(model, [(t, u, y), second]).proposals == ()
    mistakes = {
        "input sign looks flipped": (t, -u, y),
        "torque looks a factor": (t, 1e3 * u, y),
        "position looks": (t, u, y / 60),
    }
    for words, wrong in mistakes.items():
        [line] = said(model, [second, wrong]).proposals
        assert line.startswith("record run1: ")
        assert words in line
        assert "correct this record, not the model file" in line


def test_a_record_is_not_blamed_where_no_other_tells(positions, tree):
    [(t, u, y)] = positions["bias"]
    still = t, 1e-3 * u, y[0] + 1e-5 * np.sin(7.0 * t)
    [line] = said(declared(tree), [still, (t, u, y / 60)]).proposals
    assert line.startswith("position looks a factor")


def test_it_names_the_likely_unit(positions, tree):
    model, data = declared(tree), positions["bias"]
    [line] = said(model, data, lambda t, u, y: (t, u * 1e3, y)).proposals
    assert "too large" in line
    assert "a unit of milli" in line
    assert "column 'u'" in line
    [line] = said(model, data, lambda t, u, y: (t, u, np.degrees(y))).proposals
    assert "possible causes: deg" in line
    assert "column 'theta'" in line
    [line] = said(model, data, lambda t, u, y: (t * 10, u, y)).proposals
    assert line.startswith("time looks a factor 9.9")
    [line] = said(model, data, lambda t, u, y: (t, u / 9, y)).proposals
    assert "torque looks a factor 8.9" in line or "torque looks a factor 9" in line
    assert "too small" in line


def test_swapped_columns_are_named(positions, tree):
    [line] = said(declared(tree), positions["gravity"], lambda t, u, y: (t, y, u)).proposals
    assert "'u' and 'theta' the other way round" in line


def test_it_estimates_what_is_there(measured, tree):
    data = [measured("bias", seed, plain=True)[:3] for seed in (1, 2)]
    fit = said(declared(tree), data).fit
    assert fit["explained"] > 0.97
    for name, true in (("J", 0.01), ("a2", 0.02), ("Fc", 0.12)):
        assert fit[name]["value"] == pytest.approx(true, rel=0.04)
        assert fit[name]["se"] < 0.03 * true


def test_a_drive_gain_is_part_of_the_torque(measured, tree):
    tree["input"] = {"column": "u", "kind": "voltage", "unit": "V"}
    tree["parameters"] = {"J": 0.01, "a2": 0.02, "Fc": 0.12, "b": 0.5}
    tree.pop("bounds", None)
    model = Model.from_dict(tree)
    t, u, y, _ = measured("bias", 1, plain=True)
    found = said(model, [(t, 2 * u, y)])
    assert found.proposals == ()
    assert found.fit["J"]["value"] == pytest.approx(0.01, rel=0.04)
    [line] = said(model, [(t, 100 * u, y)]).proposals
    assert line.startswith("voltage looks a factor")
    assert "a wrong b in [parameters], the torque per V" in line


def test_a_common_factor_beyond_tight_bounds_is_a_finding(positions, tree):
    tree["parameters"] = {"J": 0.03, "a2": 0.06, "Fc": 0.36}
    tree["bounds"] = {"J": [0.025, 0.04], "Fc": [0.3, 0.45]}
    found = said(Model.from_dict(tree), positions["bias"])
    assert found.proposals == ()
    assert any(line.startswith("J comes out near") for line in found.findings)
    assert any(
        "J and coulomb.Fc come out at 1/" in line and "gear" in line for line in found.findings
    )
    tree["bounds"] = {"J": [0.005, 0.04], "Fc": [0.05, 0.45]}
    assert said(Model.from_dict(tree), positions["bias"]).findings == ()


def test_an_inertia_that_alone_is_far_off_may_lie_behind_a_gear(positions, tree):
    """The friction was fitted to such data, the inertia of the load was weighed: a law without
    viscous friction shows no third.
    """
    tree["parameters"], tree["bounds"] = {"J": 0.08, "a2": 0.0, "Fc": 0.12}, {}
    [line] = said(Model.from_dict(tree), positions["bias"]).proposals
    assert "position looks a factor" in line
    assert "rotor ahead of a gear" in line
    tree["parameters"] = {"J": 0.08, "a2": 0.16, "Fc": 0.12}
    [line] = said(Model.from_dict(tree), positions["bias"]).proposals
    assert "rotor" not in line


def test_without_motion_it_says_so(model):
    t = np.arange(6000) * 1e-3
    y = np.where(t > 5.95, 0.1 * (t - 5.95), 0.0)
    found = said(model, [(t, np.sin(t), y)])
    assert found.proposals == ()
    assert found.findings == ("too little motion to check signs and units",)
    assert found.fit == {}


@pytest.mark.parametrize("friction", ["viscous", "lugre", "modified"])
def test_any_law_has_a_level_or_none(friction, positions, tree):
    own = {
        "viscous": {},
        "lugre": {"sigma0": 20.0, "Fc": 0.12, "Fs": 0.2, "vs": 0.3},
        "modified": {"sigma0": 2400.0, "sigma1": 10.0, "sigma2": 10.0, "c": 200.0},
    }[friction]
    tree |= {"friction": friction, "parameters": {"J": 0.01, "a2": 0.02} | own}
    tree.pop("bounds")
    model = Model.from_dict(tree)
    assert said(model, positions["bias"]).proposals == ()
    [line] = said(model, positions["bias"], lambda t, u, y: (t, -u, y)).proposals
    assert "flipped" in line
    assert math.isfinite(said(model, positions["bias"]).fit["J"]["value"])


def test_a_speed_without_its_sign_is_proposed_and_a_drive_that_brakes_is_not(velocities, tree):
    """|v| under an input of both signs; a motion that never reverses although the input does is
    described by the model.
    """
    model = declared(tree, "velocity")
    [line] = said(model, velocities["bias"], lambda t, u, v: (t, u, np.abs(v))).proposals
    assert line.startswith("output looks like a speed without its sign: 'theta' keeps one sign")
    assert said(model, velocities["bias"]).proposals == ()
    t = 1e-3 * np.arange(12000)
    v, rate = 5 + 3 * np.sin(3 * t), 9 * np.cos(3 * t)
    u = 0.1 * rate + 0.02 * v + 0.12  # of ten times the inertia
    assert (u < 0).mean() > 0.2
    assert said(declared(tree, "velocity", (10.0, 1.0, 1.0)), [(t, u, v)]).proposals == ()
