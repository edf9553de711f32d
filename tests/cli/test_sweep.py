"""`bristle sweep`, `query` and `report`: exit codes, what is printed, what is written."""

import json
import subprocess
import sys

import pytest

SCENARIO = """
duration = "1 s"
[plant]
law = "coulomb"
[observer]
method = "rls"
[[checks]]
quantity = "states.v.rms"
max = LIMIT
"""


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "one.toml"
    path.write_text(SCENARIO.replace("LIMIT", "1e9"), encoding="utf-8")
    return path


@pytest.mark.sampled(4)
def test_a_sweep_is_asked_and_reported(call, scenario, tmp_path):
    store, out = tmp_path / "store", tmp_path / "report"
    vary = (
        "--vary",
        "plant.parameters.J=uniform(0.001, 0.002) kg.m2",
        "--vary",
        "sensor=[clean, encoder]",
    )
    code, text, _ = call(
        "sweep", scenario, *vary, "--samples", "4", "--seeds", "1-2", "-j", "2", "--out", store
    )
    assert code == 0, text
    assert text.startswith("16 runs in ")
    assert ": 16 pass  " in text
    code, text, err = call("sweep", scenario, *vary, "--samples", "4", "--out", store)
    assert (code, text) == (2, "")
    assert "has runs already; resume it" in err
    code, text, _ = call(
        "sweep",
        scenario,
        *vary,
        "--samples",
        "4",
        "--seeds",
        "1-3",
        "-j",
        "2",
        "--out",
        store,
        "--resume",
    )
    assert ": 8 pass; 16 were there: 16 pass" in text
    code, text, _ = call("report", store, "--out", out)
    assert (code, text) == (0, f"24 of 24 runs pass  {out / 'report.html'}\n")
    assert json.loads((out / "report.json").read_text(encoding="utf-8"))["pass"]["count"] == 24


def test_a_query_prints_a_table_or_csv(call, scenario, tmp_path):
    pytest.importorskip("duckdb")
    call(
        "sweep",
        scenario,
        "--vary",
        "sensor=[clean, encoder]",
        "--seeds",
        "3,5",
        "-j",
        "1",
        "--out",
        tmp_path / "store",
    )
    sql = "SELECT 'nan'::DOUBLE AS a, 'inf'::DOUBLE AS b"
    assert call("query", tmp_path / "store", sql)[1].splitlines()[1].split() == ["-", "-"]
    assert call("query", tmp_path / "store", sql, "--csv")[1] == "a,b\n,\n"
    sql = "SELECT sensor, seed, 0.5 AS half, message FROM runs ORDER BY sensor, seed LIMIT 2"
    code, text, _ = call("query", tmp_path / "store", sql)
    assert code == 0
    assert text.splitlines() == [
        "sensor  seed  half  message",
        "clean      3   0.5",
        "clean      5   0.5",
    ]
    _, text, _ = call("query", tmp_path / "store", sql, "--csv")
    assert text.splitlines() == ["sensor,seed,half,message", "clean,3,0.5,", "clean,5,0.5,"]
    code, _, err = call("query", tmp_path / "store", "SELEC 1")
    assert code == 2
    assert len(err.strip().splitlines()) == 1


def test_verdicts_are_exit_codes(call, scenario, tmp_path):
    strict = tmp_path / "strict.toml"
    strict.write_text(SCENARIO.replace("LIMIT", "-1"), encoding="utf-8")
    code, text, _ = call("sweep", strict, "--seeds", "1-2", "-j", "1", "--out", tmp_path / "a")
    assert (code, "2 fail" in text) == (1, True)
    code, text, _ = call(
        "sweep",
        scenario,
        "--vary",
        "duration=[1 s, 1.001 s]",
        "--vary",
        "step=[1 ms, 2 ms]",
        "-j",
        "1",
        "--out",
        tmp_path / "b",
    )
    assert (code, "1 error" in text) == (2, True)


def test_mistakes_are_lines_and_write_nothing(call, scenario, tmp_path):
    for wrong in (
        ("--vary", "plant.parameters.Jx=[1]"),
        ("--vary", "x"),
        ("--seeds", "0"),
        ("--vary", "plant.parameters.J=uniform(1, 2)"),
        ("--samples", "0"),
        ("--cluster", "nowhere"),
        ("--jobs", "0"),
        ("--sampling", "hope"),
    ):
        code, text, err = call("sweep", scenario, *wrong, "--out", tmp_path / "store")
        assert (code, text, len(err.strip().splitlines())) == (2, "", 1), wrong
        assert not (tmp_path / "store").exists() or not list(
            (tmp_path / "store").rglob("*.parquet")
        )
    for command in ("query", "report"):
        code, _, err = call(
            command, tmp_path / "nothing", *(["SELECT 1"] if command == "query" else [])
        )
        assert code == 2
        assert "no store, or one without runs" in err


WITHOUT = """
import sys
sys.modules["pyarrow"] = None
from bristle.cli.main import main
main()
"""


def without_pyarrow(*arguments):
    return subprocess.run(
        [sys.executable, "-c", WITHOUT, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "words", ["sweep quick --seeds 1-2 --out store", "query store SELECT", "report store"]
)
def test_without_pyarrow_a_store_is_one_line(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    done = without_pyarrow(*words.split())
    said = "bristle: store of a sweep: needs pyarrow; run: pip install 'bristle[parquet]'\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)
    assert not list(tmp_path.iterdir())


@pytest.mark.sampled(4)
def test_without_pyarrow_a_scenario_runs(scenario, tmp_path):
    done = without_pyarrow("run", scenario, "--out", tmp_path / "out")
    assert (done.returncode, done.stdout.split()[:2]) == (0, ["one", "pass"]), done.stderr
