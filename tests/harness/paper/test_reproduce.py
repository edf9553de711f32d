"""The paper's figures and numbers: what is on the page, and that it is what the scenarios of its
runs give.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.metrics.friction_curve import friction_curve
from bristle.harness.paper.cases import scenario_path, stiffer
from bristle.harness.paper.printed_numbers import FIGURES, PRINTED
from bristle.harness.paper.reproduce import REPRODUCE_FILES, reproduce
from bristle.harness.paper.schemes import GAINS, SCHEMES, TEST_PLANTS
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import run

SHORT = 0.01  # share of the paper's durations in the quick tests


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A page of short runs: its folder and what was returned."""
    out = tmp_path_factory.mktemp("short") / "page"
    return out, reproduce(out, share=SHORT)


@pytest.mark.slow
def test_the_folder_holds_the_page_its_figures_and_the_numbers(
    page: tuple[Path, dict[str, Any]],
) -> None:
    out, content = page
    assert {path.name for path in out.iterdir()} == set(REPRODUCE_FILES)
    written = (out / "reproduce.json").read_text(encoding="utf-8")
    assert json.loads(written) == content
    assert "NaN" not in written
    html = (out / "report.html").read_text(encoding="utf-8")
    assert re.findall(r'src="(?!data:)', html) == []
    assert set(re.findall(r'href="([^#"][^"]*)"', html)) == set(REPRODUCE_FILES) - {"report.html"}
    drawn = [unquote(each) for each in re.findall(r'src="data:image/svg\+xml,([^"]+)"', html)]
    written_ones = [
        (out / name).read_text(encoding="utf-8")
        for name in REPRODUCE_FILES
        if name.endswith(".svg")
    ]
    assert sorted(drawn) == sorted(" ".join(text.split()) for text in written_ones)
    for figure in FIGURES:
        assert f"Figure {figure.number}: {figure.title}" in html
    assert not re.search(r"\bnan\b", re.sub(r"<[^>]*>", " ", html))


@pytest.mark.slow
def test_the_numbers_are_those_of_the_scenarios(
    page: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    """A user who runs a scenario of the page with the overrides that it shows gets the same
    digits.
    """
    _, content = page
    [entry] = [
        each
        for each in content["runs"]
        if (each["scheme"], each["plant"], each["order"]) == ("repaired", "S", 1)
    ]
    done = run(scenario_path("repaired", "S"), tmp_path, RunOptions(overrides=entry["overrides"]))
    assert done.result["duration_s"] == pytest.approx(3.0)
    found = content["estimates"]["S"]["repaired"]
    assert {name: e["final"] for name, e in found.items() if e["valid"]} == {
        name: e["final"] for name, e in done.result["estimates"].items() if e["valid"]
    }
    [row] = [each for each in content["eq25"] if (each["plant"], each["order"]) == ("S", 1)]
    for name in ("linear", "coulomb", "floor"):
        assert row[name] == done.result["validation"][f"{name}_mse_percent"]


@pytest.mark.slow
def test_a_second_page_replaces_the_first_and_leaves_the_rest(
    page: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    from bristle.common.output import replace_files

    (tmp_path / "thesis.txt").write_text("precious")
    (tmp_path / "eq25.svg").write_text("old")
    replace_files(tmp_path, {"report.html": b"new"}, REPRODUCE_FILES)
    assert {path.name for path in tmp_path.iterdir()} == {"thesis.txt", "report.html"}


def test_the_printed_scheme_has_the_printed_gains() -> None:
    """The table of printed numbers against the defaults of the observer: both were typed from the
    paper.
    """
    observer = Fmu(obtain("observer", method="two_step_printed"))
    for key, names in GAINS.items():
        found = [observer.start(f"two_step_printed.{name}") for name in names]
        printed = PRINTED[key].values
        assert found == pytest.approx(
            [math.radians(value) if key == "vc" else value for value in printed]
        )
    assert PRINTED["resolution"].values[0] == pytest.approx(360 / (4 * PRINTED["pulses"].values[0]))


def test_set_s_is_what_figures_4_and_5_print() -> None:
    """alpha2 and b as printed, sigma_i and c a hundred times larger, so that the friction level is
    the printed one.
    """
    import tomllib

    plant = tomllib.loads(scenario_path("printed", "S").read_text(encoding="utf-8"))["plant"][
        "parameters"
    ]
    value = {name: float(text.split()[0]) for name, text in plant.items()}
    assert value["a2"] / value["J"] == pytest.approx(PRINTED["alpha2"].values[0])
    assert value["b"] / value["J"] == pytest.approx(PRINTED["b"].values[0])
    for name in ("sigma0", "sigma1", "sigma2", "c"):
        assert value[f"modified.{name}"] == pytest.approx(100 * PRINTED[name].values[0])


def test_the_scenarios_of_a_plant_have_the_same_record() -> None:
    import tomllib

    for plant in TEST_PLANTS:
        parts = []
        for scheme in SCHEMES:
            tree = tomllib.loads(scenario_path(scheme, plant).read_text(encoding="utf-8"))
            parts.append(
                {key: tree[key] for key in ("duration", "step", "plant", "controller")}
                | {"seed": tree["validation"]["seed"]}
            )
        assert parts[0] == parts[1] == parts[2]


def test_a_friction_curve_is_the_level_of_its_law() -> None:
    """Of the original law against eq. (10), of the modified one against eq. (18) with eq. (24)."""
    v, level = friction_curve(
        "lugre",
        {"lugre.sigma0": 8e5, "lugre.Fc": 4.0, "lugre.Fs": 7.2, "lugre.vs": math.radians(25.0)},
    )
    assert v[0] > math.radians(100.0)
    np.testing.assert_allclose(level, 4.0 + 3.2 * np.exp(-((np.degrees(v) / 25.0) ** 2)), rtol=2e-3)
    found = {
        "sigma0": 600.0,
        "sigma1": 800.0,
        "sigma2": 300.0,
        "c": 150.0,
        "tau": 0.01,
        "width": 1.0,
    }
    v, level = friction_curve(
        "modified",
        stiffer({f"modified.{name}": value for name, value in found.items()} | {"b": 6.5}),
    )
    shapes = 8 * np.exp(-((np.degrees(v) / 10) ** 2)) + 3 * np.exp(
        -(((np.degrees(v) - 20) / 20) ** 2)
    )
    np.testing.assert_allclose(level, (6 + shapes) / 1.5, rtol=2e-3)
