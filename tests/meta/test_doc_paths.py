"""Files that the pages name are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
FOLDERS = "cli|common|model|plant|observer|records|fmus|harness|diagnosis|benchmarks|tests|scripts"
NAMED = re.compile(rf"`((?:{FOLDERS})/[\w/.-]+)`")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_file_that_is_named_is_there(page: Path) -> None:
    named = set(NAMED.findall(page.read_text(encoding="utf-8")))
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_some_page_names_some_file() -> None:
    assert any(NAMED.search(page.read_text(encoding="utf-8")) for page in PAGES)
