"""The store of a sweep: what is written stays, what is damaged is seen, a run counts once."""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bristle.harness.sweep.store import Store

Message = Callable[[Callable[[], object]], str]
DESCRIPTION = {
    "scenario": "quick",
    "scenario_sha256": "",
    "vary": {},
    "runs": 4,
    "fmus": [],
    "provenance": {"date": "2020"},
}


def row(key: str, verdict: str = "pass", **more: object) -> dict[str, Any]:
    return {"key": key, "sweep": "s", "run": int(key), "verdict": verdict, **more}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    made = Store(tmp_path / "store")
    made.describe("one", DESCRIPTION)
    made.add([row("0", error=0.5), row("1", "fail", error=None)])
    made.add([row("2", sensor="clean"), row("3", "error", message="no")])
    return made


def test_rows_come_back_with_all_columns_and_null_where_there_is_nothing(store: Store) -> None:
    table = store.table()
    assert table["run"].to_pylist() == [0, 1, 2, 3]
    assert table["error"].to_pylist() == [0.5, None, None, None]
    assert table["sensor"].to_pylist() == [None, None, "clean", None]
    assert set(store.done()) == {"0", "1", "2"}  # what ended in an error is to be made again


def test_of_a_run_that_is_there_twice_the_one_without_error_counts(store: Store) -> None:
    pytest.importorskip("duckdb")
    store.add([row("3", "fail"), row("0", "pass", error=0.5)])
    assert store.table()["verdict"].to_pylist() == ["pass", "fail", "pass", "fail"]
    names, rows = store.query(
        "SELECT verdict, count(*) AS n FROM runs GROUP BY verdict ORDER BY verdict"
    )
    assert (names, rows) == (["verdict", "n"], [("fail", 2), ("pass", 2)])


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty"])
def test_a_damaged_file_costs_its_own_runs_only(store: Store, damage: str) -> None:
    victim = next(path for path in store.files() if b"sensor" in path.read_bytes())
    content = bytearray(victim.read_bytes())
    if damage == "flipped":
        place = content.index(b"no", 4)  # of a page: the message
        content[place] ^= 255
    victim.write_bytes(
        {"cut": content[: len(content) // 2], "empty": b""}.get(damage, bytes(content))
    )
    assert set(store.done()) == {"0", "1"}
    assert store.table()["run"].to_pylist() == [0, 1]


def test_a_page_that_is_not_what_was_written_is_refused(store: Store, message: Message) -> None:
    """A number that has changed is still a number: only the checksum of its page tells."""
    pytest.importorskip("duckdb")
    store.add([row("9", error=123.456)])
    victim = next(
        path
        for path in store.files()
        if b"9" in path.read_bytes() and pq.read_table(path)["run"].to_pylist() == [9]
    )
    content = bytearray(victim.read_bytes())
    place = content.index(struct.pack("<d", 123.456))
    content[place] ^= 1
    victim.write_bytes(bytes(content))
    assert pq.read_table(victim)["error"].to_pylist() != [123.456]  # readable, and wrong
    assert "resume the sweep, which repairs it" in message(store.table)
    assert "query: " in message(lambda: store.query("SELECT sum(error) FROM runs"))
    assert set(store.done()) == {"0", "1", "2"}


def test_a_full_disk_leaves_what_was_there(
    store: Store, monkeypatch: pytest.MonkeyPatch, message: Message
) -> None:
    before = sorted(os.listdir(store.path / "runs"))

    def full(_handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    line = message(lambda: store.add([row("9")]))
    assert "No space left on device; make room, then resume the sweep" in line
    assert sorted(os.listdir(store.path / "runs")) == before


def test_an_interrupt_while_a_file_is_written_is_an_interrupt(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_handle: int) -> None:
        try:
            raise KeyboardInterrupt
        finally:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        store.add([row("9")])


def test_what_is_no_store_is_refused(tmp_path: Path, message: Message) -> None:
    (tmp_path / "thesis.txt").write_text("years of work", encoding="utf-8")
    assert "is no store of bristle sweep, and not empty" in message(lambda: Store(tmp_path))
    assert "is a file" in message(lambda: Store(tmp_path / "thesis.txt"))
    assert "no store, or one without runs" in message(lambda: Store(tmp_path / "nothing").table())


def test_a_file_of_somebody_else_is_named(store: Store, message: Message) -> None:
    foreign = store.path / "runs" / "thesis.parquet"
    (store.path / "runs" / "folder.parquet").mkdir()
    before = store.done()
    pq.write_table(pa.table({"a": [1]}), foreign)
    for work in (store.done, store.table):
        assert (
            message(work) == f"{foreign}: holds no runs of bristle sweep; remove it from the store"
        )
    foreign.unlink()
    assert store.done() == before


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"provenance": {}}'])
def test_a_damaged_description_is_named_and_written_anew(
    store: Store, message: Message, content: str
) -> None:
    path = store.path / "sweeps" / "one.json"
    path.write_text(content, encoding="utf-8")
    line = message(store.sweeps)
    assert line.startswith(f"{path}: is damaged")
    assert "--resume" in line
    store.describe("one", DESCRIPTION)
    assert store.sweeps() == [DESCRIPTION]


def test_a_query_that_is_wrong_is_said_in_a_line(store: Store, message: Message) -> None:
    pytest.importorskip("duckdb")
    line = message(lambda: store.query("SELECT nothing FROM runs"))
    assert line.startswith("query: Binder Error")
    assert "query: says nothing" in message(lambda: store.query("-- later"))


def test_a_query_touches_no_other_file(store: Store, tmp_path: Path, message: Message) -> None:
    pytest.importorskip("duckdb")
    out, secret = tmp_path / "out.csv", tmp_path / "secret.csv"
    secret.write_text("a\n1\n", encoding="utf-8")
    lock = "SET enable_external_access = true"
    for sql in (
        f"COPY (SELECT run FROM runs) TO '{out}'",
        f"SELECT * FROM read_csv('{secret}')",
        f"ATTACH '{tmp_path / 'db'}'",
        lock,
    ):
        assert message(lambda sql=sql: store.query(sql)).startswith("query: ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["secret.csv", "store"]
