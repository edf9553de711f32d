"""Scenarios with a hidden effect: nothing but the sealed answers says what is hidden, and the
scorer counts what it should.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
import shutil
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from bristle.diagnosis import load_model, load_records
from bristle.harness.scenario.catalogue import scenarios
from bristle.plant.effects import effects

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = tomllib.loads((Path(__file__).parents[1] / "shipped.toml").read_text(encoding="utf-8"))[
    "effects"
]
HIDDEN = ROOT / "scenarios" / "hidden"
CASES = sorted(path for path in HIDDEN.iterdir() if path.is_dir())
NEEDED = {"torque"}  # the name of a parameter too, but every model says what its input is


@pytest.fixture(scope="module")
def scorer() -> ModuleType:
    """The program benchmarks/hidden.py."""
    spec = importlib.util.spec_from_file_location(
        "bristle_benchmarks_hidden", ROOT / "benchmarks" / "hidden.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def answers(scorer: ModuleType) -> dict[str, Any]:
    found: dict[str, Any] = scorer.open_answers()
    return found


def blank(text: str) -> str:
    """Return a model file without its numbers."""
    return re.sub(r"(?<![\w])\d[\d.e+-]*", "0", text)


def forbidden() -> set[str]:
    """Return the names of all effects and of their parameters."""
    parameters = {
        p.name.removeprefix(f"{name}.") for name in SHIPPED for p in effects()[name].parameters
    }
    return {*SHIPPED, *parameters} - NEEDED


def test_the_seal_is_intact_and_a_changed_answer_breaks_it(
    scorer: ModuleType, tmp_path: Path
) -> None:
    assert not scorer.broken()
    for name in (scorer.SEALED, scorer.DIGEST):
        shutil.copy(HIDDEN / name, tmp_path)
    sealed = tmp_path / scorer.SEALED
    sealed.write_bytes(sealed.read_bytes().replace(b"A", b"B", 1))
    assert scorer.broken(tmp_path)
    with pytest.raises(ValueError, match="does not match its hash"):
        scorer.open_answers(tmp_path)


def test_every_effect_is_hidden_in_some_case(answers: dict[str, Any]) -> None:
    assert sorted(answers) == [folder.name for folder in CASES]
    single = [
        e["name"]
        for answer in answers.values()
        if answer["kind"] == "single"
        for e in answer["effects"]
    ]
    # records have no column of a temperature
    assert sorted(single) == sorted(set(SHIPPED) - {"temperature_friction"})
    kinds = [answer["kind"] for answer in answers.values()]
    assert [kinds.count(kind) for kind in ("control", "outside", "pair")] == [2, 1, 1]


def test_no_text_beside_the_answers_names_an_effect_or_a_parameter(scorer: ModuleType) -> None:
    names = forbidden()
    assert {"gravity", "amplitude", "stiffness"} <= names
    for path in HIDDEN.rglob("*"):
        texts = [str(path.relative_to(HIDDEN))]
        if path.suffix in (".toml", ".md", ".sha256"):
            texts.append(path.read_text(encoding="utf-8"))
        else:
            assert path.is_dir() or path.suffix == ".npz" or path.name == scorer.SEALED, path
        for text in texts:
            assert not names & set(re.findall(r"[a-z0-9_]+", text.lower())), path
    for name in SHIPPED:
        assert name.encode() not in (HIDDEN / scorer.SEALED).read_bytes()


def test_models_differ_in_numbers_only(answers: dict[str, Any]) -> None:
    """All the same, but for a few with a current for an input, which were drawn apart from the
    effects.
    """
    texts = [blank((folder / "model.toml").read_text(encoding="utf-8")) for folder in CASES]
    kinds = {text: tomllib.loads(text)["input"]["kind"] for text in set(texts)}
    assert sorted(kinds.values()) == ["current", "torque"]
    assert sum(kinds[text] == "current" for text in texts) == 4
    for folder in CASES:
        assert sorted(path.name for path in folder.iterdir()) == ["a.npz", "b.npz", "model.toml"]


def test_records_have_the_same_columns_everywhere() -> None:
    begins = {"a": 0, "b": 25_000}
    for folder in CASES:
        for name, begin in begins.items():
            with np.load(folder / f"{name}.npz") as record:
                assert {key: record[key].dtype.str for key in record.files} == {
                    "t": "<i4",
                    "u": "<f4",
                    "theta": "<i4",
                }
                assert all(record[key].shape == (20_000,) for key in record.files)
                np.testing.assert_array_equal(record["t"], begin + np.arange(20_000))


@pytest.mark.parametrize("folder", CASES, ids=lambda folder: folder.name)
def test_the_intake_accepts_every_case_without_a_message(folder: Path) -> None:
    model = load_model(folder / "model.toml")
    records = load_records(model, [folder / "a.npz", folder / "b.npz"])
    assert [record.findings for record in records] == [(), ()]
    assert [record.h for record in records] == pytest.approx([1e-3, 1e-3])
    assert model.resolution == pytest.approx(2 * np.pi / 16384)


def test_hidden_cases_are_no_scenarios_to_run() -> None:
    assert set(scenarios()) == {path.stem for path in (ROOT / "scenarios").glob("*.toml")}


def result(verdict: str, *names: str, flag: bool = False) -> dict[str, Any]:
    effects = [{"name": name} for name in names]
    return {
        "verdict": verdict,
        "effects": effects,
        "ties": [["bias", "gravity"]],
        "remains": {"flag": flag},
    }


@pytest.mark.parametrize(
    ("kind", "truth", "answer", "right"),
    [
        ("single", ["gravity"], result("named", "gravity"), "yes"),
        ("single", ["gravity"], result("named", "gravity", "bias"), "no"),
        ("single", ["gravity"], result("tie"), "no"),
        ("single", ["bias"], result("named", "asymmetric_coulomb"), "class"),
        ("single", ["back_emf"], result("none"), "yes"),
        ("single", ["back_emf"], result("named", "back_emf"), "no"),
        ("control", [], result("none"), "yes"),
        ("control", [], result("tie"), "no"),
        ("outside", [], result("none", flag=True), "yes"),
        ("outside", [], result("none"), "no"),
        ("outside", [], result("named", "bias", flag=True), "no"),
        ("pair", ["bias", "gravity"], result("named", "gravity", "bias"), "yes"),
        ("pair", ["bias", "gravity"], result("named", "gravity"), "no"),
        ("single", ["gravity"], {"verdict": "error", "effects": [], "ties": []}, "no"),
    ],
)
def test_what_counts_as_right(
    scorer: ModuleType, kind: str, truth: list[str], answer: dict[str, Any], right: str
) -> None:
    class_of = importlib.import_module("forms").class_of  # on the path since the scorer is
    hidden = {"kind": kind, "effects": [{"name": name, "class": class_of(name)} for name in truth]}
    assert scorer.right(hidden, answer) == right


@pytest.mark.parametrize("what", ["gravity", "noise_only"])
@pytest.mark.long
def test_a_case_is_diagnosed_and_scored(
    scorer: ModuleType, answers: dict[str, Any], tmp_path: Path, what: str
) -> None:
    [name] = [
        n
        for n, a in answers.items()
        if a["variant"] == what or [e["name"] for e in a["effects"]] == [what]
    ]
    found = scorer.diagnosed(HIDDEN / name, tmp_path)
    assert scorer.right(answers[name], found) == "yes"
    text = scorer.table(answers, {name: found})
    assert f"| {name} |" in text
    assert text.endswith("1 of 1 right, 0 of them by class only.\n")
