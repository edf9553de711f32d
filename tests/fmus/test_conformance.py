"""Static conformance: a good FMU has no finding, and each point finds what is changed for it."""

import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from bristle.common.errors import BristleError
from bristle.fmus.conformance import POINTS, Verdict, static_conformance

GOOD = (
    '<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="t"><CoSimulation modelIdentifier="m"/>'
    '<UnitDefinitions><Unit name="s"/></UnitDefinitions><DefaultExperiment stopTime="1"/><ModelVariables>'
    '<Float64 name="time" valueReference="0" causality="independent" unit="s"/>'
    '<Float64 name="k" valueReference="1" causality="parameter" start="1" min="0" max="2"/></ModelVariables>'
    "<ModelStructure/></fmiModelDescription>"
)
FILES = {"modelDescription.xml": GOOD, "binaries/x86_64-linux/m.so": "", "documentation/index.html": ""}


def swap(old: str, new: str) -> Callable[[dict[str, str]], None]:
    return lambda files: files.update({"modelDescription.xml": GOOD.replace(old, new)})


def rename(old: str, new: str) -> Callable[[dict[str, str]], None]:
    return lambda files: files.update({new: files.pop(old)})


MUTANTS = [
    ("archive-description", rename("modelDescription.xml", "m/modelDescription.xml")),
    ("archive-description", swap("</ModelVariables>", "")),
    ("archive-paths", rename("documentation/index.html", "../index.html")),
    ("archive-paths", rename("documentation/index.html", "documentation\\index.html")),
    ("archive-documentation", lambda files: files.pop("documentation/index.html")),
    ("archive-binary", rename("binaries/x86_64-linux/m.so", "binaries/x86_64-linux/other.so")),
    ("description-validator", swap("<ModelStructure/>", "")),
    ("description-validator", swap('causality="parameter"', 'causality="output" initial="exact"')),
    ("description-range", swap('max="2"', 'max="two"')),
    ("description-identifier", swap('modelIdentifier="m"', 'modelIdentifier="../m"')),
    ("description-token", swap('"t"', '""')),
    ("description-names", swap('"k"', '"time"')),
    ("description-range", swap('start="1"', 'start="3"')),
    ("description-range", swap('start="1"', 'start="NaN"')),
    ("description-units", swap('unit="s"', 'unit="h"')),
    ("description-experiment", swap(' stopTime="1"', "")),
]


def packed(path: Path, files: dict[str, str], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return path


def failed(path: Path) -> set[str]:
    return {r.point.id for r in static_conformance(path) if r.verdict is Verdict.failed}


def test_good(tmp_path):
    assert failed(packed(tmp_path / "good.fmu", FILES)) == set()


@pytest.mark.parametrize(("name", "change"), MUTANTS)
def test_mutant(tmp_path, name, change):
    files = dict(FILES)
    change(files)
    assert name in failed(packed(tmp_path / "mutant.fmu", files))


def test_packing(tmp_path):
    assert "archive-method" in failed(packed(tmp_path / "lzma.fmu", FILES, zipfile.ZIP_LZMA))
    linked = packed(tmp_path / "linked.fmu", FILES)
    with zipfile.ZipFile(linked, "a") as archive:
        link = zipfile.ZipInfo("resources/link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc")
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("modelDescription.xml", GOOD)
    assert {"archive-links", "archive-twice"} <= failed(linked)


def test_not_tested(tmp_path):
    results = static_conformance(packed(tmp_path / "none.fmu", {"a": ""}))
    assert {r.point.id for r in results if r.verdict is Verdict.not_tested} == {
        p.id for p in POINTS.values() if p.needs_description
    }
    (tmp_path / "text.fmu").write_text("no")
    with pytest.raises(BristleError, match="not a zip archive"):
        static_conformance(tmp_path / "text.fmu")
