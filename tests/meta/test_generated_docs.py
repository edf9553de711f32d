"""The generated pages of docs/ are what the definitions of what is shipped say today."""

from __future__ import annotations

import importlib.util
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
