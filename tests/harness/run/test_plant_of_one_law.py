"""The FMU of one friction law takes the place of the FMU of all laws."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bristle.fmus import obtain
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import run
from bristle.harness.scenario.catalogue import find_scenario
from bristle.plant.friction import laws

Maker = Callable[..., Path]
Message = Callable[[Callable[[], Any]], str]
pytestmark = pytest.mark.usefixtures("no_leftovers", "undrawn")
QUICK = find_scenario(Path("quick")).read_text(encoding="utf-8")
LAW, INERTIA = 'law = "modified"', 'J = "0.001 kg.m2"'


def outcome(path: Path, out: Path, fmi: int = 2) -> tuple[str, dict[str, Any]]:
    """Return signals.csv at full rate, and the numbers of result.json."""
    assert run(path, out, RunOptions(fmi=fmi, full=True)).passed
    folder = out / path.stem
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    kept = ("verdict", "steps", "estimates", "states", "checks")
    return (folder / "signals.csv").read_text(encoding="utf-8"), {
        key: result.get(key) for key in kept
    }


@pytest.mark.sampled(4)
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_whole_quick_scenario_runs_with_the_same_digits(
    fmi: int, scenario_file: Maker, tmp_path: Path
) -> None:
    alone, whole = obtain("plant", law="modified", fmi=fmi), obtain("plant", fmi=fmi)
    number = list(laws()).index("modified") + 1
    expected = outcome(scenario_file(QUICK, "quick"), tmp_path / "all", fmi)
    one = scenario_file(QUICK.replace(LAW, f'fmu = "{alone}"'), "quick")
    assert outcome(one, tmp_path / "one", fmi) == expected
    by_index = QUICK.replace(LAW, f'fmu = "{whole}"').replace(
        INERTIA, f"law_index = {number}\n{INERTIA}"
    )
    assert outcome(scenario_file(by_index, "quick"), tmp_path / "index", fmi) == expected


def test_a_scenario_that_names_its_law_has_no_number_beside(
    scenario_file: Maker, tmp_path: Path, message: Message
) -> None:
    path = scenario_file(QUICK.replace(INERTIA, f"law_index = 3\n{INERTIA}"), "quick")
    line = message(lambda: run(path, tmp_path / "out"))
    assert (
        line
        == f"{path}: plant.parameters.law_index = 3: the scenario chooses by plant.law; remove it"
    )


def test_a_number_of_no_law_ends_the_run(
    scenario_file: Maker, tmp_path: Path, message: Message
) -> None:
    text = QUICK.replace(LAW, f'fmu = "{obtain("plant")}"').replace(
        INERTIA, f"law_index = 99\n{INERTIA}"
    )
    assert "law_index" in message(lambda: run(scenario_file(text, "quick"), tmp_path / "out"))
