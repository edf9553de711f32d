"""What is written: all of it or nothing, and an augmented plant that is the identified one as it
stands.
"""

from __future__ import annotations

import errno
import html
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

from bristle.common import output
from bristle.common.errors import BristleError, IncompleteError
from bristle.diagnosis import fmu_model, load_model
from bristle.diagnosis.answer import Estimate, Gap, Named
from bristle.diagnosis.report import export
from bristle.diagnosis.report.text.designed import EXPERIMENT_FILE
from bristle.fmus.build import program_of
from bristle.model.native import Native

H = 1e-3


def names(folder):
    return sorted(os.listdir(folder))


def starts(path):
    return {
        v.name: v.start
        for v in read_model_description(str(path)).modelVariables
        if v.causality == "parameter"
    }


WRITTEN_WITH_A_NAME = [name for name in export.WRITTEN_FILES if name != EXPERIMENT_FILE]


@pytest.fixture(scope="module")
def written(fabricated, tmp_path_factory):
    """The folder of a named effect."""
    folder = tmp_path_factory.mktemp("named") / "out"
    files = export.write(fabricated.named(), folder)
    assert [file.name for file in files] == WRITTEN_WITH_A_NAME
    return folder


@pytest.mark.sampled(4)
def test_nothing_else_is_left_behind(written):
    assert names(written) == sorted(WRITTEN_WITH_A_NAME)
    assert json.loads((written / "diagnosis.json").read_text())["verdict"] == "named"
    assert "augmented.fmu" in (written / "report.html").read_text()


def test_the_augmented_model_reads_back_with_the_effect(written):
    model = load_model(written / "augmented.toml")
    assert model.parameters == {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12}
    assert model.effects["cogging"]["amplitude"] == 0.06
    assert model.effects["cogging"]["periods"] == 7.0


def test_the_augmented_fmu_is_valid_and_starts_as_identified(written):
    path = written / "augmented.fmu"
    assert validate_fmu(str(path)) == []
    found = starts(path)
    expected = {
        "J": 0.01,
        "a2": 0.02,
        "coulomb.Fc": 0.12,
        "cogging.amplitude": 0.06,
        "b": 1.0,
        "u_max": 1e6,
    }
    assert {name: float(found[name]) for name in expected} == expected
    assert float(found["encoder.counts"]) == pytest.approx(2 * np.pi / 3.834951969714103e-4)


def test_the_augmented_fmu_moves_by_itself_as_the_identified_plant_does(written):
    given = {
        "J": 0.01,
        "a2": 0.02,
        "coulomb.Fc": 0.12,
        "b": 1.0,
        "u_max": 1e6,
        "cogging.amplitude": 0.06,
        "cogging.phase": 0.4,
        "cogging.periods": 7.0,
        "cogging.amplitude2": 0.0006,
        "cogging.phase2": 1.2,
    }
    expected, _ = Native(program_of("plant", "coulomb", ["cogging"]), given).run(
        H, {"u": np.full(300, 0.3)}, ["theta", "v"]
    )
    found = simulate_fmu(
        str(written / "augmented.fmu"),
        fmi_type="CoSimulation",
        stop_time=0.3,
        output_interval=H,
        step_size=H,
        start_values={"u": 0.3},
        output=["theta", "v"],
    )
    assert expected[-1, 0] > 0.2
    for k, name in enumerate(("theta", "v")):
        np.testing.assert_allclose(found[name], expected[:, k], rtol=1e-9, atol=1e-12)


def test_a_tie_writes_no_model_and_takes_old_ones_away(answer, tmp_path):
    for name in (*export.WRITTEN_FILES, "thesis.txt"):
        (tmp_path / name).write_text("old")
    assert [file.name for file in export.write(answer("tie"), tmp_path)] == [
        "diagnosis.json",
        "report.html",
    ]
    assert names(tmp_path) == ["diagnosis.json", "report.html", "thesis.txt"]
    assert (tmp_path / "thesis.txt").read_text() == "old"


