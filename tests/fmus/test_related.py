"""Files inside an FMU for who gets it: manifest, parameter set, experiment, checksums; by the text
of FMI-LS-REF.
"""

import csv
import hashlib
import posixpath
import re
import zipfile
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu

from bristle.fmus import build

FOLDER = "extra/org.fmi-standard.fmi-ls-ref/"
SPACE = "{http://fmi-standard.org/fmi-ls-manifest}"
ROLES = re.compile(  # of the schema in modelica/fmi-ls-ref
    "(document|requirement|specification|model|parameter|system|testcase|experiment(/(smoke-test|validation|uncertainty-analysis))?"
    "|result|method|rationale|report|request|delivery|configuration|signature|serialized-state(/.*)?|meta-data|other)"
)
CASES = [
    ("plant", {"law": "lugre", "effects": ["cogging"], "parameters": {"J": 0.0012}}),
    ("plant", {"law": "dahl", "fmi": 3}),
    ("observer", {"method": "rls"}),
    ("controller", {"fmi": 3}),
    ("controller", {"kind": "python"}),
    pytest.param(("plant", {}), marks=pytest.mark.slow),
    pytest.param(("observer", {"fmi": 3}), marks=pytest.mark.slow),
]


@pytest.fixture(scope="module", params=CASES, ids=str)
def made(request, tmp_path_factory):
    what, options = request.param
    return build(what, tmp_path_factory.mktemp("related") / "made.fmu", **options)


def content(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.sampled(4)
def test_every_fmu_says_how_it_can_be_tried(made):
    files = content(made)
    root = ET.fromstring(files[FOLDER + "fmi-ls-manifest.xml"])
    assert root.tag == "fmiReferences"
    assert root.get(SPACE + "fmi-ls-name") == "org.fmi-standard.fmi-ls-ref"
    assert (
        root.get(SPACE + "fmi-ls-description")
        == "Layered Standard providing information on related files included in an FMU."
    )
    assert re.fullmatch(r"\d+\.\d+\.\d+(-[\w.]+)?", root.get(SPACE + "fmi-ls-version"))
    related = {each.get("role"): each for each in root}
    assert set(related) == {"parameter", "experiment/smoke-test", "result", "signature"}
    assert all(ROLES.fullmatch(role) for role in related)
    assert all(posixpath.normpath(FOLDER + each.get("source")) in files for each in root)
    one = ET.fromstring(files[FOLDER + related["experiment/smoke-test"].get("source")]).find(
        "Experiment"
    )
    order = [each.tag for each in one]
    assert order == sorted(
        order,
        key=["TransientSimulation", "Parameters", "Stimuli", "References", "Annotations"].index,
    )
    assert {each.get("source") for each in one if each.get("source")} <= {
        n.removeprefix(FOLDER) for n in files
    }
    assert b"fmi-ls-ref.html" in files["documentation/index.html"]
    assert "documentation/fmi-ls-ref.html" in files


def test_checksums_are_those_of_all_other_files(made):
    files = content(made)
    lines = files.pop(FOLDER + "checksums.sha256").decode().splitlines()
    assert lines == [f"{hashlib.sha256(files[name]).hexdigest()}  {name}" for name in sorted(files)]


def test_the_parameter_set_holds_the_start_values(made):
    declared = read_model_description(str(made)).modelVariables
    starts = {
        v.name: float(v.start)
        for v in declared
        if v.causality == "parameter" and v.type in ("Real", "Float64")
    }
    root = ET.fromstring(content(made)[FOLDER + "parameters.ssv"])
    listed = {
        each.get("name"): float(each[0].get("value"))
        for each in root.iter()
        if each.tag.endswith("}Parameter")
    }
    assert listed == starts


def table(data):
    head, *rows = csv.reader(data.decode().splitlines())
    return dict(zip(head, np.array(rows, dtype=float).T, strict=True))


def test_fmpy_meets_the_reference_with_the_stimuli_of_the_file(tmp_path):
    path = build("plant", tmp_path / "plant.fmu", law="lugre")
    files = content(path)
    given, expected = (
        table(files[f"{FOLDER}smoke-test-{name}.csv"]) for name in ("stimuli", "reference")
    )
    rows = np.rec.fromarrays(list(given.values()), names=list(given))
    names = [name for name in expected if name != "time"]
    got = simulate_fmu(
        str(path),
        stop_time=2.0,
        output_interval=1e-3,
        input=rows,
        output=names,
        fmi_type="CoSimulation",
    )
    assert len(names) >= 5
    for name in names:
        assert (
            np.abs(got[name][::20] - expected[name]).max() <= 1e-6 * np.ptp(expected[name]) + 1e-15
        )
        assert np.ptp(expected[name]) > 0


@pytest.mark.slow
def test_an_fmu_for_other_machines_has_no_experiment_and_says_so_in_the_manifest(tmp_path):
    pytest.importorskip("ziglang", reason="ziglang is not installed (bristle[cross])")
    files = content(build("controller", tmp_path / "win.fmu", platforms="win64"))
    roles = [each.get("role") for each in ET.fromstring(files[FOLDER + "fmi-ls-manifest.xml"])]
    assert roles == ["parameter", "signature"]
