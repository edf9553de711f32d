"""The notebooks of examples/ run from top to bottom, and are committed without outputs."""

from __future__ import annotations

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
