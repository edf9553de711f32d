"""`bristle check`: exit code, lines, file."""

import json
import zipfile

from bristle.fmus import obtain
from bristle.fmus.conformance import Verdict


def test_the_command_says_which_points_fail(call, tmp_path, monkeypatch):
    code, out, _ = call("check", obtain("controller"))
    assert (code, len(out.splitlines())) == (0, 1)
    monkeypatch.setattr("bristle.fmus.conformance.judgement.judged", lambda path, name: (Verdict.passed, ()))
    bad = tmp_path / "bad.fmu"
    with zipfile.ZipFile(obtain("controller")) as old, zipfile.ZipFile(bad, "w") as new:
        for name in old.namelist():
            new.writestr(name.replace("linux64/Controller", "linux64/Other"), old.read(name))
    code, out, _ = call("check", bad, "--json", tmp_path / "c.json")
    assert code == 1
    assert "archive-binary: binaries/linux64: no " in out
    points = json.loads((tmp_path / "c.json").read_text())["points"]
    assert [p["id"] for p in points if p["verdict"] == "fail"] == ["archive-binary"]
    code, _, err = call("check", tmp_path / "none.fmu")
    assert (code, len(err.splitlines())) == (2, 1)
    code, _, err = call("check", bad, "--json", bad)
    assert (code, len(err.splitlines())) == (2, 1)