def test_a_member_of_a_tie_can_be_chosen(answer):
    assert export.augment(answer("tie")) is None
    chosen = export.augment(answer("tie"), "asymmetric_coulomb")
    assert chosen.effects == ("asymmetric_coulomb",)
    assert chosen.parameters["asymmetric_coulomb.share"] == 0.165
    assert chosen.parameters["coulomb.Fc"] == 0.121
    assert chosen.model.parameters["coulomb.Fc"] == 0.121


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("case", "choose", "words"),
    [
        ("tie", "gravity", "not a member of the tie; choose one of: bias, asymmetric_coulomb"),
        ("none", "bias", "verdict is 'none'"),
    ],
)
def test_a_choice_that_cannot_be_is_said_and_the_rest_is_written(
    answer, tmp_path, monkeypatch, case, choose, words
):
    monkeypatch.setattr(
        export, "_build_plant", lambda *arguments: pytest.fail("nothing may be built")
    )
    with pytest.raises(IncompleteError, match=words) as caught:
        export.write(answer(case), tmp_path, choose)
    assert "\n" not in str(caught.value)
    assert names(tmp_path) == ["diagnosis.json", "report.html"]
    assert words in html.unescape((tmp_path / "report.html").read_text())


@pytest.mark.sampled(4)
def test_a_model_that_cannot_be_built_costs_no_report(answer, tmp_path):
    named = answer("named")
    wild = replace(named, fitted={**named.parameters, "J": Estimate(-1.0, "kg.m2", None)})
    with pytest.raises(BristleError, match="J = -1"):
        export.write(wild, tmp_path)
    assert {"diagnosis.json", "report.html"} <= set(names(tmp_path))
    assert "augmented.fmu" not in names(tmp_path)
    assert "augmented.fmu was not written" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("case", ["not_identifiable", "proposals"])
def test_no_model_where_the_data_do_not_carry_one(answer, case):
    assert export.augment(answer(case)) is None


def test_where_nothing_is_missing_the_model_is_the_refitted_one(answer):
    refitted = export.augment(answer("none"))
    assert (refitted.effects, refitted.added) == ((), ())
    assert refitted.parameters["J"] == 0.0103


def test_an_effect_the_model_had_is_refitted_and_bounds_give_way(answer, fabricated):
    had = fabricated.model(effects={"bias": {"torque": 0.01}}, bounds={"J": [0.0105, 0.03]})
    found = {**answer("named").parameters, "bias.torque": Estimate(0.013, "N.m", None)}
    augmented = export.augment(replace(answer("named"), model=had, fitted=found))
    assert augmented.effects == ("bias", "cogging")
    assert augmented.added == ("cogging",)
    assert augmented.parameters["bias.torque"] == 0.013
    assert augmented.model.effects["bias"] == {"torque": 0.013}
    assert augmented.model.bounds["J"] == (0.01, 0.03)


def test_what_a_fit_leaves_out_keeps_its_default(answer):
    few = Named("cogging", "cogging", {"amplitude": Estimate(0.05, "N.m", None)}, 9.0, 0.001)
    assert export.augment(replace(answer("named"), effects=(few,))).model.effects["cogging"] == {
        "amplitude": 0.05,
        "phase": 0.0,
        "periods": 7.0,
        "amplitude2": 0.0,
        "phase2": 0.0,
        "sine3": 0.0,
        "cosine3": 0.0,
        "sine4": 0.0,
        "cosine4": 0.0,
    }


