"""`bristle test`: exit codes, what is printed, and that nothing runs where something cannot."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bristle.common.errors import BristleError
from bristle.harness.suite import suite

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


def test_the_command_runs_seeds_and_values(call, tmp_path):
    good = tmp_path / "good.toml"
    good.write_text(SCENARIO.replace("LIMIT", "1e9"), encoding="utf-8")
    out = tmp_path / "out"
    code, text, _ = call(
        "test",
        good,
        "--seeds",
        "1-2",
        "--vary",
        "sensor=[clean, encoder]",
        "-j",
        "1",
        "--out",
        out,
        "--junit",
        tmp_path / "j.xml",
    )
    assert code == 0, text
    assert "4 of 4 runs pass" in text
    tree = json.loads((out / "suite.json").read_text(encoding="utf-8"))
    assert {(r["seed"], *r["values"]) for r in tree["runs"]} == {
        (s, f"sensor={k}") for s in (1, 2) for k in ("clean", "encoder")
    }
    assert all((out / r["folder"] / "report.html").is_file() for r in tree["runs"])
    assert "good" in (tmp_path / "j.xml").read_text(encoding="utf-8")
    strict = tmp_path / "strict.toml"
    strict.write_text(SCENARIO.replace("LIMIT", "-1"), encoding="utf-8")
    code, text, _ = call("test", strict, "--quiet", "--out", out)
    assert code == 1
    assert "states.v.rms: " in text
    assert "must be ≤ -1" in text


def test_all_mistakes_are_said_before_anything_runs(call, tmp_path):
    for name, old, new in (("one", "states.v.rms", "states.v.rmsq"), ("two", '"rls"', '"rlss"')):
        text = SCENARIO.replace("LIMIT", "1").replace(old, new)
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    code, _, err = call("test", tmp_path, "--out", tmp_path / "out")
    assert code == 2
    assert [line.count(".toml:") for line in err.strip().splitlines()] == [1, 1]
    assert not (tmp_path / "out").exists()
    for wrong in (("--seeds", "0"), ("--vary", "x"), ("--jobs", "0")):
        code, _, err = call("test", tmp_path / "one.toml", *wrong, "--out", tmp_path / "out")
        assert code == 2
        assert len(err.strip().splitlines()) == 1


def test_junit_says_what_cannot_be_run(call, tmp_path):
    texts = {"bad": SCENARIO.replace('"rls"', '"rlss"'), "good": SCENARIO}
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text.replace("LIMIT", "1"), encoding="utf-8")
    out, file = tmp_path / "out", tmp_path / "j.xml"
    asked = ("--seeds", "1-2", "--vary", "sensor=[clean]", "--out", out, "--junit", file)
    code, said, complaint = call("test", tmp_path / "bad.toml", tmp_path / "good.toml", *asked)
    assert (code, said, out.exists()) == (2, "", False)
    root = ElementTree.parse(file).getroot()
    found = [
        (suite.get("name"), case.get("name"), [each.tag for each in case])
        for suite in root
        for case in suite
    ]
    assert sorted(found) == [
        (scenario, f"sensor=clean, seed {seed}", [tag])
        for scenario, tag in (("bad", "error"), ("good", "skipped"))
        for seed in (1, 2)
    ]
    errors = [each.get("message") for each in root.iter("error")]
    assert [f"bristle: {each}" for each in dict.fromkeys(errors)] == complaint.splitlines()
    assert {suite.get("name"): suite.get("errors") for suite in root if suite.get("errors")} == {
        "bad": "2"
    }
    code, _, complaint = call("test", tmp_path / "nowhere.toml", *asked)
    errors = {each.get("message") for each in ElementTree.parse(file).getroot().iter("error")}
    assert (code, {f"bristle: {each}\n" for each in errors}) == (2, {complaint})
    assert "nowhere.toml" in complaint
    code, _, complaint = call("test", tmp_path / "bad.toml", tmp_path / "bad.toml", *asked)
    [error] = ElementTree.parse(file).getroot().iter("error")
    assert (code, complaint) == (2, f"bristle: {error.get('message')}\n")
    assert "is given twice" in complaint
    assert not out.exists()


@pytest.mark.sampled(4)
def test_a_file_of_verdicts_that_cannot_be_written_is_told_before_anything_runs(call, tmp_path):
    good = tmp_path / "good.toml"
    good.write_text(SCENARIO.replace("LIMIT", "1e9"), encoding="utf-8")
    for option in ("--junit", "--json"):
        code, text, err = call("test", good, "--out", tmp_path / "out", option, tmp_path)
        assert (code, text) == (2, "")
        assert (
            err.strip() == f"bristle: {tmp_path}: Is a directory; give a file that can be written"
        )
    code, text, err = call("test", good, "--seeds", "", "--out", tmp_path / "out")
    assert code == 2
    assert "'' is neither a seed nor a range" in err
    assert not (tmp_path / "out").exists()
    code, text, _ = call(
        "test",
        good,
        "-j",
        "1",
        "--out",
        tmp_path / "out",
        "--junit",
        tmp_path / "new" / "folder" / "j.xml",
    )
    assert code == 0
    assert "good" in (tmp_path / "new" / "folder" / "j.xml").read_text(encoding="utf-8")


@pytest.mark.sampled(4)
def test_files_that_are_left_out_of_a_folder_are_named(call, tmp_path):
    text = SCENARIO.replace("LIMIT", "-1")
    (tmp_path / "good.toml").write_text(text, encoding="utf-8")
    (tmp_path / "misspelt.toml").write_text(
        text.replace("[observer]", "[obsrver]"), encoding="utf-8"
    )
    _, out, err = call("test", tmp_path, "-j", "1", "--out", tmp_path / "out")
    assert "0 of 1 runs pass" in out
    assert (
        f"bristle: {tmp_path}: left out 1 of 2 .toml files, which have no table [observer]:"
        " misspelt.toml" in err
    )


def test_a_mistake_is_said_once_for_all_values(call, tmp_path):
    bad = tmp_path / "bad.toml"
    bad.write_text("[plant", encoding="utf-8")
    vary = "controller.parameters.seed=[1,2]"
    code, _, err = call("test", bad, "--vary", vary, "--out", tmp_path / "out")
    assert code == 2
    assert err.count("not valid TOML") == 1


def test_a_folder_without_scenarios_does_not_hide_a_shipped_one_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick").mkdir()
    (tmp_path / "slow").mkdir()
    [path] = suite._files(Path("quick"))
    assert path.name == "quick.toml"
    with pytest.raises(BristleError, match="slow: no scenario file in this folder"):
        suite._files(Path("slow"))
