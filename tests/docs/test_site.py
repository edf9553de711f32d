"""The documentation site builds without a dead link, a missing anchor or a page that no navigation
names.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytest.importorskip("mkdocs")


def build(config: Path, site: Path) -> subprocess.CompletedProcess[str]:
    """Build a site strictly, without a network."""
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--config-file",
        str(config),
        "--site-dir",
        str(site),
    ]
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_the_site_builds_strictly(tmp_path):
    done = build(ROOT / "mkdocs.yml", tmp_path / "site")
    assert done.returncode == 0, done.stdout + done.stderr
    site = tmp_path / "site"
    pages = {
        str(path.relative_to(site)): path.read_text(encoding="utf-8")
        for path in site.rglob("*.html")
    }
    assert "<h1" in pages["index.html"]
    # no script, font or picture of another place
    assert not [name for name, text in pages.items() if 'src="http' in text]
    # with the next file, search in pages opened as files
    assert '<script src="iframe-worker.js">' in pages["index.html"]
    assert "Glossary" in (site / "search" / "search_index.js").read_text(encoding="utf-8")


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[a](missing.md)", "missing.md"),
        ("[a](index.md#nowhere)", "nowhere"),
        ("![a](missing.png)", "missing.png"),
        ("a", "lost.md"),
    ],
)
def test_a_dead_link_fails_the_build(tmp_path, text, named):
    pages = tmp_path / "docs"
    pages.mkdir()
    (pages / "index.md").write_text(f"# Page\n\n{text}\n", encoding="utf-8")
    if named == "lost.md":
        (pages / "lost.md").write_text(
            "# A page that the navigation does not name\n", encoding="utf-8"
        )
    config = tmp_path / "mkdocs.yml"
    config.write_text(
        f"INHERIT: {ROOT / 'mkdocs.yml'}\ndocs_dir: {pages}\nhooks: []\nnav: [index.md]\nextra_css:"
        " []\n",
        encoding="utf-8",
    )
    done = build(config, tmp_path / "site")
    assert done.returncode != 0
    assert named in done.stdout + done.stderr
