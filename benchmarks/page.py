"""Sections of docs/diagnosis.md that benchmarks write, between comments that mark them."""

from __future__ import annotations

from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "diagnosis.md"


def put(name: str, program: str, text: str, page: Path = PAGE) -> None:
    """Replace the section of this name, or add it at the end; `program` is the script that writes
    it.
    """
    begin, end = f"<!-- {name}: written by {program} -->", f"<!-- end of {name} -->"
    old = page.read_text(encoding="utf-8")
    section = f"{begin}\n{text.strip()}\n\n{end}\n"
    if begin in old and end in old:
        new = old[: old.index(begin)] + section + old[old.index(end) + len(end) + 1 :]
    else:
        new = f"{old.rstrip()}\n\n{section}"
    page.write_text(new, encoding="utf-8")
