"""What all tests share, which of them run, and the end of a run: pythonfmu's libraries may not have
the last word.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest

# before NumPy: the matrices of most tests are small, and more threads only wait for each other
for name in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{name}_NUM_THREADS", "1")

from bristle.common.errors import BristleError  # noqa: E402  # after that
from bristle.model.compiler import FLAGS_VARIABLE  # noqa: E402

ONE_SLOW_IN = 32  # of all slow tests, a share has one in so many
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


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("bristle")
    group.addoption("--all", action="store_true", help="run every test, whatever is sampled")
    group.addoption(
        "--share", metavar="NAME", help="run the share of the sampled tests that NAME draws"
    )
    group.addoption(
        "--one-in",
        type=_at_least(1),
        default=1,
        metavar="N",
        help="of a share's other tests, run one in N",
    )
    group.addoption(
        "--long",
        type=_at_least(0),
        default=0,
        metavar="N",
        help="of the long tests, run N with a share",
    )


def _at_least(least: int) -> Callable[[str], int]:
    """Return what reads a number of an option."""

    def number(text: str) -> int:
        if int(text) < least:
            raise ValueError
        return int(text)

    return number


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Choose the share once: the processes of pytest-xdist get it as an option.

    All is compiled in half the time, but for a run of all tests: the digits are the same, which a
    test of the compiler asserts.
    """
    option = config.option
    if not option.all:
        os.environ.setdefault(FLAGS_VARIABLE, "-O1")
    named = option.keyword or config.args_source is not pytest.Config.ArgsSource.TESTPATHS
    if option.share is None and not option.all and not named:
        option.share = _commit(config.rootpath)


def _commit(root: Path) -> str:
    """Return the first digits of the commit that is checked out; without one, a fixed name."""
    command = ["git", "-C", str(root), "rev-parse", "--short=8", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "none"


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Say which tests run, and how to run the same again."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    share = session.config.option.share
    if reporter and share is not None:
        reporter.write_line(
            f"share {share} of the sampled tests; again: --share {share}, all tests: --all"
        )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what the share does not draw, and begin with the files that have long tests, most
    slow tests, then most tests: no process is left with a long one at the end.
    """
    if config.option.share is not None:
        option = config.option
        left_out = _left_out(items, option.share, option.one_in, option.long)
        config.hook.pytest_deselected(items=[item for item in items if item in left_out])
        items[:] = [item for item in items if item not in left_out]
    long, slow = (
        Counter(item.path for item in items if item.get_closest_marker(mark))
        for mark in ("long", "slow")
    )
    number = Counter(item.path for item in items)
    items.sort(key=lambda item: (-long[item.path], -slow[item.path], -number[item.path]))


def _left_out(
    items: list[pytest.Item], share: str, one_in: int, number_of_long: int
) -> set[pytest.Item]:
    """Return the tests that are not in a share.

    The share draws an order of all methods, effects, FMUs and other sets. Of the sets of a test
    with `sampled(n)`, of all slow tests, and of the other tests of a file, one in n is in it: the
    first in this order, so that all tests take the same methods and effects, and few are compiled.
    A test without sets is in one of n shares, and so is one with `sampled(n, name)`: those of a
    name are in the same shares. Of what is long, as much is as was asked for.
    """

    def ordered(items: Iterable[pytest.Item]) -> list[pytest.Item]:
        return sorted(items, key=lambda item: _place(item, share))

    long: list[pytest.Item] = []
    groups: dict[tuple[str, int, bool], list[pytest.Item]] = {}
    for item in items:
        is_long = item.get_closest_marker("long")
        (long if is_long else groups.setdefault(_group(item, one_in), [])).append(item)
    left_out = set(ordered(long)[number_of_long:])
    for (name, n, whole), group_items in groups.items():
        if whole:
            number = len(group_items) if crc32(f"{share} {name}".encode()) < 2**32 / n else 0
        else:
            number = max(round(len(group_items) / n), 1)
        left_out.update(ordered(group_items)[number:])
    return left_out


def _group(item: pytest.Item, one_in: int) -> tuple[str, int, bool]:
    """Return with which tests a test is drawn, one in how many, and whether all of them or none."""
    file, test = item.nodeid.partition("::")[0], item.nodeid.partition("[")[0]
    if item.get_closest_marker("slow"):
        return "slow", ONE_SLOW_IN, False
    if sampled := item.get_closest_marker("sampled"):
        n, *name = sampled.args
        return (name[0] if name else test), n * one_in, bool(name) or test == item.nodeid
    return file, one_in, False


def _place(item: pytest.Item, share: str) -> tuple[int, int]:
    """Return where a test is in the order of a share: by what it names, then by its own name; what
    is slow by its own name alone.
    """
    slow = item.get_closest_marker("slow")
    sets = None if slow else getattr(item, "callspec", None)
    known = _drawn_together()
    named = [each for each in _strings(sets.params.values() if sets else ()) if each in known]
    first = named[0] if named else item.nodeid
    return crc32(f"{share} {first}".encode()), crc32(f"{share} {item.nodeid}".encode())


def _strings(values: Iterable[Any]) -> Iterator[str]:
    """Give the strings among values and in the tuples among them."""
    for value in values:
        if isinstance(value, str):
            yield value
        elif isinstance(value, tuple):
            yield from _strings(value)


@cache
def _drawn_together() -> frozenset[str]:
    from bristle.observer import methods
    from bristle.plant.effects import effects

    return frozenset((*methods(), *effects(packages=False), "plant", "controller", "observer"))


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
