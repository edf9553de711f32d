"""A scenario from file to folder."""

from __future__ import annotations

import hashlib
import json
import math
import re
import shlex
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from bristle.harness.metrics import checks
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import FinishedRun, run

Maker = Callable[..., Path]
pytestmark = pytest.mark.usefixtures("no_leftovers")


class Page(HTMLParser):
    """Collects what a page would load, where it links to, and what it says."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in ("link", "iframe")
        self.loads += [value or "" for name, value in attrs if name == "src"]
        self.links += [value or "" for name, value in attrs if name == "href"]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    folder = tmp_path_factory.mktemp("whole")
    path = folder / "whole.toml"
    path.write_text("""
title = "A title with <angle brackets> & more"
shows = "What it shows."
source = "dixit2008 eq. (3)"
limits = "Short."
duration = "6 s"
[plant]
law = "modified"
[observer]
method = "rls"
[validation]
seed = 3
duration = "4 s"
[[stimuli]]
variable = "load_scale"
points = [["0 s", 1.0], ["4 s", 1.02]]
[[checks]]
quantity = "estimates.b.error_percent"
max_abs = 50
[[checks]]
name = "baseline is worse than the floor"
quantity = "validation.floor_mse_percent"
max = 50
""")
    return run(path, folder / "out")


@pytest.mark.sampled(4)
@pytest.mark.usefixtures("undrawn")
def test_every_number_that_a_check_may_demand_is_documented(finished: FinishedRun) -> None:
    """The numbers of result.json, with names of parameters, states and fitted models generalised,
    are those of the table.
    """
    result = json.loads((finished.folder / "result.json").read_text())

    def paths(node: object, path: str) -> Iterator[str]:
        if isinstance(node, dict):
            for key, value in node.items():
                yield from paths(value, f"{path}.{key}" if path else key)
        elif isinstance(node, (int, float)) and ".parameters." not in path:
            yield path

    found = {re.sub(r"^estimates\.\w+", "estimates.PARAMETER", path) for path in paths(result, "")}
    found = {re.sub(r"^states\.\w+", "states.STATE", path) for path in found}
    found = {
        re.sub(r"(?<=[._])(linear|coulomb|floor)(?=_mse|$|\.)", "BASELINE", path) for path in found
    }
    # known only when the checks are done, or no result
    other = ("timing.", "wall_s", "provenance.")
    found = {path for path in found if not path.startswith(other)}
    given_by_some = {"record.samples", "innovation", "estimates.PARAMETER.sd"}
    # test_tracking.py
    given_by_some |= {path for path in checks.CHECK_QUANTITIES if path.startswith("tracking.")}
    # test_behaviour.py
    given_by_some |= {path for path in checks.CHECK_QUANTITIES if path.startswith("behaviour.")}
    assert found | given_by_some == set(checks.CHECK_QUANTITIES)
    demanded = {path for path in paths(result, "") if not path.startswith(other)}
    assert demanded <= set(
        checks.check_quantities(list(result["estimates"]), ["linear", "coulomb", "floor"])
    )


@pytest.mark.parametrize(
    ("path", "unit"),
    [
        ("estimates.b.settling_s", "s"),
        ("estimates.b.final", "rad/(s2.V)"),
        ("states.v.rms", "rad/s"),
        ("tracking_rms", "rad/s"),
        ("validation.linear_mse_percent", "%"),
        ("validation.mse_over_floor", "1"),
        ("estimates.none.final", "1"),
        ("nothing", "1"),
    ],
)
def test_the_unit_of_a_check_is_known(finished: FinishedRun, path: str, unit: str) -> None:
    assert checks.check_unit(finished.result, path) == unit


def test_result_json_keeps_the_contract(finished: FinishedRun) -> None:
    result = json.loads((finished.folder / "result.json").read_text())
    assert result["scenario"] == "whole"
    assert result["verdict"] == "pass"
    assert result["steps"] == 6000
    assert result["wall_s"] > 0
    assert set(result["estimates"]) >= {"alpha2", "b", "Fc"}
    assert {
        "unit",
        "true",
        "final",
        "sd",
        "valid",
        "adapted",
        "error_percent",
        "settling_s",
    } <= set(result["estimates"]["b"])
    assert set(result["provenance"]) == {
        "version",
        "date",
        "platform",
        "folder",
        "scenario_sha256",
        "seed",
        "command",
    }
    assert {"mse_percent", "linear_mse_percent", "coulomb_mse_percent", "floor_mse_percent"} <= set(
        result["validation"]
    )
    assert {"name", "value", "limit", "pass"} <= set(result["checks"][0])
    assert set(result["fmus"]) == {"plant", "controller", "observer"}
    assert {"file", "sha256", "fmi", "kind"} == set(result["fmus"]["plant"])
    assert sum(result["timing"].values()) == pytest.approx(result["wall_s"], rel=0.01)


@pytest.mark.usefixtures("undrawn")
def test_provenance_repeats_the_run(base: str, scenario_file: Maker, tmp_path: Path) -> None:
    path, overrides = scenario_file(base), ["plant.parameters.J=0.002 kg.m2", "duration=1 s"]
    before = datetime.now(UTC).replace(microsecond=0)
    found = run(path, tmp_path / "out", RunOptions(seed=4, overrides=overrides, fmi=3)).result[
        "provenance"
    ]
    assert before <= datetime.fromisoformat(found["date"]) <= datetime.now(UTC)
    assert found["scenario_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert found["seed"] == 4
    words = shlex.split(found["command"])
    assert words[:3] == ["bristle", "run", str(path)]
    assert [words[i + 1] for i, word in enumerate(words) if word == "--set"] == overrides
    assert " ".join(words[3:7]) == f"--out {tmp_path / 'out'} --kind native"
    assert words[-2:] == ["--seed", "4"]
    assert run(path, tmp_path / "out").result["provenance"]["seed"] == 1


@pytest.mark.usefixtures("undrawn")
def test_a_relative_command_repeats_the_run_from_its_folder(
    base: str, scenario_file: Maker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = scenario_file(base)
    monkeypatch.chdir(path.parent)
    done = run(Path(path.name), Path("out"), RunOptions(overrides=["duration=1 s"]))
    found = done.result["provenance"]
    words = shlex.split(found["command"])
    assert Path(found["folder"], words[2]) == path
    assert Path(found["folder"], words[4]) == path.parent / "out"
    assert path.parent.name in (done.folder / "report.html").read_text()


def test_the_truth_grows_with_the_load(finished: FinishedRun) -> None:
    estimates = finished.result["estimates"]
    assert estimates["Fc"]["true"] == pytest.approx(4.0 * 1.02)
    assert estimates["alpha2"]["true"] == pytest.approx(2.0)


@pytest.mark.usefixtures("undrawn")
def test_state_errors_pair_an_estimate_with_the_sample_before(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    """What is published at t_k+1 estimates t_k; paired with t_k+1 the error of v would be what v
    moves in a sample.
    """
    done = run(
        scenario_file(base), tmp_path / "out", RunOptions(full=True, overrides=["duration=20 s"])
    )
    names = (done.folder / "signals.csv").read_text().partition("\n")[0].split(",")
    table = np.loadtxt(done.folder / "signals.csv", delimiter=",", skiprows=1)
    v, v_hat = table[:, names.index("v")], table[:, names.index("v_hat")]
    error = done.result["states"]["v"]["late_rms"]
    assert error == pytest.approx(np.sqrt(np.mean((v_hat[1:] - v[:-1])[-2000:] ** 2)), rel=1e-6)
    assert error < 0.2 * np.sqrt(np.mean((v_hat - v)[-2000:] ** 2))


def test_signals_csv_is_numbers_under_names(finished: FinishedRun) -> None:
    lines = (finished.folder / "signals.csv").read_text().splitlines()
    names = lines[0].split(",")
    assert names[0] == "time"
    assert {"u", "reference", "theta", "v", "load_scale", "v_hat", "b_hat"} <= set(names)
    table = np.array([[float(x) for x in line.split(",")] for line in lines[1:]])
    assert table.shape == (2000, len(names))
    assert table[-1, 0] == pytest.approx(6.0)
    load = table[:, names.index("load_scale")]
    assert (load[table[:, 0] < 4].max(), load[table[:, 0] >= 4].min()) == (1.0, 1.02)


def test_report_is_one_self_contained_file(finished: FinishedRun) -> None:
    text = (finished.folder / "report.html").read_text()
    page = Page(text)
    assert page.loads
    assert all(source.startswith("data:") for source in page.loads)
    names = {path.name for path in finished.folder.iterdir()} - {"report.html"}
    assert names == {link for link in page.links if not link.startswith("#")}
    assert all(f' id="{link[1:]}"' in text for link in page.links if link.startswith("#"))
    assert "<angle brackets>" not in text
    words = " ".join(page.words)
    for word in (
        "A title with <angle brackets> & more",
        "What it shows.",
        "viscous friction over inertia",
        "largest change from the first value, %",
        "rms error in the last tenth of the run",
        "does not show the largest initial excursions",
        "baseline is worse than the floor",
        "viscous + Coulomb",
        "pass",
    ):
        assert word in words
    for sha in (fmu["sha256"] for fmu in finished.result["fmus"].values()):
        assert sha in words
    checks = finished.result["checks"]
    tally = f"{sum(check['pass'] for check in checks)} of {len(checks)} checks"
    assert page.words.index(tally) < page.words.index("A title with <angle brackets> & more ")
    for name in ("estimates", "signals", "friction", "validation", "models"):
        assert (finished.folder / f"{name}.svg").read_text().startswith("<svg")


def test_the_report_takes_little_time(finished: FinishedRun) -> None:
    assert finished.result["timing"]["report"] < 5.0  # 1 s on a quiet machine


@pytest.mark.sampled(4)
def test_full_rate_on_request(base: str, scenario_file: Maker, tmp_path: Path) -> None:
    done = run(
        scenario_file(base), tmp_path / "out", RunOptions(full=True, overrides=["duration=3 s"])
    )
    assert len((done.folder / "signals.csv").read_text().splitlines()) == 3002


@pytest.mark.usefixtures("undrawn")
def test_a_seed_changes_the_reference_and_nothing_else_does(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    path = scenario_file(base)
    texts = [
        (run(path, tmp_path / "out", RunOptions(seed=seed)).folder / "signals.csv").read_text()
        for seed in (1, 1, 2)
    ]
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


def test_an_observer_that_diverges_fails_with_the_time(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    wrong = '[observer.parameters]\nbesancon.alpha2 = "1e6 1/s"\n\n[[checks]]'
    text = (
        base.replace("bastin_gevers", "besancon")
        .replace("[[checks]]", wrong)
        .replace("estimates.b.error_percent", "steps")
    )
    done = run(scenario_file(text), tmp_path / "out")
    result = json.loads((done.folder / "result.json").read_text())
    assert result["verdict"] == "fail"
    assert result["diverged"]["fmu"] == "observer"
    assert 0 < result["diverged"]["time_s"] < 2
    assert result["steps"] == round(result["diverged"]["time_s"] * 1000)
    assert "The run ended" in (done.folder / "report.html").read_text()


@pytest.mark.usefixtures("undrawn")
def test_a_missing_quantity_fails(base: str, scenario_file: Maker, tmp_path: Path) -> None:
    path = scenario_file(base.replace("estimates.b.", "estimates.Fc."))
    done = run(path, tmp_path / "out", RunOptions(overrides=["plant.law=viscous"]))
    assert not done.passed
    assert math.isnan(done.result["checks"][0]["value"])


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("fault", ["none", "error"])
def test_a_foreign_plant_takes_part(
    fault: str, tiny_fmu: Maker, base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    plant = f'fmu = "{tiny_fmu(fault)}"\n[plant.parameters]\ngain = 6.0'
    done = run(
        scenario_file(
            base.replace('law = "modified"\n\n[plant.parameters]\nJ = "0.001 kg.m2"', plant)
        ),
        tmp_path / "out",
    )
    assert done.result["estimates"]["b"]["true"] is None
    if fault == "none":
        assert done.result["fmus"]["plant"]["file"] == "none.fmu"
        assert done.result["steps"] == 2000
    else:
        assert done.result["diverged"]["fmu"] == "plant"
        assert not done.passed


def test_a_plant_without_friction_has_no_friction_truth(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    done = run(scenario_file(base), tmp_path / "out", RunOptions(overrides=["plant.law=viscous"]))
    assert done.result["estimates"]["Fc"]["true"] is None
    assert done.result["estimates"]["b"]["true"] == pytest.approx(6.5)
