"""Kernels in C compute what one branch of a condition needs in that branch alone, and give the same digits."""

import itertools

import casadi as ca
import pytest

from bristle.model.branches import FEWEST, Branch, Line, arranged
from bristle.model.emit import emit_c, emit_python
from bristle.model.program import Kernel


def chain(first, start, count):
    """Return lines that each need the one before."""
    names = [start, *(f"{first}{k}" for k in range(count))]
    return [Line(after, f"{before} + 1", (before,)) for before, after in itertools.pairwise(names)]


def chosen(name, condition, value):
    return Line(name, f"{condition} != 0 ? {value} : 0.0", (condition, value), condition, value)


def test_what_one_branch_needs_alone_is_computed_there():
    long = chain("b", "x", FEWEST)
    lines = [Line("x", "v[0]", ()), Line("c", "x < 0", ("x",)), *long, chosen("r", "c", long[-1].name)]
    done = arranged(lines, ["r"])
    assert [line.name for line in done[:2]] == ["x", "c"]
    [branch] = done[2:]
    assert isinstance(branch, Branch)
    assert branch.lines == tuple(long)
    assert [line.name for line in branch.results] == ["r"]


@pytest.mark.parametrize("wanted", [["r", "b3"], ["r"]])
def test_what_is_needed_elsewhere_stays_outside(wanted):
    """Once wanted for itself, or by another line, a value is computed in any case; so is what it needs."""
    long = chain("b", "x", FEWEST + 4)
    other = [Line("y", "b3 * 2", ("b3",))] if wanted == ["r"] else []
    lines = [Line("x", "v[0]", ()), Line("c", "x < 0", ("x",)), *long, *other, chosen("r", "c", long[-1].name)]
    done = arranged(lines, [*wanted, *(line.name for line in other)])
    outside = [line.name for line in done if isinstance(line, Line)]
    assert {"b0", "b1", "b2", "b3"} <= set(outside)
    [branch] = [each for each in done if isinstance(each, Branch)]
    assert [line.name for line in branch.lines] == [line.name for line in long[4:]]


def test_a_short_branch_is_not_worth_it():
    lines = [Line("x", "v[0]", ()), Line("c", "x < 0", ("x",)), *chain("b", "x", FEWEST - 1), chosen("r", "c", f"b{FEWEST - 2}")]
    assert not any(isinstance(each, Branch) for each in arranged(lines, ["r"]))


def test_branches_that_need_each_other_come_in_order():
    first, second = chain("b", "x", FEWEST), chain("d", "r", FEWEST)
    lines = [
        Line("x", "v[0]", ()), Line("c", "x < 0", ("x",)), *first, chosen("r", "c", first[-1].name),
        Line("e", "r < 2", ("r",)), *second, chosen("s", "e", second[-1].name), Line("t", "s + r", ("s", "r")),
    ]  # fmt: skip
    known: set[str] = set()
    for each in arranged(lines, ["t"]):
        inner = set(known)
        for line in each.lines if isinstance(each, Branch) else [each]:
            assert set(line.needs) <= inner
            inner.add(line.name)
        known |= {line.name for line in each.results} if isinstance(each, Branch) else inner
    assert "t" in known


def test_a_kernel_has_the_branch_in_c_and_the_expression_in_python():
    x = ca.SX.sym("x", 2)
    far = x[1]
    for _ in range(FEWEST):
        far = ca.sin(far) + x[0]
    function = ca.Function("turn", [x, ca.SX.sym("h")], [ca.if_else(x[0] < 0, far, x[1])])
    kernel = Kernel("turn", ((function, (0,)),), (3, 4), True)
    text = emit_c(kernel)
    inside = text[text.index("if (") : text.index("        }\n", text.index("if ("))]
    assert inside.count("sin(") == text.count("sin(") == FEWEST
    assert "if (" not in emit_python(kernel)
