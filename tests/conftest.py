"""What all tests share, and the end of a run: pythonfmu's libraries may not have the last word."""

from __future__ import annotations

import logging
import os
import sys
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bristle.common.errors import BristleError

SCENARIO = """
duration = "1 s"
[plant]
law = "modified"
[observer]
method = "bastin_gevers"
[[checks]]
name = "b moves"
quantity = "estimates.b.moved_percent"
min = 1
"""

_status = pytest.StashKey[int]()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    session.config.stash[_status] = int(exitstatus)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that have most slow tests, then most tests, and mark as slow what
    `sampled` leaves out of a quick run.

    A file goes to one worker: none is left with a long one at the end.
    """
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    number = Counter(item.path for item in items)
    items.sort(key=lambda item: (-slow[item.path], -number[item.path]))
    seen: Counter[str] = Counter()
    for item in items:
        name, sampled = item.nodeid.partition("[")[0], item.get_closest_marker("sampled")
        if sampled and seen[name] % sampled.args[0]:
            item.add_marker(pytest.mark.slow)
        seen[name] += 1


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests were skipped, by reason: data that are not in the repository, say."""
    reasons = Counter(
        str(report.longrepr[2]).removeprefix("Skipped: ")
        for report in terminalreporter.stats.get("skipped", [])
    )
    for reason, count in sorted(reasons.items()):
        terminalreporter.write_line(
            f"{count} {'test was' if count == 1 else 'tests were'} skipped: {reason}", yellow=True
        )


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """Leave with pytest's own exit status before the interpreter is torn down.

    pythonfmu 0.7.0 damages the heap of a process that loaded its libraries, which now and then
    aborts it at exit, after every test has been judged. The harness keeps such FMUs in processes of
    their own; some tests load them here.
    """
    status = config.stash.get(_status, None)
    if status is not None and "pythonfmu" in sys.modules:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


@pytest.fixture
def case(tmp_path: Path) -> Path:
    """A small scenario file that passes."""
    path = tmp_path / "case.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def changed() -> Callable[..., Path]:
    """Return what copies an archive, `change` (name, content) -> content or None (left out) applied
    to all its files.
    """

    def copy(path: Path, target: Path, change: Callable[[str, bytes], bytes | None]) -> Path:
        with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
            for name in old.namelist():
                if (content := change(name, old.read(name))) is not None:
                    new.writestr(name, content)
        return target

    return copy


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figures out of the result folders of runs: drawing takes longer than a short run,
    and other tests look at them.
    """
    monkeypatch.setattr("bristle.harness.run.figures.draw", lambda pictures: {})


@pytest.fixture
def message() -> Callable[[Callable[[], Any]], str]:
    """Return what calls something that must fail, and checks that the message is one line."""

    def call(what: Callable[[], Any]) -> str:
        with pytest.raises(BristleError) as caught:
            what()
        text = str(caught.value)
        assert "\n" not in text
        return text

    return call


@pytest.fixture(autouse=True, scope="session")
def without_lines_of_progress() -> Iterator[None]:
    """Print none, however long a command takes: tests look at the standard error for messages."""
    from bristle.cli import terminal

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terminal, "SECONDS_BETWEEN_LINES", float("inf"))
        patch.setattr(terminal, "LEAST_TOLD", logging.WARNING)  # not what is compiled
        yield
