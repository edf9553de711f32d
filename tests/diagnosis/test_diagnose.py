"""The whole way from records to a name: what is hidden is named, nothing is not, and neither time
nor order matters.
"""

from __future__ import annotations

import json
import os
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bristle.cli import main as cli
from bristle.diagnosis import Model, diagnose, load_model, records_from_arrays
from bristle.diagnosis.answer import OUTLIERS, Diagnosis
from bristle.diagnosis.modelfile import model_text
from bristle.diagnosis.report.text.said import said as words_of
from bristle.model.native import Native
from bristle.plant.effects import effects
from bristle.plant.servo import servo_program

pytestmark = pytest.mark.long  # the diagnosis that most of them look at


@pytest.fixture(scope="module")
def cogging(case: Callable[..., object]) -> Diagnosis:
    """The diagnosis of two records of 8 s of a servo with cogging."""
    made = case("cogging")
    return diagnose(made.model, made.records)


def plainly(found: Diagnosis) -> dict[str, object]:
    return {key: value for key, value in found.to_dict().items() if key != "seconds"}


def test_what_is_hidden_is_named_with_its_numbers(cogging):
    assert cogging.verdict == "named"
    [effect] = cogging.effects
    assert (effect.name, effect.group) == ("cogging", "cogging")
    for key, value in {"amplitude": 0.08, "periods": 7.0}.items():
        estimate = effect.parameters[key]
        assert estimate.value == pytest.approx(value, rel=0.02)
        assert estimate.ci95[0] < estimate.value < estimate.ci95[1]
        assert estimate.ci95[1] - estimate.ci95[0] < 0.1 * value
    for key, value in {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12}.items():
        assert cogging.parameters[key].value == pytest.approx(value, rel=0.03)
    assert effect.p == 1 / 2000
    assert cogging.ties == ()
    assert not cogging.remains.flag


def test_nothing_is_missing_where_nothing_is_hidden_and_nothing_disturbs():
    """Records that show even the stiffness of the bristles that every model here has: stiffer ones
    are no effect.
    """
    torque, records = np.repeat(np.random.default_rng(4).normal(0, 0.35, (2, 120)), 100, axis=1), []
    for name, each in zip("ab", torque, strict=True):
        u = np.convolve(each, np.ones(50) / 50, "same")
        native = Native(
            servo_program("coulomb", encoder=False),
            {"J": 0.01, "b": 1.0, "a2": 0.02, "coulomb.Fc": 0.1, "u_max": 1e6},
        )
        theta = native.run(1e-3, {"u": u}, ["theta"])[0][:-1, 0]
        records.append((name, 1e-3 * np.arange(len(u)), u, np.floor(theta / 3.8e-4) * 3.8e-4))
    position = {"column": "y", "kind": "position", "unit": "rad"}
    input_ = {"column": "u", "kind": "torque", "unit": "N.m"}
    nominal = {"J": 0.011, "a2": 0.018, "Fc": 0.09}
    tree = {
        "friction": "coulomb",
        "parameters": nominal,
        "time": {"column": "t", "unit": "s"},
        "input": input_,
        "output": position,
    }
    model = Model.from_dict(tree)
    found = diagnose(model, records_from_arrays(model, records))
    assert (found.verdict, found.effects, found.remains.flag) == ("none", (), False)


def test_the_gap_shrinks_on_segments_that_were_kept_from_the_search(cogging):
    gap = cogging.gap
    assert gap.before > 50 * gap.after
    assert gap.after < 1.3 * gap.noise_floor
    assert gap.shrink > 0.99
    held = np.concatenate([trace.held_out for trace in cogging.traces])
    assert 0.1 < held.mean() < 0.4
    errors = [
        np.concatenate([t.measured - getattr(t, when) for t in cogging.traces])[held]
        for when in ("before", "after")
    ]
    assert np.mean(errors[0] ** 2) > 20 * np.mean(errors[1] ** 2)


def test_it_reports_the_view_of_the_gap(cogging):
    # which are off depends on where it went
    strongest = next(view for view in cogging.where if view.view != OUTLIERS)
    assert strongest.view == "theta"
    assert words_of(strongest.label) == "7 in a turn"
    assert strongest.p <= 0.01
    assert strongest.share > 0.3
    assert strongest.share_after < 0.1


