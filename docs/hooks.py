"""Hooks of mkdocs: pages outside docs/ join the site, and links lead to the same place in the
repository and on the site.

README.md is the first page. Every file that a page links to and that is not in docs/ is part of the
site under its path in the repository, such as benchmarks/results/blind.md; a link to a file that
does not exist stays as it is and fails the strict build.
"""

from __future__ import annotations

import posixpath
import re
import tempfile
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

from mkdocs.plugins import event_priority

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
TREE = tempfile.TemporaryDirectory()  # kept as long as the process
FIRST_PAGE = "README.md"
LINK = re.compile(r"(?<=\]\()([^)#:\s]+)(?=[)#])")


@event_priority(100)  # before mkdocstrings reads its settings
def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Give the API pages the packages in one tree, as they install; pyproject.toml maps them to
    folders.
    """
    tree = Path(TREE.name)
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "setuptools"
    ]["package-dir"]
    for package, folder in packages.items():
        (tree / package.replace(".", "/")).mkdir(parents=True, exist_ok=True)
        for file in (ROOT / folder).glob("*.py"):
            link = tree / package.replace(".", "/") / file.name
            if not link.exists():
                link.symlink_to(file)
    config.plugins["mkdocstrings"].config["handlers"]["python"]["paths"] = [str(tree)]
    return config


def site_path(path: str) -> str:
    """Return where a file of the repository is on the site."""
    return "index.md" if path == FIRST_PAGE else path.removeprefix("docs/")


def repository_path(path: str) -> str:
    """Return the file of the repository that is at a path of the site."""
    if path == "index.md":
        return FIRST_PAGE
    return f"docs/{path}" if (ROOT / "docs" / path).exists() else path


def targets(path: str) -> list[str]:
    """Return the files of the repository that a Markdown file links to."""
    text = (ROOT / path).read_text(encoding="utf-8")
    found = (
        posixpath.normpath(posixpath.join(posixpath.dirname(path), link))
        for link in LINK.findall(text)
    )
    return [target for target in found if (ROOT / target).is_file()]


def named_pages(nav: object) -> list[str]:
    """Return the files of the repository that the navigation names."""
    if isinstance(nav, str):
        return [repository_path(nav)]
    parts = nav.values() if isinstance(nav, dict) else nav if isinstance(nav, list) else ()
    return [path for part in parts for path in named_pages(part)]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the files outside docs/ that pages link to, and those that they link to."""
    from mkdocs.structure.files import File

    seen: set[str] = set()
    queue = [
        *named_pages(config.nav),
        *(f"docs/{file.src_uri}" for file in files.documentation_pages()),
    ]
    while queue:
        path = queue.pop()
        if path in seen or not (ROOT / path).is_file():
            continue
        seen.add(path)
        if not path.startswith("docs/"):
            files.append(File.generated(config, site_path(path), abs_src_path=str(ROOT / path)))
        if path.endswith(".md"):
            queue += targets(path)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Rewrite the links between files of the repository to links between pages of the site."""
    place = posixpath.dirname(repository_path(page.file.src_uri))
    here = posixpath.dirname(page.file.src_uri)

    def rewritten(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(place, match[1]))
        return (
            posixpath.relpath(site_path(target), here or ".")
            if (ROOT / target).is_file()
            else match[1]
        )

    return LINK.sub(rewritten, markdown)
