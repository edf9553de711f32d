"""`bristle check`: exit code, lines, file."""

import json
import zipfile

import pytest

from bristle.fmus import obtain
from bristle.fmus.conformance import BEHAVIOUR, Verdict, static_conformance


def only_read(path, tell):
    """Rows of the points that read, and a pass of those that run."""
    rows = [(r.point.id, r.verdict, r.findings) for r in static_conformance(path)] + [
        (n, Verdict.passed, ()) for n in BEHAVIOUR
    ]
    return [dict(zip(("id", "verdict", "findings"), row, strict=True)) for row in rows]


@pytest.mark.sampled(4)
def test_the_command_says_which_points_fail(call, tmp_path, monkeypatch):
    code, out, _ = call("check", obtain("controller"))
    assert code == 0
    assert {line.split("  ")[0] for line in out.splitlines()[:-1]} == {"not applicable"}
    monkeypatch.setattr("bristle.fmus.conformance.judgement.examined", only_read)
    bad = tmp_path / "bad.fmu"
    with zipfile.ZipFile(obtain("controller")) as old, zipfile.ZipFile(bad, "w") as new:
        for name in old.namelist():
            new.writestr(
                zipfile.ZipInfo(name.replace("linux64/Controller", "linux64/Other")), old.read(name)
            )
    files = {kind: tmp_path / f"c.{kind}" for kind in ("json", "junit", "sarif")}
    code, out, _ = call(
        "check", bad, *(each for kind, file in files.items() for each in (f"--{kind}", file))
    )
    assert code == 1
    assert "archive-binary: binaries/linux64: no " in out
    points = json.loads(files["json"].read_text())["points"]
    assert [p["id"] for p in points if p["verdict"] == "fail"] == ["archive-binary"]
    assert [r["ruleId"] for r in json.loads(files["sarif"].read_text())["runs"][0]["results"]] == [
        "archive-binary"
    ]
    assert 'failures="1"' in files["junit"].read_text()
    code, _, err = call("check", tmp_path / "none.fmu")
    assert (code, len(err.splitlines())) == (2, 1)
    code, _, err = call("check", bad, "--json", bad)
    assert (code, len(err.splitlines())) == (2, 1)
