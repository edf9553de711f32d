"""bristle diagnose as a user meets it; what it finds is made up here."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bristle import diagnosis
from bristle.cli import terminal
from bristle.common import output
from bristle.common.errors import BristleError
from bristle.diagnosis import SearchOptions
from bristle.diagnosis.report import export

ROOT = Path(__file__).resolve().parents[1]
Call = Callable[..., tuple[int, str, str]]


def _fabricated() -> Any:
    spec = importlib.util.spec_from_file_location(
        "bristle_tests_cli_fabricated", ROOT / "diagnosis" / "fabricated.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the engine was asked; set `case` to what it shall find."""
    seen: dict[str, Any] = {"case": "named", "made": _fabricated()}

    def engine(
        *arguments: Any,
        progress: Callable[[str, float], None],
        options: SearchOptions,
        timeout: float | None = None,
    ) -> Any:
        seen["options"] = options
        progress("base fit", 0.1)
        progress("candidates", 0.9)
        seen["arguments"] = arguments
        return seen["made"].CASES[seen["case"]]()

    monkeypatch.setattr(diagnosis, "diagnose", engine, raising=False)
    monkeypatch.setattr(diagnosis, "diagnose_fmu", engine, raising=False)
    monkeypatch.setattr(diagnosis, "load_model", lambda path: f"model of {path.name}")
    monkeypatch.setattr(diagnosis, "fmu_model", lambda path: f"model in {path.name}")
    monkeypatch.setattr(
        diagnosis, "load_records", lambda model, paths: [model, *(path.name for path in paths)]
    )
    monkeypatch.setattr(
        export, "_build_plant", lambda augmented, out, fmi, related: out.write_bytes(b"plant")
    )
    monkeypatch.setattr(
        export,
        "_build_correction",
        lambda names, augmented, out, fmi, related: out.write_bytes(b"correction"),
    )
    return seen


def one_line(found: tuple[int, str, str], *words: str) -> None:
    code, _, error = found
    assert code == 2
    assert len(error.splitlines()) == 1, error
    for word in words:
        assert word in error


def test_it_prints_the_result_and_the_path_of_the_report(
    call: Call, asked: dict[str, Any], tmp_path: Path
) -> None:
    code, said, error = call(
        "diagnose", "m.toml", "--data", "a.csv", "--data", "b.csv", "--out", tmp_path / "out"
    )
    assert (code, error) == (0, "")
    assert asked["arguments"] == ("model of m.toml", ["model of m.toml", "a.csv", "b.csv"])
    lines = said.splitlines()
    assert lines[0] == "The model lacks: cogging torque"
    assert lines[1].startswith("Cogging explains the difference")
    row = next(line for line in lines if line.split()[1:2] == ["amplitude"])
    assert row.split() == ["cogging", "amplitude", "0.0600", "0.0582", "...", "0.0618", "N.m"]
    made = asked["made"].CASES["named"]()
    assert not any(line.startswith("What to measure next") for line in lines)  # all is clear
    assert all(f"  - {line}" in lines for line in made.findings)
    assert lines[-1] == f"named  {tmp_path / 'out' / 'report.html'}"
    assert set(os.listdir(tmp_path / "out")) == {*export.WRITTEN_FILES} - {export.EXPERIMENT_FILE}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("case", ["tie", "none", "not_identifiable", "proposals"])
