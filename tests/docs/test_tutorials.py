"""The tutorials: every command runs, and prints what the page shows."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
_spec = importlib.util.spec_from_file_location("consoles", DOCS / "consoles.py")
assert _spec is not None
assert _spec.loader is not None
consoles = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(consoles)

PAGES = sorted(path.name for path in consoles.TUTORIALS.glob("*.md"))
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?!\w)")
CLOCK = re.compile(r" +\d+\.\d s ")  # how long a run took
TOLERANCE = 0.1  # of numbers: sticking friction amplifies how a processor rounds


def same(shown: str, printed: str) -> None:
    """Compare words exactly and numbers to the tolerance."""
    texts = [" ".join(CLOCK.sub(" # s ", text).split()) for text in (shown, printed)]
    assert NUMBER.sub("#", texts[0]) == NUMBER.sub("#", texts[1])
    numbers = [[float(number) for number in NUMBER.findall(text)] for text in texts]
    np.testing.assert_allclose(numbers[1], numbers[0], rtol=TOLERANCE, atol=0.02)


def test_all_ten_are_there():
    assert PAGES == [
        "arm.md",
        "diagnose.md",
        "drive_trace.md",
        "fmu.md",
        "log_files.md",
        "own_observer.md",
        "own_scenario.md",
        "rig.md",
        "run.md",
        "smart_servo.md",
    ]


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_print_what_the_page_shows(page):
    text = (DOCS / "tutorials" / page).read_text(encoding="utf-8")
    shown, printed = consoles.commands(text), consoles.outputs(text)
    assert len(shown) == len(printed) > 0
    for (_, expected), found in zip(shown, printed, strict=True):
        same(expected, found)


def test_progress_is_no_output():
    page = "```console\n$ echo 'diagnose: trying gravity, 41%'; echo 41%\n```\n"
    assert consoles.outputs(page) == ["41%\n"]


@pytest.mark.parametrize(
    ("shown", "printed"), [("error 0.30 %", "error 0.90 %"), ("ok b", "failed b"), ("", "an error")]
)
def test_another_output_is_noticed(shown, printed):
    with pytest.raises(AssertionError):
        same(shown, printed)
