"""Points of behaviour: a good FMU has no finding, and each point finds the mutant that is made for it."""

from __future__ import annotations

import re
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bristle.fmus.conformance import BEHAVIOUR, Verdict, behaviour, conformance, junit
from bristle.model.compiler import compile_shared

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the mutants are those of Linux")
SOURCE = (Path(__file__).parent / "mutant.c").read_text(encoding="utf-8")
XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="good" guid="{good}">
<CoSimulation modelIdentifier="good" canGetAndSetFMUstate="true" canHandleVariableCommunicationStepSize="true"/>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.001"/>
<ModelVariables>
<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="k" valueReference="2" causality="parameter" variability="fixed"><Real start="2"/></ScalarVariable>
<ScalarVariable name="y" valueReference="3" causality="output" initial="exact"><Real start="0"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="3"/></Outputs></ModelStructure>
</fmiModelDescription>
"""
MUTANTS = {
    "start": {"run-starts"},
    "nan": {"run-finite"},
    "again": {"run-again", "run-reset", "run-two"},
    "reset": {"run-reset"},
    "state": {"run-state"},
    "shared": {"run-two", "run-again", "run-reset", "run-state"},
    "naninput": {"run-nan"},
    "back": {"run-back"},
    "token": {"run-token"},
    "loud": {"run-quiet"},
    "leak": {"run-memory"},
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from fmpy import platform, sharedLibraryExtension
    from fmpy.fmi2 import FMU2Slave

    folder = tmp_path_factory.mktemp("mutant")
    names = {name for name in dir(FMU2Slave) if name.startswith("fmi2") and "Callback" not in name}
    stubs = "".join(f"E int {n}(void) {{ return 0; }}\n" for n in sorted(names) if not re.search(rf"\b{n}\(", SOURCE))
    compile_shared({"good.c": SOURCE + stubs}, folder / "good.so")
    with zipfile.ZipFile(folder / "good.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", XML)
        archive.writestr("documentation/index.html", "<p>a test</p>")
        archive.write(folder / "good.so", f"binaries/{platform}/good{sharedLibraryExtension}")
    return folder / "good.fmu"


def test_a_good_fmu_has_no_finding(good: Path) -> None:
    results = conformance(good)
    assert {r.point.id: r.findings for r in results if r.verdict is not Verdict.passed} == {}
    assert set(BEHAVIOUR) <= {r.point.id for r in results}


@pytest.mark.parametrize("mutant", list(MUTANTS))
def test_a_mutant_is_found_by_the_point_made_for_it(mutant: str, good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUTANT", mutant)
    for name in MUTANTS[mutant]:
        verdict, findings = behaviour.judged(good, name)
        assert (verdict, bool(findings)) == (Verdict.failed, True), name


def test_every_point_has_a_mutant() -> None:
    assert set().union(*MUTANTS.values()) == set(BEHAVIOUR)


@pytest.mark.parametrize(("mutant", "word"), [("crash", "SIGABRT"), ("hang", "took longer than 1.5 s")])
def test_a_crash_or_a_hang_is_a_finding(mutant: str, word: str, good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUTANT", mutant)
    monkeypatch.setattr(behaviour, "POINT_SECONDS", 1.5)
    verdict, [finding] = behaviour.judged(good, "run-finite")
    assert verdict is Verdict.failed
    assert word in finding


def test_what_is_not_claimed_is_not_applicable(good: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.fmu"
    with zipfile.ZipFile(good) as old, zipfile.ZipFile(other, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(b' canGetAndSetFMUstate="true"', b""))
    verdict, [why] = behaviour.judged(other, "run-state")
    assert verdict is Verdict.not_applicable
    assert "does not claim" in why


def test_the_results_as_junit(good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bristle.fmus.conformance.judgement.judged", lambda path, name: (Verdict.failed, ("bad \x1b<>",)))
    suite = ElementTree.fromstring(junit(good, conformance(good)))
    assert suite.get("failures") == str(len(BEHAVIOUR))
    assert {case.get("name") for case in suite if case.find("failure") is not None} == set(BEHAVIOUR)