def test_whatever_it_finds_it_completed(
    call: Call, asked: dict[str, Any], tmp_path: Path, case: str
) -> None:
    asked["case"] = case
    code, said, error = call("diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path)
    assert (code, error) == (0, "")
    assert "effect " not in said.splitlines()
    assert "report.html" in said
    made = asked["made"].CASES[case]()
    for line in made.proposals:
        assert line in said
    assert bool(made.experiment) == (case in ("tie", "none"))
    next_line = f"What to measure next: {made.experiment}"
    assert (next_line in said.splitlines()) == bool(made.experiment)
    assert ("give --choose: bias, asymmetric_coulomb" in said) == (case == "tie")


@pytest.mark.sampled(4)
def test_it_says_why_nothing_was_filled(call: Call, asked: dict[str, Any], tmp_path: Path) -> None:
    code, said, error = call("diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path, "--fill")
    assert (code, error) == (0, "")
    assert "No unnamed torque was added: nothing much is unexplained." in said.splitlines()
    assert "nothing much is unexplained" in (tmp_path / "report.html").read_text()
    assert (
        "No unnamed torque"
        not in call("diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path)[1]
    )


@pytest.mark.sampled(4)
def test_an_fmu_is_its_own_model_unless_there_is_one_beside_it(
    call: Call, asked: dict[str, Any], tmp_path: Path
) -> None:
    assert call("diagnose", "--fmu", "p.fmu", "--data", "a.csv", "--out", tmp_path)[0] == 0
    assert asked["arguments"] == (Path("p.fmu"), "model in p.fmu", ["model in p.fmu", "a.csv"])
    assert (
        call("diagnose", "m.toml", "--fmu", "p.fmu", "--data", "a.csv", "--out", tmp_path)[0] == 0
    )
    assert asked["arguments"] == (Path("p.fmu"), "model of m.toml", ["model of m.toml", "a.csv"])


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "args",
    [
        ["m.toml", "--data", "a.csv", "b.csv", "c.csv"],
        ["m.toml", "--data", "a.csv", "b.csv", "--data", "c.csv"],
        ["--data=a.csv", "b.csv", "c.csv", "m.toml"],
        ["--data", "a.csv", "b.csv", "--fmi", "3", "m.toml", "--data", "c.csv"],
    ],
)
def test_data_takes_all_files_behind_it(
    call: Call, asked: dict[str, Any], tmp_path: Path, args: list[str]
) -> None:
    assert call("diagnose", *args, "--out", tmp_path)[0] == 0
    assert asked["arguments"] == ("model of m.toml", ["model of m.toml", "a.csv", "b.csv", "c.csv"])


@pytest.mark.sampled(4)
def test_data_takes_patterns(call: Call, asked: dict[str, Any], tmp_path: Path) -> None:
    for name in ("run10.csv", "run2.csv", "run1.csv", "other.csv", "new/run3.csv", "odd[1].csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("t,u,theta\n")

    def given(*patterns: str) -> list[str]:
        assert (
            call(
                "diagnose",
                "m.toml",
                "--data",
                *(tmp_path / each for each in patterns),
                "--out",
                tmp_path / "out",
            )[0]
            == 0
        )
        return list(asked["arguments"][1][1:])

    assert given("run*.csv") == ["run1.csv", "run2.csv", "run10.csv"]
    assert given("other.csv", "run1?.csv", "odd[1].csv") == ["other.csv", "run10.csv", "odd[1].csv"]
    assert given("**/run[123].csv") == ["run3.csv", "run1.csv", "run2.csv"]


def test_a_member_of_a_tie_is_chosen(call: Call, asked: dict[str, Any], tmp_path: Path) -> None:
    asked["case"] = "tie"
    code, _, error = call(
        "diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path, "--choose", "bias"
    )
    assert (code, error) == (0, "")
    assert "[effects.bias]" in (tmp_path / "augmented.toml").read_text()


def test_a_choice_that_cannot_be_costs_no_report(
    call: Call, asked: dict[str, Any], tmp_path: Path
) -> None:
    asked["case"] = "tie"
    found = call("diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path, "--choose", "gravity")
    one_line(found, "chosen effect 'gravity'", "bias, asymmetric_coulomb", str(tmp_path))
    assert "report.html" in found[1]
    assert sorted(os.listdir(tmp_path)) == ["diagnosis.json", "report.html"]


def test_mistakes_are_one_line_before_time_is_spent(
    call: Call, asked: dict[str, Any], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    one_line(call("diagnose", "--data", "a.csv", "--out", tmp_path / "out"), "MODEL.toml", "--fmu")
    one_line(call("diagnose", "m.toml", "--out", tmp_path / "out"), "--data")
    one_line(
        call("diagnose", "m.toml", "a.csv", "--data", "b.csv"),
        "unexpected extra argument",
        "(a.csv)",
    )
    one_line(
        call("diagnose", "m.toml", "--data", tmp_path / "*.csv"),
        "*.csv: no file matches this pattern",
    )
    one_line(
        call(
            "diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path / "out", "--choose", "honey"
        ),
        "honey",
        "gravity",
    )
    one_line(
        call("diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path / "file"), "output folder"
    )
    assert "arguments" not in asked


def test_an_error_leaves_what_was_there(
    call: Call, asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> None:
        raise BristleError(f"{path}: friction missing; add it")

    (tmp_path / "report.html").write_text("old")
    monkeypatch.setattr(diagnosis, "load_model", refuse)
    found = call("diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path)
    one_line(found, "m.toml: friction missing")
    assert found[1] == ""
    assert os.listdir(tmp_path) == ["report.html"]
    assert (tmp_path / "report.html").read_text() == "old"
    one_line(
        call("diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path / "new" / "out"),
        "m.toml: friction missing",
    )
    assert os.listdir(tmp_path) == ["report.html"]


def test_an_interrupt_is_said_and_changes_nothing(
    call: Call, asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(
        *arguments: Any, progress: Callable[[str, float], None], options: SearchOptions
    ) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        progress("candidates", 0.5)

    monkeypatch.setattr(terminal, "_interrupts", [])
    monkeypatch.setattr(diagnosis, "diagnose", interrupted, raising=False)
    assert call("diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path / "out") == (
        2,
        "",
        "bristle: interrupted\n",
    )
    assert os.listdir(tmp_path) == []


def test_an_answer_that_cannot_be_written_is_said(
    call: Call, asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(output, "write_file", full)
    (tmp_path / "report.html").write_text("old")
    found = call("diagnose", "m.toml", "--data", "a.csv", "--out", tmp_path)
    one_line(found, "No space left")
    assert "Cogging explains" in found[1]
    assert "report.html" not in found[1]
    assert os.listdir(tmp_path) == ["report.html"]


def test_a_terminal_sees_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with terminal.fraction("diagnose") as tell:
        tell("candidates", 0.5)
        tell("writing", 1.0)
    assert "diagnose" in capsys.readouterr().err


def test_list_names_the_effects(call: Call) -> None:
    code, said, _ = call("list")
    assert code == 0
    assert "bias" in said
    assert "constant torque (class bias/asymmetric_coulomb)" in said


@pytest.mark.parametrize(
    "given", [("out/augmented.toml", "a.csv"), ("m.toml", "out/diagnosis.json")]
)
def test_what_is_read_is_not_written_over(
    given: tuple[str, str], call: Call, asked: dict[str, Any], tmp_path: Path
) -> None:
    paths = [tmp_path / name for name in given]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.write_text("mine")
    code, _, error = call("diagnose", paths[0], "--data", paths[1], "--out", tmp_path / "out")
    assert code == 2
    assert "would be replaced" in error
    assert "arguments" not in asked  # before time is spent
    assert [path.read_text() for path in paths] == ["mine", "mine"]
