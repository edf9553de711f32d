"""Commands that write into one folder: none replaces the page of another."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from bristle.common.output import PAGE, PAGE_COMMANDS

Call = Callable[..., tuple[int, str, str]]
EXAMPLE = Path(__file__).resolve().parents[2] / "scenarios" / "hidden" / "01"


def commands(out: Path) -> dict[str, list[object]]:
    """Return a command of each kind that writes a page straight into `out`."""
    data = [part for name in ("a.npz", "b.npz") for part in ("--data", EXAMPLE / name)]
    return {
        "diagnosis.json": ["diagnose", EXAMPLE / "model.toml", *data, "--out", out],
        "validation.json": ["validate", EXAMPLE / "model.toml", *data, "--out", out],
        "coupling.json": ["coupling", "quick", "--out", out],
        "report.json": ["report", out.parent / "store", "--out", out],
        "reproduce.json": ["reproduce", "--out", out],
    }


@pytest.mark.parametrize("mine", sorted(set(PAGE_COMMANDS) - {"result.json"}))
def test_a_command_refuses_the_folder_of_another_before_it_begins(
    mine: str, call: Call, tmp_path: Path
) -> None:
    out, store = tmp_path / "out", tmp_path / "store"
    out.mkdir()
    for folder in ("sweeps", "runs"):
        (store / folder).mkdir(parents=True)
    for name in (PAGE, "result.json"):
        (out / name).write_text("{}")
    code, said, complaint = call(*commands(out)[mine])
    assert (code, said) == (2, "")
    assert complaint == (
        f"bristle: {out}: 'report.html' in it is of bristle run; give another folder, such as"
        f" {out / PAGE_COMMANDS[mine]}\n"
    )
    assert {path.name: path.read_text() for path in out.iterdir()} == {
        PAGE: "{}",
        "result.json": "{}",
    }


@pytest.mark.sampled(4)
def test_a_validation_replaces_its_own_page_and_a_run_no_page_of_a_validation(
    call: Call, tmp_path: Path
) -> None:
    out = tmp_path / "quick"
    for _ in range(2):
        code, _, complaint = call(*commands(out)["validation.json"])
        assert (code, complaint) == (0, "")
    records = json.loads((out / "validation.json").read_text())["records"]
    assert len(records) == 2
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    code, _, complaint = call("run", "quick", "--out", tmp_path)
    assert code == 2
    assert complaint.startswith(f"bristle: {out}: 'report.html' in it is of bristle validate;")
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
