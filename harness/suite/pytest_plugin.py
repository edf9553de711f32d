"""Scenario files as pytest items: `pytest scenarios/` runs each file, and a failure shows its
verdict table.

Installed as the plugin `bristle` (leave it out with ``-p no:bristle``). Items do not share anything
but the cache of FMUs, so that they can be run by pytest-xdist.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from bristle.common.errors import BristleError

if TYPE_CHECKING:
    from bristle.harness.suite.suite import CaseResult

OUT_OPTION = "--bristle-out"


class ScenarioError(BristleError):
    """A scenario that did not pass; its text is the verdict table or the one line of an error."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the folder of the results."""
    group = parser.getgroup("bristle", "scenarios of bristle")
    group.addoption(
        OUT_OPTION,
        metavar="FOLDER",
        default=None,
        help="folder for the results of scenarios; else a temporary one",
    )


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Take scenario files: .toml with a table [observer], and what is no TOML, of which nobody can
    say that it is none.
    """
    if file_path.suffix != ".toml":
        return None
    from bristle.harness.scenario.catalogue import is_scenario

    if not is_scenario(file_path):
        return None
    file: pytest.Collector = ScenarioFile.from_parent(parent, path=file_path)
    return file


# before any is left out, so that the folders do not depend on which
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: Sequence[pytest.Item]) -> None:
    """Give scenarios of one name a result folder each."""
    scenarios = [item for item in items if isinstance(item, ScenarioItem)]
    named = Counter(item.path.stem.casefold() for item in scenarios)
    for item in scenarios:
        if named[item.path.stem.casefold()] > 1:
            item.place = _below(item.path.parent, item.config.rootpath)


def _below(folder: Path, root: Path) -> Path:
    """Return a folder relative to the root; one that lies elsewhere, relative to that of the file
    system.
    """
    return folder.relative_to(root if folder.is_relative_to(root) else folder.anchor)


class ScenarioFile(pytest.File):
    """A scenario file, which is one item."""

    def collect(self) -> Iterator[pytest.Item]:
        """Give the one item."""
        item: pytest.Item = ScenarioItem.from_parent(self, name=self.path.stem)
        yield item


class ScenarioItem(pytest.Item):
    """A run of a scenario, which passes if its verdict does.

    `place` is where its result folder lies, below that of all results.
    """

    place = Path()

    def runtest(self) -> None:
        """Run the scenario; raise `ScenarioError` if its verdict is not pass."""
        from bristle.harness.suite.suite import SuiteCase, run_case

        tested = run_case(SuiteCase(self.path), self._out())
        if tested.verdict != "error":
            self.add_report_section("call", "bristle", f"report: {self._out() / tested.report}")
        if tested.verdict != "pass":
            raise ScenarioError(verdict_table(tested))

    def _out(self) -> Path:
        given = self.config.getoption(OUT_OPTION)
        if given is not None:
            return Path(given) / self.place
        factory: Any = self.config._tmp_path_factory  # type: ignore[attr-defined]  # what the fixture of this name gives
        return Path(factory.getbasetemp()) / "bristle" / self.place

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Return the verdict table; of any other exception what pytest shows."""
        return (
            str(excinfo.value)
            if isinstance(excinfo.value, ScenarioError)
            else super().repr_failure(excinfo, style)
        )

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Return where the item is."""
        return self.path, None, f"scenario {self.path.stem}"


def verdict_table(tested: CaseResult) -> str:
    """Return the checks of a run as text, one line each."""
    from bristle.harness.metrics.checks import SIGNS
    from bristle.harness.suite.suite_page import shown

    lines = [tested.message] if tested.message else []
    rows = [
        (
            c["name"],
            shown(c["value"]),
            f"{SIGNS[c['kind']]} {c['limit']:g}",
            "pass" if c["pass"] else "FAIL",
        )
        for c in tested.checks
    ]
    widths = [max((len(row[k]) for row in rows), default=0) for k in range(4)]
    lines += [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    return "\n".join(lines)
