"""Find functions that are too complex or too long: python scripts/functions.py

Prints each, and exits with 1 if there is one. Complexity is radon's; in tests, asserts do not count
as branches. Lines are counted from `def` to the last one, without the docstring.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

from radon.complexity import cc_visit_ast
from radon.visitors import Class, Function

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = (
    *("cli", "common", "docs", "examples", "fmus", "model", "observer", "package", "plant"),
    *("records", "scripts", "benchmarks", "tests"),
    *("harness", "diagnosis"),
)
MOST_COMPLEX = 15
MOST_LINES = 50


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the lines of a function, without its docstring."""
    documented = ast.get_docstring(function, clean=False) is not None
    skipped = function.body[0] if documented else None
    told = 0 if skipped is None else (skipped.end_lineno or 0) - skipped.lineno + 1
    return (function.end_lineno or 0) - function.lineno + 1 - told


def complexities(tree: ast.Module, asserts: bool) -> Iterator[tuple[Function, int]]:
    """Give each function and method with its complexity."""
    for block in cc_visit_ast(tree, no_assert=not asserts):
        if not isinstance(block, Class):
            yield block, block.complexity


def mistakes(path: Path) -> Iterator[str]:
    """Give a line for each function of a file that is too complex or too long."""
    place = path.relative_to(ROOT)
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for block, found in complexities(tree, place.parts[0] != "tests"):
        if found > MOST_COMPLEX:
            yield f"{place}:{block.lineno}: {block.name} has complexity {found} > {MOST_COMPLEX}"
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            lines = length(node)
            if lines > MOST_LINES:
                yield f"{place}:{node.lineno}: {node.name} has {lines} lines > {MOST_LINES}"


def main() -> int:
    """Look at all folders."""
    paths = (path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py")))
    found = [line for path in paths for line in mistakes(path)]
    print("\n".join(found), end="\n" if found else "")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
