"""The references of scenario and model files describe every key."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.parametrize("page", ["scenario_reference.md", "model_reference.md"])
def test_every_key_has_a_type_and_a_meaning(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    rows = [
        line.strip("| ").split(" | ")
        for line in text.splitlines()
        if re.match(r"\| `\w+` \|", line) and line.count(" | ") >= 5
    ]
    assert len(rows) > 8
    for row in rows:
        key, meaning, kind, *_ = row
        assert kind.strip(), key
        assert len(meaning.split()) >= 2, (key, meaning)
