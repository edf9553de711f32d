"""The notebooks of examples/ run from top to bottom, and are committed without outputs."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples"
SAID = {  # what the outputs of each must hold
    "first_run": [
        "quick: pass",
        "('pass', 0.5)",
        "report.html True",
        "<th>alpha2</th>",
        "image/png",
    ],
    "diagnosis": ["dead_zone", "augmented.toml", "(named)"],
    "outside_observer": [
        "bristle_gradient",
        "gradient: pass",
        "AdaptiveObserver_gradient.fmu",
        "gamma = 0.2",
    ],
}


def cells(name: str) -> list[Any]:
    return list(nbformat.read(FOLDER / f"{name}.ipynb", as_version=4).cells)


def test_every_notebook_is_here_and_linked():
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == set(SAID)
    linked = (ROOT / "docs" / "getting_started.md").read_text(encoding="utf-8")
    assert all(f"../examples/{name}.ipynb" in linked for name in SAID)


@pytest.mark.parametrize("name", list(SAID))
def test_it_is_committed_without_outputs(name):
    code = [cell for cell in cells(name) if cell.cell_type == "code"]
    assert len(code) > 4
    assert all(cell.outputs == [] and cell.execution_count is None for cell in code)


@pytest.mark.sampled(4)
def test_the_extra_brings_what_a_fresh_environment_needs():
    """What they import; and what builds the package that one of them installs, without isolation
    and so from the environment: an old version of it may be there, or none.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    assert "bristle[frames]" in extras["notebooks"]
    brought = {
        re.split(r"[<>=\[]", each)[0]
        for each in [*project["dependencies"], *extras["frames"], *extras["notebooks"]]
    }
    distributions, imported = packages_distributions(), set()
    for name in SAID:
        source = "\n".join(cell.source for cell in cells(name) if cell.cell_type == "code")
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                imported |= {each.name.split(".")[0] for each in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                imported.add(node.module.split(".")[0])
    outside = {name for name in imported if name not in sys.stdlib_module_names}
    assert {"bristle", "matplotlib", "xarray"} <= outside
    assert all(brought & set(distributions[name]) for name in outside)
    template = (ROOT / "cli" / "templates" / "pyproject.txt").read_text(encoding="utf-8")
    built_with = re.search(r'requires = \["([^"]+)"\]', template)
    assert built_with is not None
    assert built_with[1] in extras["notebooks"]


@pytest.mark.slow
@pytest.mark.parametrize("name", list(SAID))
def test_it_runs(name):
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    nbclient.NotebookClient(
        notebook, timeout=600, resources={"metadata": {"path": str(FOLDER)}}
    ).execute()
    outputs = [
        output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs
    ]
    assert not [
        output
        for output in outputs
        if output.output_type == "error" or output.get("name") == "stderr"
    ]
    text = "\n".join(str(output) for output in outputs)
    for words in SAID[name]:
        assert words in text, f"{name}: {words}"
