"""What the system refuses, and what no one means to give: one line that names it, exit code 2,
nothing written.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.cli.terminal import CUT_WORD, LONGEST_WORD

HIDDEN = Path(__file__).resolve().parents[2] / "scenarios" / "hidden" / "07"
LITTLE_MEMORY = 300_000  # kB
DIGITS = "1" * 5000  # more than Python reads as a whole number

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def folder(case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with a scenario, a model, a record, and links that lead nowhere."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(HIDDEN / "model.toml", tmp_path)
    with np.load(HIDDEN / "a.npz") as record:
        np.savez(tmp_path / "a.npz", **{name: values[:3000] for name, values in record.items()})
    for name in ("loop", "loop.toml"):
        Path(name).symlink_to(name)
    return tmp_path


def refused(call: Call, *arguments: object, said: str) -> None:
    before = sorted(os.listdir())
    code, _, line = call(*arguments)
    assert code == 2
    assert line.count("\n") == 1
    assert said in line
    assert "--debug" not in line
    assert len(line) < 1000
    assert sorted(os.listdir()) == before


def with_line(path: str, old: str, new: str) -> str:
    text = Path(path).read_text()
    assert old in text
    Path("changed.toml").write_text(text.replace(old, new))
    return "changed.toml"


@pytest.mark.parametrize("value", [DIGITS, f"-{DIGITS}", "[" * 3000])
def test_a_number_that_is_too_long(call: Call, folder: Path, value: str) -> None:
    what = (
        "brackets inside brackets"
        if "[" in value
        else "a number of more than 4300 digits; write fewer"
    )
    refused(call, "run", "case.toml", "--set", f"plant.parameters.J={value}", said=what)
    refused(call, "run", with_line("case.toml", '"1 s"', value), said=f"changed.toml: {what}")
    refused(
        call,
        "diagnose",
        with_line("model.toml", "0.0103601", value),
        "--data",
        "a.npz",
        said=f"changed.toml: {what}",
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "case.toml", "--set", DIGITS],
        ["run", DIGITS],
        ["run", "case.toml", "--out", DIGITS],
        ["build", "plant", "--law", DIGITS],
        ["diagnose", "model.toml", "--data", "a.npz", "--budget", f"{DIGITS}s"],
    ],
)
def test_what_is_long_is_cut(call: Call, folder: Path, arguments: list[str]) -> None:
    refused(call, *arguments, said="1" * (CUT_WORD - 1))
    assert len(DIGITS) > LONGEST_WORD


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "loop.toml"], "loop.toml: Too many levels"),
        (["run", "case.toml", "--out", "loop"], "output folder loop"),
        (["diagnose", "loop.toml", "--data", "a.npz"], "loop.toml: Too many levels"),
        (["diagnose", "model.toml", "--data", "loop"], "loop"),
        (["diagnose", "model.toml", "--data", "a.npz", "--out", "loop"], "loop"),
        (["validate", "model.toml", "--data", "a.npz", "--out", "loop"], "loop"),
        (["init", "loop", "--out", "m.toml"], "loop"),
        (["init", "a.npz", "--out", "loop.toml"], "loop.toml: exists already"),
        (["check", "loop"], "loop: Too many levels"),
    ],
)
def test_a_link_to_itself(call: Call, folder: Path, arguments: list[str], said: str) -> None:
    refused(call, *arguments, said=said)


def test_a_table_is_no_number(call: Call, folder: Path) -> None:
    refused(
        call,
        "run",
        "case.toml",
        "--set",
        "plant.parameters.J={}",
        said="plant.parameters.J = {}: must be one value, not a table",
    )
    refused(
        call,
        "run",
        with_line("case.toml", "min = 1", "min = {}"),
        said="checks[0].min = {}: must be",
    )
    refused(call, "run", with_line("case.toml", '"1 s"', "{}"), said="duration: not a quantity")
    model = with_line("model.toml", "0.0103601", "{}")
    refused(
        call,
        "diagnose",
        model,
        "--data",
        "a.npz",
        said="parameters.J = {}: must be a number [kg.m2]",
    )
    model = with_line("model.toml", "resolution = 1", "resolution = {}")
    refused(
        call,
        "diagnose",
        model,
        "--data",
        "a.npz",
        said="output.resolution = {}: must be one value, not a table",
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "arguments", [["--version"], ["schema", "model"], ["build", "controller", "--out", "fmus"]]
)
def test_a_full_standard_output(folder: Path, arguments: list[str]) -> None:
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "bristle", *arguments]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    line = "bristle: standard output: No space left on device; give it another place\n"
    assert (done.returncode, done.stderr) == (2, line)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("arguments", [["--version"], ["schema", "model"]])
def test_a_reader_that_has_gone_is_no_verdict(folder: Path, arguments: list[str]) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "bristle", *arguments]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (
        2,
        "bristle: standard output: nobody reads it any more\n",
    )


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs a shell")
@pytest.mark.parametrize("closed", ["0<&- >&-", ">&-", "2>&-", "0<&- >&- 2>&-"])
def test_closed_streams_lead_nowhere(folder: Path, closed: str) -> None:
    """And no file takes the number of one of them, so that nothing that is printed lands in it."""
    command = f"{sys.executable} -m bristle schema model {closed}"
    done = subprocess.run(
        ["sh", "-c", f"{command}; echo $?"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "0"
    assert "Error" not in done.stderr
    command = f"{sys.executable} -m bristle build controller --out fmus {closed}"
    done = subprocess.run(
        ["sh", "-c", f"{command}; echo $?"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "0"
    assert all(path.read_bytes()[:2] == b"PK" for path in Path("fmus").glob("*.fmu"))
    assert list(Path("fmus").glob("*.fmu"))


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "bristle: no memory left; end other programs, or allow more (ulimit -v)"),
        (
            OSError(28, "No space left on device"),
            "bristle: temporary folder {}: No space left on device; make room, or set TMPDIR",
        ),
        (
            PermissionError(13, "Permission denied", "x"),
            "bristle: x: Permission denied; check the path, its rights and the room there",
        ),
    ],
)
def test_what_the_system_refuses(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, said: str
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda place: SimpleNamespace(free=0))

    def fail(*_arguments: object) -> None:
        raise error

    monkeypatch.setattr("bristle.harness.scenario.catalogue.find_scenario", fail)
    refused(call, "run", "case.toml", said=said.format(tempfile.gettempdir()))


def test_a_full_temporary_folder_is_named(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("fmpy.extract", full)
    refused(
        call,
        "run",
        "case.toml",
        said=": No space left on device; make room, or set TMPDIR to another folder",
    )


@pytest.mark.sampled(4)
def test_a_home_that_cannot_be_used(folder: Path) -> None:
    environment = {
        key: value
        for key, value in os.environ.items()
        if key not in ("BRISTLE_CACHE", "XDG_CACHE_HOME")
    }
    environment["HOME"] = "/dev/null"
    command = [sys.executable, "-m", "bristle", "run", "case.toml"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert (
        done.stderr
        == "bristle: cache folder /dev/null/.cache/bristle: Not a directory; set BRISTLE_CACHE to a"
        " folder you can write\n"
    )


@pytest.mark.sampled(4)
@pytest.mark.skipif(sys.platform != "linux", reason="limits memory as Linux does")
def test_no_memory_is_one_line(folder: Path) -> None:
    """Of the libraries some end the process themselves below that."""
    command = [
        "/bin/sh",
        "-c",
        f'ulimit -v {LITTLE_MEMORY}; exec "$0" "$@"',
        sys.executable,
        "-m",
        "bristle",
    ]
    asked = ["diagnose", "model.toml", "--data", "a.npz", "--jobs", "1"]
    done = subprocess.run([*command, *asked], capture_output=True, text=True, check=False)
    assert done.returncode in (0, 2)
    assert "Traceback" not in done.stderr
    assert "--debug" not in done.stderr