@pytest.mark.sampled(4)
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_declares_the_units_of_its_rig(answer, fabricated, tmp_path, fmi):
    slow = replace(
        answer("named"),
        model=fabricated.linear_model(),
        gap=Gap(1e-9, 1e-9, None, "m"),
        base={},
        fitted={},
    )
    export.write(slow, tmp_path, fmi=fmi)
    found = starts(tmp_path / "augmented.fmu")
    assert (float(found["b"]), float(found["u_max"]), float(found["J"])) == (1.0, 1e6, 2.0)
    # a grid of one micrometre
    assert float(found["encoder.counts"]) == pytest.approx(2 * np.pi / 1e-6)
    assert validate_fmu(str(tmp_path / "augmented.fmu")) == []
    declared = read_model_description(str(tmp_path / "augmented.fmu"))
    units = {v.name: v.unit for v in declared.modelVariables if v.unit is not None}
    wanted = {
        "u": "N",
        "tau_load": "N",
        "theta": "m",
        "v": "m/s",
        "F": "N",
        "J": "kg",
        "a2": "N.s/m",
        "b": "1",
        "coulomb.Fc": "N",
    }
    wanted |= {
        "cogging.amplitude": "N",
        "cogging.periods": "rad/m",
        "cogging.phase": "rad",
        "theta_start": "m",
        "sample_time": "s",
    }
    assert {name: units.get(name, "1") for name in wanted} == wanted
    assert not any("V" in unit for unit in units.values())
    bases = {unit.name: unit.baseUnit for unit in declared.unitDefinitions}
    assert (bases["N"].kg, bases["N"].m, bases["N"].s, bases["N"].rad) == (1, 1, -2, 0)
    assert (bases["rad/m"].rad, bases["rad/m"].m) == (1, -1)
    corrected = read_model_description(str(tmp_path / "correction.fmu"))
    ports = {v.name: v.unit for v in corrected.modelVariables if v.causality in ("input", "output")}
    assert ports == {"u": "N", "theta": "m", "v": "m/s", "u_corrected": "N"} | (
        {"time": "s"} if "time" in ports else {}
    )


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("kind", "unit", "gain"),
    [("torque", "N.m", "1"), ("current", "A", "N.m/A"), ("voltage", "V", "N.m/V")],
)
def test_an_fmu_is_the_model_that_it_was_made_from_with_its_kind_of_input(
    answer, fabricated, tmp_path, kind, unit, gain
):
    given = {"J": 0.011, "a2": 0.015, "Fc": 0.1} | ({} if kind == "torque" else {"b": 0.5})
    own = fabricated.model(input={"column": "u", "kind": kind, "unit": unit}, parameters=given)
    export.write(replace(answer("none"), model=own, base={}), tmp_path)
    units = {
        v.name: v.unit or "1"
        for v in read_model_description(str(tmp_path / "augmented.fmu")).modelVariables
    }
    assert (units["u"], units["u_max"], units["b"], units["theta"]) == (unit, unit, gain, "rad")
    again = fmu_model(tmp_path / "augmented.fmu")
    assert (again.input_kind, again.input_unit, again.linear) == (kind, unit, False)
    assert again.parameters == own.parameters


# -- all or nothing --------------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch):
    """Make the content of the files cheap."""
    package = export._Package(
        content={name: b"new" for name in export.WRITTEN_FILES if name != "augmented.toml"}
    )
    monkeypatch.setattr(export, "_package", lambda *arguments: package)


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()]
)
@pytest.mark.parametrize("call", range(1, 8))
def test_an_exchange_that_fails_puts_all_back(answer, quick, tmp_path, monkeypatch, call, error):
    before = {
        "diagnosis.json": "old",
        "augmented.toml": "old",
        "augmented.fmu": "old",
        "thesis.txt": "precious",
    }
    for name, text in before.items():
        (tmp_path / name).write_text(text)
    real, calls = os.replace, []

    def failing(source, target):
        calls.append(target)
        if len(calls) == call:
            raise error
        real(source, target)

    monkeypatch.setattr(output.os, "replace", failing)
    with pytest.raises((BristleError, KeyboardInterrupt)) as caught:
        export.write(answer("named"), tmp_path)
    if isinstance(error, OSError):
        assert "No space left on device" in str(caught.value)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


def test_a_full_disk_changes_nothing(answer, quick, tmp_path, monkeypatch):
    (tmp_path / "report.html").write_text("old")

    def full(path, content):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(output, "write_file", full)
    with pytest.raises(BristleError, match="No space left"):
        export.write(answer("named"), tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"report.html": "old"}


