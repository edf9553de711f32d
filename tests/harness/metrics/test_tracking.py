"""Compensation in a scenario: what reaches the controller, and the comparison with the controller
alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bristle.fmus.host import Fmu
from bristle.harness.cosim.loop import simulate
from bristle.harness.metrics.checks import CHECK_QUANTITIES
from bristle.harness.metrics.tracking import TRACKING_SHARE, tracking
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import run
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.plan import identification, prepare, uncompensated
from bristle.harness.scenario.reading import load

Maker = Callable[..., Path]
Message = Callable[[Callable[[], object]], str]

COMPENSATED = ["controller.compensation=valid", "observer.method=rls", "sensor=encoder"]
SLOW = (
    '[[stimuli]]\nvariable = "reference_scale"\npoints = [["0 s", 1.0], ["8 s", 0.125]]\n[[checks]]'
)
BETTER = '[[checks]]\nquantity = "tracking.ratio"\nmax = 0.5\n'


@pytest.mark.sampled(4)
def test_a_scenario_is_compared_with_the_controller_alone(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    """The rms of both runs follow from their signals, the second is the scenario without the key,
    and the check can fail.
    """
    path = scenario_file(base.replace("[[checks]]", SLOW) + BETTER)
    options = RunOptions(full=True, overrides=["duration=20 s", *COMPENSATED])
    done = run(path, tmp_path / "out", options)
    other = ["duration=20 s", *COMPENSATED[1:], "checks.1.quantity=steps", "checks.1.max=1e9"]
    plain = run(path, tmp_path / "plain", RunOptions(full=True, overrides=other))
    rms = {}
    for name, each in (("rms", done), ("rms_without", plain)):
        names = (each.folder / "signals.csv").read_text().partition("\n")[0].split(",")
        table = np.loadtxt(each.folder / "signals.csv", delimiter=",", skiprows=1)
        error = (table[:, names.index("reference")] - table[:, names.index("v")])[
            -round(TRACKING_SHARE * 20_000) :
        ]
        rms[name] = np.sqrt(np.mean(error**2))
    found = json.loads((done.folder / "result.json").read_text())["tracking"]
    assert {name: found[name] for name in rms} == pytest.approx(rms, rel=1e-6)
    assert {f"tracking.{name}" for name in found} == {
        path for path in CHECK_QUANTITIES if path.startswith("tracking.")
    }
    assert found["ratio"] == pytest.approx(found["rms"] / found["rms_without"])
    assert found["from_s"] == pytest.approx(15.0, abs=2e-3)
    assert found["ratio"] < 0.5
    assert done.passed
    assert "tracking" not in plain.result
    assert (done.folder / "tracking.svg").exists()
    assert "Tracking with compensation" in (done.folder / "report.html").read_text()


def test_estimates_and_their_validity_are_linked(base: str, scenario_file: Maker) -> None:
    loaded = load(scenario_file(base), COMPENSATED)
    setup = prepare(loaded, build_fmus(loaded))
    links = identification(setup).links
    for name in ("b_hat", "b_valid", "Fc_hat", "load_valid"):
        assert (("observer", name), ("controller", name)) in links
    assert not [
        link for link in uncompensated(setup).links if "observer" in (link[0][0], link[1][0])
    ]


def test_estimates_on_trial_count_from_their_first_adaptation(
    base: str, scenario_file: Maker
) -> None:
    loaded = load(scenario_file(base), [*COMPENSATED, "controller.compensation=adapted"])
    links = identification(prepare(loaded, build_fmus(loaded))).links
    assert (("observer", "adapted"), ("controller", "b_valid")) in links
    assert (("observer", "b_valid"), ("controller", "b_valid")) not in links


def test_without_valid_estimates_nothing_changes(base: str, scenario_file: Maker) -> None:
    """Before the filter has started, both runs are the same to the last digit."""
    loaded = load(
        scenario_file(base), [*COMPENSATED, "observer.method=self_starting_ekf", "duration=0.5 s"]
    )
    setup = prepare(loaded, build_fmus(loaded))
    found = tracking(simulate(identification(setup)), simulate(uncompensated(setup)))
    assert np.array_equal(found.compensated, found.alone)
    assert found.as_dict()["ratio"] == 1.0


def test_a_check_of_tracking_needs_compensation(
    base: str, scenario_file: Maker, tmp_path: Path, message: Message
) -> None:
    path = scenario_file(base + BETTER)
    line = message(lambda: run(path, tmp_path / "out"))
    assert "checks[1].quantity" in line
    assert "no compensation" in line


def test_a_controller_without_inputs_for_estimates_is_refused(
    base: str, scenario_file: Maker, message: Message
) -> None:
    loaded = load(scenario_file(base), COMPENSATED)
    fmus = build_fmus(loaded)
    poor = Fmu(fmus["controller"].path)
    poor.variables = {name: v for name, v in poor.variables.items() if not name.endswith("_hat")}
    line = message(lambda: prepare(loaded, fmus | {"controller": poor}))
    assert 'controller.compensation = "valid"' in line
    assert "no input P_hat" in line


@pytest.mark.slow
def test_the_shipped_scenario_passes_and_can_fail(tmp_path: Path) -> None:
    path = Path(__file__).parents[3] / "scenarios" / "compensation.toml"
    assert run(path, tmp_path / "good").passed
    assert not run(
        path, tmp_path / "bad", RunOptions(overrides=["controller.parameters.fade=1000 s"])
    ).passed
