"""Which tests are in a share: all in turn, and those of one method or name together."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from bristle.observer import methods

SAMPLED: tuple[Any, ...] = (("sampled", (3, "observer")),)
SHARES = [f"share{k}" for k in range(400)]


@dataclass(frozen=True)
class Stub:
    """What a share reads of a test."""

    nodeid: str
    marks: tuple[tuple[str, tuple[Any, ...]], ...] = ()
    method: str = ""

    def get_closest_marker(self, name: str) -> Any:
        return next((SimpleNamespace(args=args) for mark, args in self.marks if mark == name), None)

    @property
    def callspec(self) -> Any:
        return SimpleNamespace(params={"method": self.method})


def sampled(test: str, *arguments: Any) -> list[Stub]:
    return [Stub(f"{test}[{each}]", (("sampled", arguments),), each) for each in methods()]


@pytest.fixture
def drawn(pytestconfig: pytest.Config) -> Any:
    """Return what gives the names of the tests that are in a share."""
    place = str(pytestconfig.rootpath / "tests" / "conftest.py")
    left_out = pytestconfig.pluginmanager.get_plugin(place)._left_out

    def draw(items: list[Stub], share: str, one_in: int = 1, long: int = 0) -> set[str]:
        return {item.nodeid for item in set(items) - left_out(items, share, one_in, long)}

    return draw


def test_each_set_is_in_its_turn(drawn: Any) -> None:
    items = sampled("a.py::test_a", 4)
    times = Counter(name for share in SHARES for name in drawn(items, share))
    assert set(times) == {item.nodeid for item in items}
    assert all(60 < number < 140 for number in times.values())  # of 400, one in 4


def test_a_share_has_the_same_methods_of_all_tests(drawn: Any) -> None:
    items = [*sampled("a.py::test_a", 4), *sampled("b.py::test_b", 4)]
    for share in SHARES[:20]:
        names = drawn(items, share)
        first, second = (
            {name.split("[")[1] for name in names if file in name} for file in ("a.py", "b.py")
        )
        assert first == second
        assert len(first) == round(len(methods()) / 4)


def test_those_of_a_name_are_together(drawn: Any) -> None:
    items = [*sampled("a.py::test_a", 3, "observer"), Stub("b.py::test_b", SAMPLED)]
    sizes = Counter(len(drawn(items, share)) for share in SHARES)
    assert set(sizes) == {0, len(items)}
    assert 90 < sizes[len(items)] < 180  # of 400, one in 3


def test_long_ones_run_where_they_are_asked_for(drawn: Any) -> None:
    items = [Stub(f"a.py::test_{k}", (("long", ()),)) for k in range(10)]
    assert not any(drawn(items, share) for share in SHARES)
    every = {name for share in SHARES for name in drawn(items, share, long=1)}
    assert every == {item.nodeid for item in items}


def test_of_the_rest_of_a_file_one_in_so_many_is_drawn(drawn: Any) -> None:
    items = [Stub(f"a.py::test_{k}") for k in range(10)]
    assert all(len(drawn(items, share)) == 10 for share in SHARES[:20])
    halves = [drawn(items, share, one_in=2) for share in SHARES[:20]]
    assert {len(half) for half in halves} == {5}
    assert len(set(map(frozenset, halves))) > 1