def test_the_effects_that_were_not_found_have_a_limit_or_a_reason(cogging):
    assert cogging.undetected.keys() == effects().keys() - {"cogging"}
    assert all(cogging.undetected.values())


def test_the_same_records_give_the_same_answer(case, cogging):
    made = case("cogging")
    assert plainly(diagnose(made.model, made.records)) == plainly(cogging)


def test_the_order_of_the_records_changes_no_name(case, cogging):
    made = case("cogging")
    found = diagnose(made.model, made.records[::-1])
    assert [effect.name for effect in found.effects] == ["cogging"]
    for key, estimate in found.effects[0].parameters.items():
        low, high = cogging.effects[0].parameters[key].ci95
        assert low <= estimate.value <= high, key


def test_nothing_is_named_where_nothing_is_hidden(case):
    made = case(None)
    found = diagnose(made.model, made.records)
    assert found.verdict == "none"
    assert (found.effects, found.ties, found.remains.flag) == ((), (), False)
    assert found.gap.ratio < 1.5
    for key, value in {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12}.items():
        assert found.base[key].value == pytest.approx(value, rel=0.02)
        assert not found.base[key].at_bound


def test_an_effect_that_the_model_has_is_not_found_again(case, cogging):
    made = case("cogging")
    own = {name: float(estimate.value) for name, estimate in cogging.effects[0].parameters.items()}
    found = diagnose(replace(made.model, effects={"cogging": own}), made.records)
    assert (found.verdict, found.effects) == ("none", ())
    assert "cogging" not in found.undetected


def files_of(made: Any, folder: Path) -> list[str]:
    """Write the model and the records of a case; return the arguments of a diagnosis of them."""
    model = folder / "model.toml"
    model.write_text(model_text(made.model), encoding="utf-8")
    arguments = [str(model)]
    for record in made.records:
        path = folder / f"{record.name}.npz"
        np.savez(path, t=record.time, u=record.u, theta=record.y)
        arguments += ["--data", str(path)]
    return arguments


def test_the_command_line_writes_all_files_or_none(
    case: Callable[..., Any],
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    search_among: Callable[..., None],
) -> None:
    """Older files stay until all new ones are complete; what was named is in all of them."""
    search_among("cogging", "gravity", "bias", "stribeck", "position_friction")
    out, move, ready = tmp_path / "out", os.replace, []
    out.mkdir()
    (out / "diagnosis.json").write_text("older")

    def watched(source: str | Path, target: str | Path) -> None:
        if not ready and out in Path(source).parents:
            assert (out / "diagnosis.json").read_text() == "older"
            ready.extend(path.name for path in out.glob(".*/new/*") if path.stat().st_size > 100)
        move(source, target)

    monkeypatch.setattr(os, "replace", watched)
    arguments = files_of(case("cogging"), tmp_path_factory.mktemp("given"))
    monkeypatch.setattr(sys, "argv", ["bristle", "diagnose", *arguments, "--out", str(out)])
    with pytest.raises(SystemExit) as done:
        cli.main()
    assert done.value.code == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert said.out.splitlines()[-1] == f"named  {out / 'report.html'}"
    written = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    always = {"diagnosis.json", "report.html", "augmented.toml", "augmented.fmu"}
    assert always <= written <= always | {"correction.fmu"}
    assert set(ready) == written

    content = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    [effect] = content["effects"]
    assert content["verdict"] == "named"
    assert content["gap"]["shrink"] > 0.9
    assert effect["name"] in (out / "report.html").read_text(encoding="utf-8")
    tree = tomllib.loads((out / "augmented.toml").read_text(encoding="utf-8"))
    model = load_model(out / "augmented.toml")
    assert list(model.effects) == list(tree["effects"]) == [effect["name"]]
    for key, estimate in effect["parameters"].items():
        assert model.effects[effect["name"]][key] == pytest.approx(estimate["value"], rel=1e-12)
    assert (out / "report.html").read_text(encoding="utf-8").rstrip().endswith("</html>")
