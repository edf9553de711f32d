"""The public functions: the same answers as the commands, from paths or loaded objects, and a fast
import.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import bristle
from bristle.plant.effects import effects

ROOT = Path(__file__).resolve().parents[2]
HIDDEN = ROOT / "scenarios" / "hidden" / "07"
DATA = [HIDDEN / "a.npz", HIDDEN / "b.npz"]


@pytest.fixture
def wrong_unit(tmp_path: Path) -> Path:
    """A model file whose input unit is a thousand times too small: the diagnosis ends at once and
    proposes another unit.
    """
    path = tmp_path / "model.toml"
    path.write_text(
        (HIDDEN / "model.toml").read_text(encoding="utf-8").replace('"N.m"', '"mN.m"'),
        encoding="utf-8",
    )
    return path


def test_the_import_is_light():
    """Nothing but exceptions and checks of arguments is imported before it is needed."""
    code = (
        "import sys; before = {*sys.modules}; import bristle; print(*sorted({*sys.modules} -"
        " before))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    own = {name for name in loaded if name.split(".")[0] == "bristle"}
    assert own == {"bristle", "bristle.common", "bristle.common.arguments", "bristle.common.errors"}
    assert not {"numpy", "scipy", "casadi", "fmpy", "matplotlib", "pydantic"} & {*loaded}
    assert len(loaded) < 60


def test_the_version_is_that_of_the_project_and_of_the_command():
    import tomllib

    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "version"
    ]
    assert bristle.__version__ == version
    command = [sys.executable, "-m", "bristle.cli.main", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == f"bristle {version}\n"


def test_every_public_name_is_there():
    for name in bristle.__all__:
        assert getattr(bristle, name) is not None
    assert {*bristle.__all__} <= {*dir(bristle)}
    with pytest.raises(AttributeError, match="nothing_of_this_name"):
        bristle.nothing_of_this_name  # noqa: B018 - the access is what is tested


@pytest.mark.sampled(4)
def test_sub_packages_keep_their_names():
    code = (
        "import bristle, bristle.diagnosis, bristle.records, bristle.harness.run.run;"
        " print(callable(bristle.run), bristle.diagnosis)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("True <module 'bristle.diagnosis'")


def test_a_scenario_runs_and_its_result_is_what_was_written(case, tmp_path):
    result = bristle.run(case, tmp_path / "out")
    assert result.passed
    assert result.folder == tmp_path / "out" / "case"
    written = json.loads((result.folder / "result.json").read_text(encoding="utf-8"))
    assert result.verdict == written["verdict"] == "pass"
    assert result.scenario == "case"
    assert result.estimates == written["estimates"]
    assert result.checks[0]["name"] == "b moves"
    assert result.report.is_file()
    signals = result.signals()
    assert signals["time"][0] == 0.0
    assert {column.shape for column in signals.values()} == {signals["u"].shape}
    assert np.all(np.diff(signals["time"]) > 0)
    assert repr(result) == f"<Result 'case': pass, 1 of 1 checks pass, in {str(result.folder)!r}>"
    assert "b moves" in str(result)


@pytest.mark.usefixtures("undrawn")
def test_overrides_replace_values_of_the_file(case, tmp_path):
    text = bristle.run(
        case, tmp_path / "a", overrides={"plant.parameters.J": "2 g.m2", "duration": "0.5 s"}
    )
    with pytest.raises(bristle.BristleError, match="has no unit"):
        bristle.run(case, tmp_path / "b", overrides={"plant.parameters.J": 0.002})
    plain = bristle.run(case, tmp_path / "c", overrides={"duration": "0.5 s"})
    assert text.data["duration_s"] == 0.5
    flag = bristle.run(case, tmp_path / "d", overrides={"duration": "0.5 s", "checks.0.min": 1e9})
    assert not flag.passed
    assert text.estimates["b"]["true"] == pytest.approx(plain.estimates["b"]["true"] / 2)


@pytest.mark.usefixtures("undrawn")
def test_another_seed_gives_another_run(case, tmp_path):
    one, other = (bristle.run(case, tmp_path / str(seed), seed=seed) for seed in (1, 2))
    assert one.estimates["b"]["moved"] != other.estimates["b"]["moved"]


@pytest.mark.sampled(4)
def test_a_shipped_scenario_is_found_by_its_name(tmp_path):
    result = bristle.run("quick", tmp_path, overrides={"duration": "1 s"})
    assert result.scenario == "quick"
    with pytest.raises(bristle.BristleError, match="no_such"):
        bristle.run("no_such", tmp_path)


def test_an_fmu_is_built(tmp_path):
    path = bristle.build("controller", tmp_path / "fmus", fmi=3)
    assert path == tmp_path / "fmus" / "Controller.fmu"
    assert path.is_file()
    with pytest.raises(bristle.BristleError, match="no law"):
        bristle.build("controller", tmp_path, law="lugre")


def test_a_diagnosis_takes_paths_and_loaded_objects(wrong_unit, tmp_path):
    by_path = bristle.diagnose(wrong_unit, DATA, tmp_path / "out")
    assert by_path.verdict == "not_identifiable"
    assert "mN.m" in by_path.proposals[0]
    assert (
        json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))["verdict"]
        == "not_identifiable"
    )
    model = bristle.load_model(wrong_unit)
    records = bristle.load_records(wrong_unit, DATA)
    seen = []
    loaded = bristle.diagnose(model, records, progress=lambda text, share: seen.append(share))
    assert (loaded.proposals, loaded.gap) == (by_path.proposals, by_path.gap)


@pytest.mark.parametrize(
    ("data", "part"),
    [
        ([DATA[0], 3], "data[1] is 3"),
        (3, "data[0] is 3"),
        ([{}], "data[0] is a dict"),
        ([None], "data[0] is None"),
        ("mixed", "data mixes files and loaded records"),
    ],
)
def test_data_of_a_wrong_type_are_refused(wrong_unit, message, data, part):
    """Nothing is left out without a word."""
    given = [bristle.load_records(wrong_unit, DATA)[0], str(DATA[1])] if data == "mixed" else data
    assert part in message(lambda: bristle.diagnose(wrong_unit, given))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"fmi": "2"}, "fmi is '2'; choose one of: 2, 3"),
        ({"fmi": 2.0}, "fmi is 2.0"),
        ({"kind": "c"}, "kind is 'c'; choose one of: 'native', 'python'"),
        ({"seed": "a"}, "seed is 'a'; give a whole number"),
        ({"seed": 1.5}, "seed is 1.5"),
        ({"seed": True}, "seed is True"),
        ({"overrides": 3}, "overrides is a int"),
        ({"overrides": {"duration": object()}}, "overrides['duration'] is a object"),
        ({"overrides": {"": "1 s"}}, "override '=1 s'"),
        ({"scenario": 3}, "scenario is 3; give a path"),
        ({"out": None}, "out is None; give a path"),
    ],
)
def test_a_wrong_argument_of_run_is_one_line_that_names_it(
    case, tmp_path, message, arguments, named
):
    given = {"scenario": case, "out": tmp_path / "out"} | arguments
    assert named in message(lambda: bristle.run(**given))


def test_numbers_of_numpy_are_whole_numbers_and_name_a_seed(case, tmp_path):
    assert bristle.run(case, tmp_path, seed=np.int64(3)).data["overrides"] == [
        "controller.parameters.seed=3"
    ]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"part": 3}, "part is 3; choose one of: 'plant'"),
        ({"part": "all"}, "part is 'all'"),
        ({"out": 3}, "out is 3; give a path"),
        ({"fmi": "3"}, "fmi is '3'"),
        ({"part": "plant", "effects": "bias"}, "effects is 'bias'; give a list of names"),
        ({"part": "plant", "effects": ["bias", 3]}, "effects[1] is 3; give a name as text"),
        ({"part": "plant", "effects": ["bais"]}, "unknown effect 'bais' (did you mean 'bias'?)"),
        ({"effects": ["bias"]}, "the controller has no effects to add ('bias')"),
    ],
)
def test_a_wrong_argument_of_build_is_one_line_that_names_it(tmp_path, message, arguments, named):
    assert named in message(
        lambda: bristle.build(**({"part": "controller", "out": tmp_path} | arguments))
    )


@pytest.mark.sampled(4)
def test_effects_join_a_plant_that_is_built_and_one_of_a_scenario(case, tmp_path):
    path = bristle.build("plant", tmp_path, law="coulomb", effects=["cogging", "bias"])
    assert path.name == "ServoPlant_coulomb_bias_cogging.fmu"
    plain, biased = (
        bristle.run(case, tmp_path, overrides={"plant.effects": names}) for names in ([], ["bias"])
    )
    assert plain.data["estimates"] != biased.data["estimates"]


def test_records_are_no_files(wrong_unit, message):
    [record] = bristle.load_records(wrong_unit, DATA[0])
    assert (
        message(lambda: bristle.load_records(wrong_unit, [record]))
        == "files[0] is a Record; give a path, as text or Path"
    )
    assert "model is a int" in message(lambda: bristle.load_model(3))
    assert "the model (TOML) comes first" in message(
        lambda: bristle.load_record(DATA[0], wrong_unit)
    )


def test_arrays_become_the_records_of_a_file(wrong_unit):
    [record] = bristle.load_records(wrong_unit, DATA[0])
    [same] = bristle.records_from_arrays(wrong_unit, [("a", record.time, record.u, record.y)])
    np.testing.assert_array_equal(same.u, record.u)
    np.testing.assert_array_equal(same.y, record.y)


@pytest.mark.sampled(4)
def test_no_error_of_the_library_speaks_of_options_of_the_command_line():
    """Whoever calls a function has none; the command line alone may name them."""
    rooms = (
        "common",
        "model",
        "plant",
        "observer",
        "records",
        "fmus",
        "harness",
        "diagnosis",
        "package",
    )
    option, found = re.compile(r"(?<![\w-])--[a-z]"), []
    for path in (path for room in rooms for path in (ROOT / room).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and "rror" in ast.unparse(node.func):
                found += [
                    f"{path}:{node.lineno}"
                    for text in map(ast.unparse, node.args)
                    if option.search(text)
                ]
    assert not found


def test_one_record_is_loaded(wrong_unit):
    record = bristle.load_record(wrong_unit, DATA[0])
    assert isinstance(record, bristle.Record)
    [same] = bristle.load_records(bristle.load_model(wrong_unit), str(DATA[0]))
    np.testing.assert_array_equal(record.u, same.u)
    one = bristle.diagnose(wrong_unit, record)
    assert isinstance(one, bristle.Diagnosis)


def test_a_file_with_a_gap_is_not_one_record(wrong_unit, tmp_path):
    columns = dict(np.load(DATA[0]))
    n = len(columns["t"])
    kept = np.r_[0 : n // 2 - 500, n // 2 + 500 : n]
    np.savez(tmp_path / "gap.npz", **{name: column[kept] for name, column in columns.items()})
    with pytest.raises(bristle.BristleError, match="2 records; use load_records"):
        bristle.load_record(wrong_unit, tmp_path / "gap.npz")


def test_mistakes_are_found_before_the_work_begins(wrong_unit, tmp_path):
    for arguments, keywords, words in (
        ((None, DATA), {}, "nothing to diagnose"),
        ((wrong_unit, []), {}, "no record"),
        ((wrong_unit, DATA, tmp_path), {"choose": "cogs"}, "cogs"),
        ((wrong_unit, [tmp_path / "no.csv"]), {}, "no.csv"),
    ):
        with pytest.raises(bristle.BristleError, match=words):
            bristle.diagnose(*arguments, **keywords)
    assert "cogs" not in effects()
