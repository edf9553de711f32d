"""The hidden truth: independent, physical, reproducible; and the gap ratio that says how visible an
effect is.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from cases import SIZES, adapt, draw, plan, write
from forms import EFFECTS, PARAMETERS, Setting
from gap import measure
from scene import SAMPLES, Scene, draw_scene
from truth import (
    DISPLACEMENT,
    PERIOD,
    PLANT_FIELDS,
    Plant,
    Record,
    base_friction,
    replay,
    state_count,
    struct,
)

from bristle.model.variables import Parameter
from bristle.plant.effects import effects

SHIPPED = tomllib.loads((Path(__file__).parents[1] / "shipped.toml").read_text(encoding="utf-8"))[
    "effects"
]

JUDGES = (
    "run.py",
    "oracle_search.py",
    "low_rate_records.py",
    "horizons.py",
    "experiments.py",
    "level.py",
    "wall.py",
)  # they diagnose what others draw
FOLDER = Path(__file__).resolve().parents[2] / "benchmarks" / "blind"
BASE = {"J": 0.01, "a2": 0.02, "Fc": 0.12}
STIFF = {**BASE, **base_friction(BASE["J"], BASE["Fc"])}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return draw_scene(np.random.default_rng(1), "rich")


def push(torque: float, speed: float = 0.0, **fields: float) -> np.ndarray:
    """Return half a second of position under a constant torque, from rest or sliding."""
    record = Record(0.0, np.full(500, torque), np.zeros(500), np.zeros((500, state_count())))
    record.states[0, 1:3] = speed, DISPLACEMENT if speed else 0.0
    return replay(
        {**STIFF, **fields}, record, np.zeros(1, dtype=np.int64), record.states[:1], 500, 5e-5
    )[0]


def test_it_imports_nothing_of_what_it_judges() -> None:
    for path in FOLDER.glob("*.py"):
        text = path.read_text(encoding="utf-8")
        used = set(re.findall(r"bristle\.(\w+)", text)) - {"model", "common"}
        assert used <= ({"diagnosis"} if path.name in JUDGES else set()), path.name


def test_parameters_are_those_of_the_catalogue() -> None:
    known = {
        p.name
        for effect in effects().values()
        for p in effect.parameters
        if isinstance(p, Parameter)
    }
    assert {f"{name}.{p}" for name, each in PARAMETERS.items() for p in each} <= known
    assert set(EFFECTS) == set(PARAMETERS) == set(SHIPPED) - {"back_emf", "temperature_friction"}
    assert {f"{name}_{p}" for name, each in PARAMETERS.items() for p in each} <= PLANT_FIELDS


def test_an_unknown_field_is_an_error() -> None:
    with pytest.raises(ValueError, match="no field"):
        struct(Plant, {"gravity_amplitdue": 1.0})


def test_it_sticks_below_the_coulomb_level_and_slides_above() -> None:
    assert np.ptp(push(0.11)) < 3.8e-4  # a step bends the bristles at once: less than a count
    t = PERIOD * np.arange(500)
    tau, end = 0.01 / 0.02, (0.2 - 0.12) / 0.02  # s, rad/s: J v' = T - Fc - a2 v
    exact = end * t + (0.5 - end) * tau * (1 - np.exp(-t / tau))
    np.testing.assert_allclose(push(0.2, speed=0.5), exact, atol=1e-5)


@pytest.mark.parametrize(
    ("fields", "torque"),
    [
        ({"dead_zone_width": 0.05}, 0.16),
        ({"saturation_limit": 0.1}, 0.5),
        ({"bias_torque": -0.05}, 0.16),
        ({"load_friction_coefficient": 0.5}, 0.2),
        ({"stribeck_excess": 1.0, "stribeck_speed": 0.2}, 0.2),
        ({"asymmetric_coulomb_share": 0.5}, 0.16),
    ],
)
def test_effects_hold_what_would_slide(fields: dict[str, float], torque: float) -> None:
    assert np.ptp(push(torque)) > 1e-2
    assert np.ptp(push(torque, **fields)) < 1e-3


def test_a_delay_shifts_the_motion() -> None:
    late = np.interp(PERIOD * np.arange(500) - 0.0105, PERIOD * np.arange(500), push(0.3))
    np.testing.assert_allclose(push(0.3, input_delay_delay=0.0105), late, atol=1e-4)


@pytest.mark.sampled(4)
def test_without_effect_the_gap_ratio_is_one_and_it_grows_with_strength(scene: Scene) -> None:
    ratios = []
    for amplitude in (0.0, 0.004, 0.012):
        fields = {"cogging_amplitude": amplitude, "cogging_periods": 7.0}
        ratios.append(measure(scene.records(fields), scene.plant(fields))[0].ratio)
    assert 0.3 < ratios[0] < 1.1
    assert ratios[0] < 0.7 * ratios[1] < 0.2 * ratios[2]


@pytest.mark.sampled(4)
def test_a_wrong_truth_spoils_the_ratio(scene: Scene) -> None:
    """The floor is that of the right truth only."""
    fields = {"cogging_amplitude": 0.01, "cogging_periods": 7.0}
    assert measure(scene.records(fields), scene.plant())[0].ratio < 1.1


@pytest.mark.sampled(4)
def test_strength_is_found_for_a_ratio(scene: Scene) -> None:
    quiet = scene.records()
    shape = EFFECTS["gravity"](np.random.default_rng(3), Setting(scene, quiet, False))
    found = adapt(scene, quiet, shape, (2.0, 30.0), 8.0, 3)
    assert found is not None
    assert 5 < found.gap.ratio < 13


def test_the_plan_is_full_balanced_mixed_and_reproducible() -> None:
    specs = plan("some commit")
    assert sum(SIZES.values()) == len(specs) >= 1500
    assert specs == plan("some commit") != plan("another commit")
    for group in ("same", "other"):
        counts = [sum(s.group == group and s.names == (name,) for s in specs) for name in EFFECTS]
        assert max(counts) - min(counts) <= 1
    assert len({s.group for s in specs[:100]}) == len(SIZES)


@pytest.mark.slow
def test_a_case_contains_nothing_but_its_records(tmp_path: Path) -> None:
    specs = [s for s in plan("some commit", 0.05) if s.group in ("control", "same")]
    chosen = [next(s for s in specs if s.group == group) for group in ("control", "same")]
    shown = []
    for spec in chosen:
        write(draw("some commit", spec), tmp_path)
        folder = tmp_path / "cases" / f"{spec.index:05d}"
        assert sorted(p.name for p in folder.iterdir()) == ["a.npz", "b.npz", "model.toml"]
        with np.load(folder / "b.npz") as record:
            shown.append(
                [(name, record[name].shape, str(record[name].dtype)) for name in record.files]
            )
            assert record["t"][0] == 25.0
        text = (folder / "model.toml").read_text(encoding="utf-8")
        shown.append(re.sub(r"= [-\d.e\[\], ]+", "=", text))
    assert shown[0] == shown[2]
    assert shown[1] == shown[3]
    assert shown[0][0] == ("t", (SAMPLES,), "float64")
    again = draw("some commit", chosen[1])
    with np.load(tmp_path / "cases" / f"{chosen[1].index:05d}" / "a.npz") as record:
        np.testing.assert_array_equal(record["theta"], again.records[0].theta)
