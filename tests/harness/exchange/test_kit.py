"""A scenario as one file: exported, replayed with the same digits, found out when it is changed,
and read from others.
"""

import csv
import json
import zipfile
from importlib.resources import files

import numpy as np
import pytest
from lxml import etree

from bristle.common.errors import BristleError
from bristle.fmus import obtain
from bristle.harness.exchange.experiment import repeat
from bristle.harness.exchange.kit import REFERENCE_SIGNALS, export
from bristle.harness.exchange.kit_replay import replay
from bristle.harness.exchange.ssp import (
    CSV_TYPE,
    Component,
    SystemPackage,
    SystemStructure,
    package_files,
)
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import run

SCENARIO = """
duration = "2 s"
sensor = "encoder"
[plant]
law = "lugre"
effects = ["cogging"]
[plant.parameters]
J = "0.0012 kg.m2"
"lugre.Fc" = "0.003 N.m"
[controller.parameters]
seed = 3
[observer]
method = "rls"
[[stimuli]]
variable = "tau_load"
points = [["0 s", "0 N.m"], ["1 s", "0.001 N.m"]]
sine = { amplitude = "0.0005 N.m", frequency = "3 Hz" }
[[checks]]
quantity = "estimates.b.error_percent"
max_abs = 50.0
"""


