"""Order the assignments of a kernel so that what only one branch of a condition needs is computed
in that branch alone.

An expression contains both cases of a condition, such as sliding on and reversing, each multiplied
by it. The values are the same digit by digit with and without branches.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass

MIN_BRANCH_OPERATIONS = 8  # fewest operations for which a branch is generated


@dataclass(frozen=True)
class Line:
    """One assignment: name, its text, the names it needs; `condition` where it is `value` if that
    holds, otherwise 0.
    """

    name: str
    text: str
    needs: tuple[str, ...]
    condition: str = ""
    value: str = ""


@dataclass(frozen=True)
class Branch:
    """Lines computed only if a condition holds; those in `shown` are 0 otherwise, the others are
    not used outside.
    """

    condition: str
    lines: tuple[Line | Branch, ...]
    shown: tuple[str, ...]


def arranged(
    lines: Sequence[Line], wanted: Collection[str], inside: frozenset[str] = frozenset()
) -> list[Line | Branch]:
    """Return the lines in an order that respects their needs, with branches that save operations.

    `wanted` are needed in any case; conditions that are `inside` hold already.
    """
    guards = _guards(lines, wanted, inside)
    users = _users(lines)
    known = {line.name for line in lines}
    done, left = {need for line in lines for need in line.needs} - known, list(lines)
    out: list[Line | Branch] = []
    while left:
        plain = _ready(left, done, [line.name for line in left if line.name not in guards])
        if plain:
            out += plain
        else:
            condition, members = _next_branch(left, done, guards)
            names = [line.name for line in members]
            own = set(names)
            shown = [name for name in names if name in wanted or not users[name] <= own]
            within = arranged(members, shown, inside | {condition})
            out.append(Branch(condition, tuple(within), tuple(shown)))
            plain = members
        done |= {line.name for line in plain}
        left = [line for line in left if line.name not in done]
    return out


def _users(lines: Sequence[Line]) -> dict[str, set[str]]:
    """Return the names of the lines that need each name."""
    users: dict[str, set[str]] = defaultdict(set)
    for line in lines:
        for need in line.needs:
            users[need].add(line.name)
    return users


def _guards(
    lines: Sequence[Line], wanted: Collection[str], inside: frozenset[str]
) -> dict[str, str]:
    """Return the condition under which alone each line is needed: of several, the one that most
    lines have.
    """
    under: dict[str, set[str]] = {}
    for line in reversed(lines):
        mine = under.setdefault(line.name, set())
        if line.name in wanted:
            mine.clear()
        for need in set(line.needs):
            as_value = line.condition and need == line.value and need != line.condition
            there = mine | {line.condition} - inside if as_value else mine
            under[need] = under[need] & there if need in under else set(there)
    most = Counter(condition for line in lines for condition in under[line.name])
    guards = {
        line.name: max(mine, key=lambda c: (most[c], c))
        for line in lines
        if (mine := under[line.name])
    }
    size = Counter(guards.values())
    return {
        name: condition
        for name, condition in guards.items()
        if size[condition] >= MIN_BRANCH_OPERATIONS
    }


def _ready(left: Sequence[Line], done: set[str], names: Collection[str]) -> list[Line]:
    """Return the named lines that need nothing but what is done and each other, in order."""
    found, known, among = [], set(done), set(names)
    for line in left:
        if line.name in among and known.issuperset(line.needs):
            found.append(line)
            known.add(line.name)
    return found


def _next_branch(
    left: Sequence[Line], done: set[str], guards: dict[str, str]
) -> tuple[str, list[Line]]:
    """Return the condition and the lines of the branch that comes next: a whole one if there is
    any, otherwise the longest.
    """
    groups: dict[str, list[str]] = defaultdict(list)
    for line in left:
        if line.name in guards and guards[line.name] in done:
            groups[guards[line.name]].append(line.name)
    ready = {condition: _ready(left, done, names) for condition, names in groups.items()}
    best = max(ready, key=lambda c: (len(ready[c]) == len(groups[c]), len(ready[c])), default="")
    # a branch needs what another one computes, and the other way round
    if not best or not ready[best]:
        raise AssertionError("the lines have no valid order")
    return best, ready[best]
