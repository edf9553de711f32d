"""docs/diagnosis.md: its model file can be read, and every key, file and verdict of an answer is in
it.
"""

from __future__ import annotations

import ast
import math
import re
import tomllib
from pathlib import Path

import pytest

import bristle
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report import export
from bristle.diagnosis.report.headline import VERDICT_WORDS

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "diagnosis.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The first block of code in a language."""
    found = re.search(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert found is not None
    return found[1]


def test_the_model_file_is_one_and_fits_the_record_beside_it():
    model = Model.from_dict(tomllib.loads(block("toml")))
    assert model.parameters == {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12}
    assert model.resolution == pytest.approx(math.radians(0.088))
    assert block("").splitlines()[0].split(",") == [
        model.time.column,
        model.input.column,
        model.output.column,
    ]


def test_what_the_program_calls_is_there():
    calls = [
        node.func for node in ast.walk(ast.parse(block("python"))) if isinstance(node, ast.Call)
    ]
    names = {
        call.attr
        for call in calls
        if isinstance(call, ast.Attribute) and getattr(call.value, "id", "") == "bristle"
    }
    assert "diagnose" in names
    assert all(callable(getattr(bristle, name)) for name in names)


def test_every_key_file_and_verdict_is_explained(answer):
    explained = set(re.findall(r"(?<!`)`([^`\n]+)`(?!`)", PAGE))
    content = answer("named").to_dict()
    keys = {
        *content,
        *content["effects"][0],
        *content["gap"],
        *content["remains"],
        *content["where"][0],
    }
    keys |= set(next(iter(content["effects"][0]["parameters"].values())))
    assert keys <= explained
    assert {*export.WRITTEN_FILES, *VERDICT_WORDS, "chosen", "--choose NAME"} <= explained


PAGES = [*DOCS.glob("*.md"), DOCS.parent / "README.md"]


@pytest.mark.parametrize("page", sorted(page.relative_to(DOCS.parent).as_posix() for page in PAGES))
def test_links_lead_somewhere(page):
    path = DOCS.parent / page
    targets = re.findall(r"\]\(([^)#:\s]+)[^)]*\)", path.read_text(encoding="utf-8"))
    assert [target for target in targets if not (path.parent / target).exists()] == []
