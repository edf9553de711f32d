"""The generated pages of docs/ are what the definitions of what is shipped say today."""

from __future__ import annotations

import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = tomllib.loads((ROOT / "tests" / "shipped.toml").read_text(encoding="utf-8"))
_spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
assert _spec is not None
assert _spec.loader is not None
generate = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(generate)


@pytest.mark.parametrize("name", sorted(generate.PAGES))
def test_page_is_up_to_date(name):
    committed = (ROOT / "docs" / name).read_text(encoding="utf-8")
    page = generate.PAGES[name]
    assert committed in (page(), page(SHIPPED)), f"docs/{name} is old; run: python docs/generate.py"


def test_the_readme_counts_what_is_shipped():
    page = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"observer with {len(SHIPPED['observers'])} methods" in page
    assert f"effect out of {len(SHIPPED['effects'])}," in page
    assert (len(SHIPPED["laws"]), "LuGre and eleven other laws" in page) == (12, True)


COUNTED = re.compile(
    r"(?<!of )\b(\d{2,}) (?:more )?\[?(effects|laws|friction laws|methods|observers)\b"
)


def test_whoever_counts_what_is_shipped_counts_right():
    """In docs, readme and docstrings; numbers of two digits and more, others may be of a part."""
    kinds = {"friction laws": "laws", "methods": "observers"}
    read = [
        path
        for path in [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("docs/tutorials/*.md")]
        if path.name != "calibration.md"  # of measurements, each with what there was then
    ]
    for room in ("package", "cli", "common", "diagnosis", "fmus", "harness", "observer", "plant"):
        read += (ROOT / room).rglob("*.py")
    found = [
        (path.name, words, int(count), len(SHIPPED[kinds.get(kind, kind)]))
        for path in read
        for words, count, kind in (
            (hit[0], hit[1], hit[2])
            for hit in COUNTED.finditer(" ".join(path.read_text(encoding="utf-8").split()))
        )
    ]
    assert len(found) >= 5
    assert [each for each in found if each[2] != each[3]] == []
