"""The result folder is all or nothing."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bristle.common import output
from bristle.harness.run import results

Message = Callable[[Callable[[], object]], str]
FILES: dict[str, str | bytes] = {"a.json": "{}", "b.bin": b"\0\1"}


def names(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))


def test_a_folder_is_written_and_replaced_as_a_whole(tmp_path: Path) -> None:
    results.write(tmp_path, "case", {"result.json": "{}", "old.csv": "old"})
    results.write(tmp_path, "case", FILES)
    assert names(tmp_path) == ["case"]
    assert names(tmp_path / "case") == ["a.json", "b.bin"]


@pytest.mark.parametrize("strange", ["folder", "result folder with more in it", "file", "link"])
def test_what_is_not_ours_is_never_replaced(tmp_path: Path, message: Message, strange: str) -> None:
    target = tmp_path / "case"
    if strange == "file":
        target.write_text("precious")
    elif strange == "link":
        (tmp_path / "elsewhere").mkdir()
        target.symlink_to(tmp_path / "elsewhere")
    else:
        target.mkdir()
        (target / "thesis.txt").write_text("precious")
        if strange != "folder":
            (target / "result.json").write_text("{}")
    before = sorted(tmp_path.rglob("*"))
    assert "no result folder" in message(lambda: results.write(tmp_path, "case", FILES))
    assert sorted(tmp_path.rglob("*")) == before


def test_a_full_disk_keeps_the_old_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, message: Message
) -> None:
    results.write(tmp_path, "case", {"result.json": "{}", "old.csv": "old"})

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(output.os, "fsync", full)
    line = message(lambda: results.write(tmp_path, "case", FILES))
    assert "No space left" in line
    assert str(tmp_path) in line
    assert names(tmp_path) == ["case"]
    assert (tmp_path / "case" / "old.csv").read_text() == "old"


@pytest.mark.parametrize("call", range(1, 4))
@pytest.mark.parametrize("error", [OSError(errno.EACCES, "Permission denied"), KeyboardInterrupt()])
def test_an_exchange_that_fails_puts_the_old_result_back(
    error: BaseException, call: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results.write(tmp_path, "case", {"result.json": "{}", "old.csv": "old"})
    real, calls = os.replace, []

    def replace(source: Path, target: Path) -> None:
        calls.append(target)
        if len(calls) == call:
            raise error
        real(source, target)

    monkeypatch.setattr(output.os, "replace", replace)
    with pytest.raises((ValueError, KeyboardInterrupt)):
        results.write(tmp_path, "case", FILES)
    assert names(tmp_path) == ["case"]
    assert names(tmp_path / "case") == ["old.csv", "result.json"]


def test_a_file_in_the_way_is_one_line(tmp_path: Path, message: Message) -> None:
    (tmp_path / "out").write_text("a file")
    for call in (
        lambda: output.check_writable(tmp_path / "out"),
        lambda: results.write(tmp_path / "out", "case", FILES),
    ):
        assert "output folder" in message(call)


def test_csv_is_thinned_to_what_a_person_can_open(tmp_path: Path) -> None:
    columns = {"time": np.arange(100_001) * 1e-3, "x": np.full(100_001, np.nan)}
    thin, full = (results.to_csv(columns, full=each).splitlines() for each in (False, True))
    assert (len(thin), len(full)) == (2001, 100_002)
    assert thin[0] == "time,x"
    assert (thin[1], thin[-1]) == ("0,nan", "100,nan")
