"""Assignments of a kernel so arranged that what only one branch of a condition needs is computed in that branch alone.

Expressions have no statements: where a servo either slides on or turns round, both are in them, each times a condition. The
values, and their digits, are the same either way.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

FEWEST = 8  # operations that are worth a branch


@dataclass(frozen=True)
class Line:
    """One assignment: name, its text, the names it needs; `condition` where it is `value` if that holds, otherwise 0."""

    name: str
    text: str
    needs: tuple[str, ...]
    condition: str = ""
    value: str = ""


@dataclass(frozen=True)
class Branch:
    """Lines computed only if a condition holds, and names that get a value then, and 0 otherwise."""

    condition: str
    lines: tuple[Line, ...]
    results: tuple[Line, ...]


def arranged(lines: Sequence[Line], wanted: Iterable[str]) -> list[Line | Branch]:
    """Return the lines in an order that holds, in branches where that saves work; `wanted` are needed in any case."""
    guards = _guards(lines, set(wanted))
    of = {line.name: line for line in lines}
    place = {line.name: i for i, line in enumerate(lines)}
    done: set[str] = set()
    out: list[Line | Branch] = []
    left = [line for line in lines if line.name not in guards]
    while left:
        waiting = []
        for line in left:
            if set(line.needs) <= done:
                out.append(line)
                done.add(line.name)
            else:
                waiting.append(line)
        ready: dict[str, list[tuple[Line, set[str]]]] = defaultdict(list)
        for line in waiting:
            inside = _inside(line, guards, of)
            outside = {line.condition} | {need for name in inside for need in of[name].needs if need not in inside}
            if inside and outside <= done:
                ready[line.condition].append((line, inside))
        if waiting and not ready:  # nothing but order: what a branch would compute is needed by another one first
            raise AssertionError("lines in no order")
        for condition, several in ready.items():
            members = sorted(set().union(*(inside for _, inside in several)), key=place.__getitem__)
            out.append(Branch(condition, tuple(of[name] for name in members), tuple(line for line, _ in several)))
            done |= {line.name for line, _ in several}
        left = [line for line in waiting if line.name not in done]
    return out


def _guards(lines: Sequence[Line], wanted: set[str]) -> dict[str, str]:
    """Return the condition of each line that no one needs but values under this one condition."""
    users: dict[str, list[tuple[Line, bool]]] = defaultdict(list)
    for line in lines:
        for need in set(line.needs):
            users[need].append((line, bool(line.condition) and need == line.value and need != line.condition))
    guard: dict[str, str] = {}
    for line in reversed(lines):
        under = {
            user.condition if as_value and user.name not in guard else guard.get(user.name, "")
            for user, as_value in users[line.name]
        }
        if len(under) == 1 and "" not in under and line.name not in wanted:
            guard[line.name] = under.pop()
    size: dict[str, int] = defaultdict(int)
    for condition in guard.values():
        size[condition] += 1
    return {name: condition for name, condition in guard.items() if size[condition] >= FEWEST}


def _inside(line: Line, guards: dict[str, str], of: dict[str, Line]) -> set[str]:
    """Return the guarded lines that a value under a condition needs."""
    found: set[str] = set()
    todo = [line.value] if line.condition else []
    while todo:
        name = todo.pop()
        if name not in found and guards.get(name) == line.condition:
            found.add(name)
            todo += of[name].needs
    return found
