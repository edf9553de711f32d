"""`bristle accept` and `bristle compare`: a reference, what is the same and what is not."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def kept(call: Call, case: Path, tmp_path: Path) -> Path:
    """The baseline of a small scenario, made as on the command line."""
    code, out, err = call("accept", case, "--out", tmp_path / "kept")
    folder = tmp_path / "kept" / "case"
    assert (code, err) == (0, "")
    assert out.startswith("case ")
    assert f"pass  {folder}  " in out
    assert out.endswith(" MB\n")
    return folder


@pytest.mark.slow
def test_a_rerun_is_the_same_and_a_change_is_not(
    call: Call, case: Path, kept: Path, tmp_path: Path
) -> None:
    stored = json.loads((kept / "baseline.json").read_text(encoding="utf-8"))
    assert stored["provenance"]["command"].startswith("bristle accept ")
    assert (
        stored["provenance"]["scenario_sha256"]
        == hashlib.sha256((kept / "scenario.toml").read_bytes()).hexdigest()
    )
    runs = stored["runs"]
    names = [each["name"] for each in runs if not each["why"]]
    assert "without optimisation" in names
    assert "sums in another order" in names
    assert sum(name.startswith("start values") for name in names) == 8
    assert sum(name.startswith("internal steps") for name in names) == 2
    call("run", case, "--out", tmp_path / "same")
    code, out, err = call("compare", kept, tmp_path / "same/case", "--out", tmp_path / "report")
    assert (code, err) == (0, "")
    assert out.startswith("case                     pass  ")
    assert (tmp_path / "report/compare.html").is_file()
    call("run", case, "--out", tmp_path / "other", "--set", "plant.parameters.b=0.00656 N.m/V")
    code, out, err = call(
        "compare",
        kept,
        tmp_path / "other/case",
        "--out",
        tmp_path / "report",
        "--json",
        tmp_path / "verdicts.json",
    )
    assert (code, err) == (1, "")
    assert "  theta at " in out
    assert "  - values set by --set: none in A, plant.parameters.b=0.00656 N.m/V in B" in out
    tree = json.loads((tmp_path / "verdicts.json").read_text(encoding="utf-8"))
    assert tree["verdict"] == "differs"
    assert tree == json.loads((tmp_path / "report/compare.json").read_text(encoding="utf-8")) | {
        "provenance": tree["provenance"]
    }
    made = tree["provenance"]
    assert made["command"].startswith("bristle compare ")
    assert made["second"]["command"].endswith("--set 'plant.parameters.b=0.00656 N.m/V'")
    assert made["first"]["fmus_sha256"]["plant"] == made["second"]["fmus_sha256"]["plant"]
    for row in tree["signals"]:
        assert row["pass"] or row["share"] > 1 or row["why"]


@pytest.mark.sampled(4)
def test_a_failed_verdict_is_kept_and_is_1(call: Call, case: Path, tmp_path: Path) -> None:
    code, out, _ = call("accept", case, "--out", tmp_path / "kept", "--set", "checks.0.min=1e6")
    assert code == 1
    assert out.startswith("case                     fail  ")
    assert (tmp_path / "kept/case/signals.npz").is_file()


@pytest.mark.sampled(4)
def test_what_cannot_be_done_is_one_line_and_leaves_nothing(
    call: Call, case: Path, kept: Path, tmp_path: Path
) -> None:
    def line(*arguments: object) -> str:
        code, _, err = call(*arguments)
        assert code == 2
        assert len(err.splitlines()) == 1
        return err

    out = tmp_path / "new"
    assert "given 2 times" in line("accept", case, case, "--out", out)
    assert "No such file" in line("accept", case, tmp_path / "none.toml", "--out", out)
    assert "outside" in line("accept", case, "--out", out, "--set", "plant.parameters.J=-1 kg.m2")
    assert "result.json: No such file" in line("compare", kept, tmp_path / "none", "--out", out)
    assert "would be replaced" in line(
        "compare", kept, kept, "--out", out, "--json", kept / "result.json"
    )
    assert not out.exists()
    (tmp_path / "taken/case").mkdir(parents=True)
    (tmp_path / "taken/case/notes.txt").write_text("mine", encoding="utf-8")
    assert "is no baseline of bristle" in line("accept", case, "--out", tmp_path / "taken")
    assert os.listdir(tmp_path / "taken/case") == ["notes.txt"]


@pytest.mark.sampled(4)
def test_a_baseline_is_renewed_but_no_run_takes_its_place(
    call: Call, case: Path, kept: Path
) -> None:
    code, _, err = call("accept", case, "--out", kept.parent)
    assert (code, err) == (0, "")
    code, _, err = call("run", case, "--out", kept.parent)
    assert code == 2
    assert "is no result folder of bristle" in err


@pytest.mark.sampled(4)
def test_an_empty_file_of_a_baseline_is_one_line(call: Call, kept: Path) -> None:
    (kept / "signals.npz").write_bytes(b"")
    code, _, err = call("compare", kept, kept)
    assert (code, err.count("\n")) == (2, 1)
    assert "is no complete baseline; make it again with bristle accept" in err