def test_a_file_in_the_way_is_one_line(answer, tmp_path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(BristleError, match="output folder"):
        export.write(answer("named"), tmp_path / "out")


# -- in the place of the old plant -----------------------------------------------------------------

SCENARIO = """
duration = "20 s"
sensor = "encoder"
[plant]
fmu = "found/augmented.fmu"
[observer]
method = "rls"
[[checks]]
quantity = "estimates.b.error_percent"
max_abs = 5.0
[[checks]]
quantity = "estimates.alpha2.error_percent"
max_abs = 15.0
"""


@pytest.mark.sampled(4)
def test_the_harness_runs_the_augmented_plant_in_place_of_the_old_one(
    answer, fabricated, tmp_path: Path
):
    from bristle.harness.run.checked import RunOptions
    from bristle.harness.run.run import run

    volts = fabricated.model(
        parameters={"J": 0.0012, "a2": 0.001, "b": 0.006, "Fc": 0.003},
        bounds={"J": [0.0005, 0.002]},
        input={"column": "u", "kind": "voltage", "unit": "V"},
    )
    fitted = {"J": 0.001, "a2": 0.002, "b": 0.0065, "coulomb.Fc": 0.004}
    bump = Named("cogging", "cogging", {"amplitude": Estimate(0.0001, "N.m", None)}, 99.0, 0.001)
    diagnosis = replace(
        answer("named"),
        model=volts,
        effects=(bump,),
        fitted={name: Estimate(x, "1", None) for name, x in fitted.items()},
    )
    export.write(diagnosis, tmp_path / "found")
    (tmp_path / "case.toml").write_text(SCENARIO)
    done = run(
        tmp_path / "case.toml",
        tmp_path / "out",
        RunOptions(2, "native", (), None, False),
        lambda *progress: None,
    )
    assert done.passed, done.result["checks"]
    assert done.result["estimates"]["b"]["true"] == pytest.approx(6.5)
    assert done.result["estimates"]["alpha2"]["true"] == pytest.approx(2.0)


def test_what_was_read_is_not_written_over(tmp_path):
    for name in export.WRITTEN_FILES:
        with pytest.raises(BristleError, match="would be replaced"):
            export.check_places(tmp_path, [tmp_path / "model.toml", tmp_path / "." / name])
    export.check_places(
        tmp_path, [tmp_path / "model.toml", tmp_path / "below" / export.WRITTEN_FILES[0]]
    )


def test_a_folder_in_the_way_stays(answer, tmp_path):
    (tmp_path / "report.html").mkdir()
    (tmp_path / "report.html" / "precious").write_text("mine")
    with pytest.raises(BristleError, match="is a folder"):
        export.write(answer("none"), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert (tmp_path / "report.html" / "precious").read_text() == "mine"


def test_a_class_mate_takes_the_place_of_what_was_named(answer):
    named, tie = answer("named"), answer("tie")
    torque, own = tie.choices["bias"], {"J": Estimate(0.0107, "kg.m2", None)}
    open_ = {
        "ties": (("cogging", "bias"),),
        "choices": {"bias": torque},
        "choice_parameters": {"bias": own},
    }
    chosen = export.augment(replace(named, **open_), "bias")
    assert chosen.effects == chosen.added == ("bias",)
    assert chosen.parameters["bias.torque"] == torque["torque"].value
    assert chosen.parameters["J"] == 0.0107
    # what was named already
    assert export.augment(replace(named, **open_), "cogging") == export.augment(named)


def test_a_tie_that_is_left_after_a_name_can_be_chosen_from(answer):
    named, tie = answer("named"), answer("tie")
    beside = {
        "J": Estimate(0.0107, "kg.m2", None),
        "cogging.amplitude": Estimate(0.051, "N.m", None),
    }
    left = {
        "ties": tie.ties,
        "choices": tie.choices,
        "choice_parameters": dict.fromkeys(tie.choices, beside),
    }
    chosen = export.augment(replace(named, **left), "bias")
    assert set(chosen.effects) == {"cogging", "bias"}
    assert chosen.parameters["cogging.amplitude"] == 0.051  # as it is beside what was chosen
    assert chosen.parameters["cogging.periods"] == 7.0
    assert export.augment(replace(named, **left)).effects == ("cogging",)


def test_a_class_mate_of_what_others_were_added_to_cannot_be_chosen(answer):
    with pytest.raises(
        BristleError, match=r"'cogging' stands for it, .* leave it out, or give the model 'gravity'"
    ):
        export.augment(replace(answer("named"), ties=(("cogging", "gravity"),)), "gravity")