@pytest.fixture(scope="module")
def kit(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kit")
    (folder / "axis.toml").write_text(SCENARIO, encoding="utf-8")
    export(folder / "axis.toml", folder / "out")
    return folder


def table(text):
    head, *rows = csv.reader(text.splitlines())
    return dict(zip(head, np.array(rows, dtype=float).T, strict=True))


@pytest.mark.sampled(4)
def test_what_is_exported_is_the_run_of_the_scenario(kit):
    reference = table((kit / "out" / "reference" / "signals.csv").read_text(encoding="utf-8"))
    done = run(kit / "axis.toml", kit / "run", RunOptions(full=True))
    signals = table((done.folder / "signals.csv").read_text(encoding="utf-8"))
    for name, own in (
        ("plant.theta_enc", None),
        ("plant.theta", "theta"),
        ("plant.v", "v"),
        ("observer.b_hat", "b_hat"),
    ):
        if own is not None:
            np.testing.assert_allclose(reference[name], signals[own], rtol=1e-9, atol=1e-9)
        assert np.ptp(reference[name]) > 0
    verdict = json.loads((kit / "out" / "reference" / "verdict.json").read_text(encoding="utf-8"))
    assert verdict["verdict"] == done.result["verdict"]
    assert (
        verdict["checks"]
        == json.loads((done.folder / "result.json").read_text(encoding="utf-8"))["checks"]
    )
    # which name folders of this machine
    assert not {"command", "folder"} & set(verdict["provenance"])
    page = (kit / "out" / "README.md").read_text(encoding="utf-8")
    assert "| controller.u | plant.u |" in page
    assert "| plant.theta_enc | observer.y_theta |" in page


def test_the_files_are_valid_by_the_schemas_of_the_standard(kit):
    schemas = files("fmpy") / "ssp" / "schema"
    package = SystemPackage(kit / "out" / "axis.ssp")
    for name, schema in (
        ("SystemStructure.ssd", "Description"),
        ("resources/plant.ssv", "ParameterValues"),
    ):
        rules = etree.XMLSchema(etree.parse(str(schemas / f"SystemStructure{schema}.xsd")))
        tree = etree.fromstring(package.read(name))
        rules.assertValid(tree)
        tree[0].set("strange", "1")
        assert not rules.validate(tree)


def test_the_fmus_have_the_parameters_of_the_scenario_as_start_values(kit):
    from fmpy import read_model_description

    starts = {
        v.name: v.start
        for v in read_model_description(str(kit / "out" / "fmus" / "plant.fmu")).modelVariables
    }
    assert (float(starts["J"]), float(starts["lugre.Fc"])) == (0.0012, 0.003)
    assert "cogging.amplitude" in starts
    assert not any(name.startswith("gms.") for name in starts)  # of the one law alone
    package = SystemPackage(kit / "out" / "axis.ssp")
    plant = next(each for each in package.system.components if each.name == "plant")
    assert plant.values["J"] == 0.0012
    assert (package.system.step, package.system.stop) == (1e-3, 2.0)


@pytest.mark.sampled(4)
def test_a_replay_agrees_to_the_last_digits_and_a_changed_package_does_not(kit, changed):
    package = kit / "out" / "axis.ssp"
    done = replay(package, kit / "again")
    assert done.passed
    assert max(each.worst for each in done.agreement) < 1e-12
    result = json.loads((done.folder / "result.json").read_text(encoding="utf-8"))
    assert (result["verdict"], result["recorded"]["scenario"]) == ("pass", "axis")

    def heavier(name, content):
        return (
            content.replace(b'value="0.0012"', b'value="0.0013"')
            if name.endswith("plant.ssv")
            else content
        )

    other = replay(changed(package, kit / "heavier.ssp", heavier), kit / "again")
    assert not other.passed
    assert {each.name: each.holds for each in other.agreement}["plant.v"] is False

    def bent(name, content):
        if name != REFERENCE_SIGNALS:
            return content
        lines = content.decode().splitlines()
        cells = lines[700].split(",")
        lines[700] = ",".join([cells[0], repr(float(cells[1]) + 1e-3), *cells[2:]])
        return "\n".join(lines).encode()

    [bad] = [
        each
        for each in replay(changed(package, kit / "bent.ssp", bent), kit / "again").agreement
        if not each.holds
    ]
    assert bad.time == pytest.approx(0.699)


@pytest.mark.sampled(4)
def test_each_fmu_can_be_tried_alone_with_its_part_of_the_run(kit, changed):
    for name in ("plant", "observer", "controller", "stimuli"):
        done = repeat(kit / "out" / "fmus" / f"{name}.fmu", kit / "alone")
        assert done.passed, name
        assert len(done.experiments) == (1 if name == "stimuli" else 2)
    changed(kit / "out" / "fmus" / "plant.fmu", kit / "other.fmu", bent_stimuli)
    assert [each.passed for each in repeat(kit / "other.fmu", kit / "alone").experiments] == [
        True,
        False,
    ]


def bent_stimuli(name, content):
    """A load of 0.1 mN.m too much from the first step on."""
    if not name.endswith("validation-stimuli.csv"):
        return content
    head, *rows = content.decode().splitlines()
    place = head.split(",").index("tau_load")
    cells = [row.split(",") for row in rows]
    return "\n".join(
        [
            head,
            *(",".join([*c[:place], repr(float(c[place]) + 1e-4), *c[place + 1 :]]) for c in cells),
        ]
    ).encode()


@pytest.mark.sampled(4)
def test_noise_is_exported_as_a_table(tmp_path):
    noise = 'noise = { rms = "0.0005 N.m", bandwidth = "20 Hz" }'
    text = SCENARIO.replace('duration = "2 s"', 'duration = "0.5 s"').replace(
        'sine = { amplitude = "0.0005 N.m", frequency = "3 Hz" }', noise
    )
    (tmp_path / "rough.toml").write_text(text, encoding="utf-8")
    package = export(tmp_path / "rough.toml", tmp_path / "out")
    assert "resources/stimuli.csv" in SystemPackage(package).names
    assert replay(package, tmp_path / "again").passed


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b'startConnector="u"', b'startConnector="uu"', "did you mean 'u'"),
        (b'endElement="plant"', b'endElement="plan"', "no component"),
        (b'endElement="plant" ', b"", "connectors of the system itself"),
        (b"resources/plant.fmu", b"resources/none.fmu", "holds no file"),
        (b"x-fmu-sharedlibrary", b"x-ssp-definition", "supported are FMUs"),
        (b"</ssd:System>", b"", "no XML"),
        (b'stepSize="0.001"', b'stepSize="1e-12"', "steps"),
        (b'stepSize="0.001"', b'stepSize="nan"', "not finite"),
        (b"SSP1/SystemStructureDescription", b"SSP9/SystemStructureDescription", "SSP 1.0"),
    ],
)
def test_a_package_that_cannot_be_run_is_one_line(kit, tmp_path, old, new, message, changed):
    def change(name, content):
        return content.replace(old, new) if name == "SystemStructure.ssd" else content

    with pytest.raises(BristleError, match=message) as error:
        replay(changed(kit / "out" / "axis.ssp", tmp_path / "bad.ssp", change), tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.sampled(4)
def test_a_damaged_reference_is_one_line(kit, tmp_path, changed):
    for damaged, content in (
        ("verdict.json", b'{"x": NaN'),
        ("signals.csv", b""),
        ("signals.csv", b"time,plant.v\n0,nan\n"),
    ):

        def change(name, old, damaged=damaged, content=content):
            return content if name.endswith(damaged) else old

        with pytest.raises(BristleError, match=damaged):
            replay(
                changed(kit / "out" / "axis.ssp", tmp_path / "bad.ssp", change), tmp_path / "out"
            )
        assert not (tmp_path / "out").exists()


def test_files_that_are_no_packages_are_one_line(tmp_path):
    (tmp_path / "text.ssp").write_text("no zip", encoding="utf-8")
    with pytest.raises(BristleError, match="not a zip archive"):
        replay(tmp_path / "text.ssp", tmp_path / "out")
    with pytest.raises(BristleError, match="check the path"):
        replay(tmp_path / "none.ssp", tmp_path / "out")


def test_a_package_of_another_maker_runs_without_a_reference(tmp_path, tiny_fmu):
    """Two FMUs in a row, parameters inside the description, a table for an input, no step."""
    first = Component("theirs", "resources/b.fmu", {})
    plant = Component("mine", "resources/a.fmu", {}, {"J": 0.002})
    drive = Component("table", "resources/t.csv", {}, type=CSV_TYPE)
    links = ((("table", "volt"), ("theirs", "u")), (("theirs", "v"), ("mine", "u")))
    system = SystemStructure("other", (plant, drive, first), links, stop=0.5)
    files = package_files(system) | {"resources/t.csv": b"time,volt\n0,0\n0.1,5\n"}
    ssv = files.pop("resources/mine.ssv").partition(b"?>")[2]
    binding = b'<ssd:ParameterBinding source="resources/mine.ssv" />'
    inside = (
        b"<ssd:ParameterBinding><ssd:ParameterValues>"
        + ssv
        + b"</ssd:ParameterValues></ssd:ParameterBinding>"
    )
    assert binding in files["SystemStructure.ssd"]
    files["SystemStructure.ssd"] = files["SystemStructure.ssd"].replace(binding, inside)
    files["resources/a.fmu"] = obtain("plant", law="viscous").read_bytes()
    files["resources/b.fmu"] = tiny_fmu().read_bytes()
    with zipfile.ZipFile(tmp_path / "other.ssp", "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    done = replay(tmp_path / "other.ssp", tmp_path / "out")
    assert done.passed
    assert not done.compared
    signals = table((done.folder / "signals.csv").read_text(encoding="utf-8"))
    assert np.all(signals["theirs.v"][:101] == 0)
    # of v' = 6.5 u - 2 v by explicit Euler, u = 5 from 0.1 s on
    expected = 16.25 * (1 - (1 - 2e-3) ** np.arange(401))
    np.testing.assert_allclose(signals["theirs.v"][100:], expected, atol=1e-12)
    assert np.all(signals["mine.v"][:102] == 0)  # a step later
    assert signals["mine.v"][102] > 0


def test_what_cannot_be_exported_is_one_line(kit, tmp_path):
    text = SCENARIO.replace(
        "[controller.parameters]", '[controller]\ncompensation = "valid"\n[controller.parameters]'
    )
    (tmp_path / "follow.toml").write_text(text, encoding="utf-8")
    with pytest.raises(BristleError, match="compensation"):
        export(tmp_path / "follow.toml", tmp_path / "out")
    assert not (tmp_path / "out").exists()


# -- other importers -------------------------------------------------------------------------------
ECOS = """
from ecospy import EcosSimulation
sim = EcosSimulation(ssp_path=PACKAGE, step_size=1e-3)
sim.init()
for k in range(STEPS + 1):
    if k % STRIDE == 0:
        rows.append([sim.get_real(name.replace(".", "::", 1)) for name in NAMES])
    if k < STEPS:
        sim.step(1)
"""
COSIM = """
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
run = CosimExecution.from_ssp_file(ssp_path=PACKAGE, step_size=1_000_000)
seen = CosimObserver.create_last_value()
run.add_observer(seen)
text = lambda each: each.decode() if isinstance(each, bytes) else each
parts = {name.partition(".")[0] for name in NAMES}
unit = {name: run.slave_index_from_instance_name(name) for name in parts}
place = {}
for name, i in unit.items():
    for v in run.slave_variables(i):
        place[f"{name}.{text(v.name)}"] = (i, v.reference)
for k in range(0, STEPS + 1, STRIDE):
    if k:
        run.step(STRIDE)
    rows.append([seen.last_real_values(i, [vr])[0] for i, vr in map(place.__getitem__, NAMES)])
"""
# Largest difference over the range of the signal: both add up the time in another way (libcosim in
# whole nanoseconds).
IMPORTERS = {"ecospy": (ECOS, 1e-12), "libcosimpy": (COSIM, 1e-12)}


@pytest.mark.parametrize("importer", IMPORTERS)
def test_another_importer_gives_the_same_digits(kit, importer, rows_of):
    code, tolerance = IMPORTERS[importer]
    reference = table((kit / "out" / "reference" / "signals.csv").read_text(encoding="utf-8"))
    names = [
        "plant.theta",
        "plant.v",
        "plant.theta_enc",
        "controller.u",
        "observer.b_hat",
        "observer.alpha2_hat",
    ]
    stride = round(reference["time"][1] / 1e-3)
    steps = stride * (len(reference["time"]) - 1)
    rows = rows_of(
        importer,
        code,
        PACKAGE=str(kit / "out" / "axis.ssp"),
        STEPS=steps,
        STRIDE=stride,
        NAMES=names,
    )
    for name, got in zip(names, rows.T, strict=True):
        expected = reference[name]
        assert np.abs(got[1:] - expected[1:]).max() <= tolerance * np.ptp(expected), name
