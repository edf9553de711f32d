"""Points of behaviour: a good FMU has no finding, and each point finds the mutants that are made
for it.
"""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bristle.common.errors import BristleError
from bristle.fmus.conformance import (
    BEHAVIOUR,
    POINTS,
    PointResult,
    Severity,
    Verdict,
    conformance,
    junit,
    running,
    sarif,
)
from bristle.fmus.conformance.process import Task, judged

sys.path.insert(0, str(Path(__file__).parent))
from mutants import BEHAVIOUR_MUTANTS, good_entries, pack

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the mutants are those of Linux")
ONLY_FMI_3 = {"exchange-adjoint", "exchange-counts", "run-last-time", "run-events", "run-sizes"}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("mutant")
    return {fmi: pack(folder / f"good{fmi}.fmu", good_entries(fmi, folder)) for fmi in (2, 3)}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_good_fmu_has_no_finding(fmi: int, good: dict[int, Path]) -> None:
    results = conformance(good[fmi])
    not_passed = {r.point.id: r for r in results if r.verdict is not Verdict.passed}
    assert {
        name: r.findings
        for name, r in not_passed.items()
        if r.verdict is not Verdict.not_applicable
    } == {}
    assert set(not_passed) == (ONLY_FMI_3 if fmi == 2 else set())
    assert set(BEHAVIOUR) <= {r.point.id for r in results}


@pytest.mark.sampled(4)
def test_each_mutant_is_found_by_the_point_made_for_it(good: dict[int, Path]) -> None:
    rows = judged(
        [Task(good[fmi], point, {"MUTANT": name}) for name, fmi, point in BEHAVIOUR_MUTANTS]
    )
    assert [
        m
        for m, row in zip(BEHAVIOUR_MUTANTS, rows, strict=True)
        if row["verdict"] is not Verdict.failed
    ] == []
    assert all(row["findings"] for row in rows)


def test_every_point_has_a_mutant() -> None:
    assert {point for _, _, point in BEHAVIOUR_MUTANTS} == set(BEHAVIOUR)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("mutant", "words"),
    [
        ("crash", "crashed (SIGABRT) during fmi2DoStep"),
        ("hang", "took longer than 1.5 s during fmi2DoStep"),
    ],
)
def test_a_crash_or_a_hang_is_a_finding(
    mutant: str, words: str, good: dict[int, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "POINT_SECONDS", 1.5)
    [row] = judged([Task(good[2], "run-finite", {"MUTANT": mutant})])
    assert (row["verdict"], row["findings"]) == (Verdict.failed, [words])


@pytest.mark.sampled(4)
def test_points_without_forks(good: dict[int, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows, where each point has a process of its own from the start."""
    monkeypatch.delattr("os.fork")
    monkeypatch.setenv("MUTANT", "start")
    first, second = judged([Task(good[2], "run-starts"), Task(good[2], "run-finite")])
    assert (first["verdict"], second["verdict"]) == (Verdict.failed, Verdict.passed)
    assert first["findings"] == ["k: 3.0 instead of 2"]


def test_what_is_not_claimed_is_not_applicable(good: dict[int, Path], tmp_path: Path) -> None:
    other = tmp_path / "other.fmu"
    with zipfile.ZipFile(good[2]) as old, zipfile.ZipFile(other, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(b' canGetAndSetFMUstate="true"', b""))
    [row] = judged([Task(other, "run-state")])
    assert row["verdict"] is Verdict.not_applicable
    assert "does not claim" in row["findings"][0]


@pytest.mark.sampled(4)
def test_where_its_life_fails_nothing_more_is_tested(
    good: dict[int, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUTANT", "crash")
    results = {r.point.id: r for r in conformance(good[2])}
    assert results["run-life"].findings == ("crashed (SIGABRT) during fmi2DoStep",)
    assert results["run-finite"].verdict is Verdict.not_tested
    assert results["exchange-finite"].verdict is Verdict.passed


def test_model_exchange_alone(good: dict[int, Path], tmp_path: Path) -> None:
    other = tmp_path / "other.fmu"
    with zipfile.ZipFile(good[3]) as old, zipfile.ZipFile(other, "w") as new:
        for name in old.namelist():
            lines = old.read(name).splitlines(keepends=True)
            new.writestr(
                name, b"".join(line for line in lines if not line.startswith(b"<CoSimulation"))
            )
    rows = judged(
        [Task(other, "exchange-finite"), Task(other, "run-finite"), Task(other, "exchange-agrees")]
    )
    assert [row["verdict"] for row in rows] == [
        Verdict.passed,
        Verdict.not_applicable,
        Verdict.not_applicable,
    ]


@pytest.mark.sampled(4)
def test_an_fmu_without_a_library_for_this_machine_is_not_tested(
    good: dict[int, Path], tmp_path: Path
) -> None:
    with zipfile.ZipFile(good[2]) as old:
        entries = {name.replace("linux64", "win64"): old.read(name) for name in old.namelist()}
    results = conformance(pack(tmp_path / "other.fmu", entries))
    assert {r.point.id for r in results if r.verdict is Verdict.not_tested} == set(BEHAVIOUR)


@pytest.fixture
def results(good: dict[int, Path], monkeypatch: pytest.MonkeyPatch) -> list[PointResult]:
    """Results where each point of behaviour fails and no other."""
    rows = [{"id": name, "verdict": Verdict.passed, "findings": []} for name in POINTS]
    rows += [
        {"id": name, "verdict": Verdict.failed, "findings": ["bad \x1b<>"]} for name in BEHAVIOUR
    ]
    monkeypatch.setattr("bristle.fmus.conformance.judgement.examined", lambda path, tell: rows)
    return conformance(good[2])


def test_the_results_as_junit(good: dict[int, Path], results: list[PointResult]) -> None:
    suite = ElementTree.fromstring(junit(good[2], results))
    assert suite.get("failures") == str(len(BEHAVIOUR))
    assert {case.get("name") for case in suite if case.find("failure") is not None} == set(
        BEHAVIOUR
    )


def test_the_results_as_sarif(good: dict[int, Path], results: list[PointResult]) -> None:
    tree = sarif(good[2], results)
    [run] = tree["runs"]
    rules = run["tool"]["driver"]["rules"]
    assert [rules[each["ruleIndex"]]["id"] for each in run["results"]] == list(BEHAVIOUR)
    assert {each["level"] for each in run["results"]} == set(map(str, Severity))
    assert {each["message"]["text"] for each in run["results"]} == {"bad  <>"}
    assert tree["version"] == "2.1.0"


def test_a_file_that_is_no_archive_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "text.fmu").write_text("no")
    with pytest.raises(BristleError, match="not a zip archive"):
        conformance(tmp_path / "text.fmu")
