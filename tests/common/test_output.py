"""Files are put into a folder all or none, also if the process is killed meanwhile; what a killed
process left is swept.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bristle.common import output
from bristle.common.errors import BristleError
from bristle.common.output import (
    PAGE,
    PAGE_COMMANDS,
    check_page,
    check_writable,
    output_folder,
    replace_each,
    replace_file,
    replace_files,
)
from bristle.common.work import JOURNAL, OLD, TemporaryFolder, lock, sweep, unlock

OLDER = {"a": "old", "b": "old", "gone": "old", "thesis.txt": "precious"}
CONTENT = {"a": b"new", "b": b"new", "sub/c": b"new"}
NAMES = [*CONTENT, "gone"]
NEWER = {"a": "new", "b": "new", "sub/c": "new", "thesis.txt": "precious"}


def found(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in folder.rglob("*")
        if path.is_file()
    }


def fill(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    for name, text in OLDER.items():
        (folder / name).write_text(text)


KILLED_AT = """
import os, signal, sys
from pathlib import Path
from bristle.common import output

real, calls = os.replace, []

def replace(source, target):
    calls.append(target)
    if len(calls) == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGKILL)
    real(source, target)

os.replace = replace
output.replace_files(Path(), {name: b"new" for name in sys.argv[2].split()}, sys.argv[3].split())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("call", range(1, 9))
def test_a_kill_leaves_the_old_files_or_the_new_ones(tmp_path: Path, call: int) -> None:
    fill(tmp_path)
    command = [sys.executable, "-c", KILLED_AT, str(call), " ".join(CONTENT), " ".join(NAMES)]
    done = subprocess.run(command, cwd=tmp_path, check=False)
    assert done.returncode == (-signal.SIGKILL if call < 8 else 0)
    check_writable(tmp_path)
    held = {
        name: text for name, text in found(tmp_path).items() if not name.startswith(".bristle-")
    }
    assert held == (OLDER if call == 1 else NEWER)
    if call > 1:  # what has no journal is swept when it is old
        assert not list(tmp_path.glob(".bristle-*"))


def test_an_undo_that_is_cut_short_is_finished_forwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(tmp_path)
    real, calls = os.replace, []

    def replace(source: Path, target: Path) -> None:
        calls.append(target)
        if len(calls) in (5, 7):
            raise OSError("no more")
        real(source, target)

    monkeypatch.setattr(output.os, "replace", replace)
    with pytest.raises(BristleError, match="no more"):
        replace_files(tmp_path, CONTENT, NAMES)
    monkeypatch.undo()
    check_writable(tmp_path)
    assert found(tmp_path) == NEWER


@pytest.mark.parametrize(
    "text",
    ["", "[]", '{"new": ["../x"], "gone": []}', '{"new": [], "gone": ["/etc/x"]}', '{"new": [1]}'],
)
def test_a_journal_that_is_not_ours_moves_nothing(tmp_path: Path, text: str) -> None:
    (tmp_path / ".bristle-abcdefgh").mkdir()
    (tmp_path / ".bristle-abcdefgh" / JOURNAL).write_text(text)
    with pytest.raises(BristleError, match="is no journal of bristle; remove the folder"):
        check_writable(tmp_path)


def test_files_of_one_folder_are_put_there_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "other").mkdir()
    replace_each({tmp_path / "a": b"1", tmp_path / "b": b"2", tmp_path / "other" / "c": b"3"})
    assert found(tmp_path) == {"a": "1", "b": "2", "other/c": "3"}
    monkeypatch.setattr(
        output, "_forward", lambda *arguments: (_ for _ in ()).throw(OSError("no more"))
    )
    with pytest.raises(BristleError, match="no more"):
        replace_each({tmp_path / "a": b"4", tmp_path / "b": b"5"})
    assert found(tmp_path) == {"a": "1", "b": "2", "other/c": "3"}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a pipe with a name")
def test_what_is_no_ordinary_file_is_written_to(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    replace_file(tmp_path / "pipe", b"text")
    assert os.read(reader, 9) == b"text"
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()
    with pytest.raises(
        BristleError, match=r"/dev/full: No space left on device; give another file"
    ):
        replace_file(Path("/dev/full"), b"text")


def aged(folder: Path, age: float) -> Path:
    folder.mkdir()
    os.utime(folder, (time.time() - age,) * 2)
    return folder


def test_only_what_is_old_and_ours_is_swept(tmp_path: Path) -> None:
    left = aged(tmp_path / ".bristle-abcdefgh", 2 * OLD)
    also = aged(tmp_path / ".bristle-fmu-abcd_fg1", 2 * OLD)
    kept = [
        aged(tmp_path / ".bristle-new00000", 0.5 * OLD),
        aged(tmp_path / ".bristle-mine", 2 * OLD),
        aged(tmp_path / "x", 2 * OLD),
    ]
    journal = aged(tmp_path / ".bristle-journal0", 0.0)
    (journal / JOURNAL).write_text("{}")
    os.utime(journal, (1.0, 1.0))
    sweep(tmp_path)
    assert not left.exists()
    assert not also.exists()
    assert all(path.exists() for path in [*kept, journal])


@pytest.mark.skipif(sys.platform == "win32", reason="cannot lock a folder")
def test_what_another_process_uses_is_not_swept_however_old(tmp_path: Path) -> None:
    folder = TemporaryFolder("fmu", tmp_path)
    os.utime(folder.name, (1.0, 1.0))
    sweep(tmp_path)
    assert Path(folder.name).exists()
    folder.cleanup()
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(sys.platform == "win32", reason="cannot lock a folder")
def test_a_lock_is_held_once_and_ends(tmp_path: Path) -> None:
    first = lock(tmp_path)
    assert first is not None
    assert lock(tmp_path) is None
    unlock(first)
    again = lock(tmp_path)
    assert again is not None
    unlock(again)
    assert os.listdir(tmp_path) == []


def test_the_journal_says_what_comes_and_what_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(tmp_path)
    seen = []

    def look(work: Path, *_rest: object) -> None:
        seen.append(json.loads((work / JOURNAL).read_text()))

    monkeypatch.setattr(output, "_forward", look)
    replace_files(tmp_path, CONTENT, NAMES)
    assert seen == [{"new": ["a", "b", "sub/c"], "gone": ["gone"]}]


@pytest.mark.parametrize("mine", PAGE_COMMANDS)
def test_the_page_of_another_command_is_not_replaced(mine: str, tmp_path: Path) -> None:
    (tmp_path / PAGE).write_text("old")
    check_page(tmp_path, mine)  # nobody's
    (tmp_path / mine).write_text("{}")
    check_page(tmp_path, mine)  # its own
    for other, command in PAGE_COMMANDS.items():
        if other == mine:
            continue
        (tmp_path / other).write_text("{}")
        before = found(tmp_path)
        with pytest.raises(BristleError) as raised, output_folder(tmp_path, mine):
            (tmp_path / PAGE).write_text("new")
        assert str(raised.value) == (
            f"{tmp_path}: 'report.html' in it is of bristle {command}; give another folder, such as"
            f" {tmp_path / PAGE_COMMANDS[mine]}"
        )
        assert found(tmp_path) == before
        (tmp_path / other).unlink()
