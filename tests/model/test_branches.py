"""Kernels in C compute what one branch of a condition needs in that branch alone, and give the same
digits.
"""

import itertools

import casadi as ca
import pytest

from bristle.model.branches import MIN_BRANCH_OPERATIONS, Branch, Line, arranged
from bristle.model.emit import emit_c, emit_python
from bristle.model.program import Kernel


def chain(first, start, count):
    """Return lines that each need the one before."""
    names = [start, *(f"{first}{k}" for k in range(count))]
    return [Line(after, f"{before} + 1", (before,)) for before, after in itertools.pairwise(names)]


def chosen(name, condition, value):
    return Line(name, f"{condition} != 0 ? {value} : 0.0", (condition, value), condition, value)


def branches(done):
    """Return the branches, those inside others too."""
    own = [each for each in done if isinstance(each, Branch)]
    return [*own, *(inner for each in own for inner in branches(each.lines))]


def computed(done, hold):
    """Return the names in the order in which they are computed where these conditions hold; each
    must have what it needs.
    """
    found = []
    for each in done:
        if isinstance(each, Line):
            assert set(each.needs) <= {*found, "v"}, each.name
            found.append(each.name)
        elif each.condition in hold:
            before = list(found)
            inner = computed([*(Line(name, "", ()) for name in before), *each.lines], hold)
            found = [*before, *(name for name in inner[len(before) :] if name in each.shown)]
        else:
            found += each.shown
    return found


def test_what_one_branch_needs_alone_is_computed_there():
    long = chain("b", "x", MIN_BRANCH_OPERATIONS)
    lines = [
        Line("x", "v[0]", ()),
        Line("c", "x < 0", ("x",)),
        *long,
        chosen("r", "c", long[-1].name),
    ]
    done = arranged(lines, ["r"])
    assert [line.name for line in done[:2]] == ["x", "c"]
    branch, last = done[2:]
    assert branch == Branch("c", tuple(long), (long[-1].name,))
    assert last.name == "r"


@pytest.mark.parametrize("wanted", [["r", "b3"], ["r"]])
def test_what_is_also_needed_elsewhere_is_computed_outside_the_branch(wanted):
    """Once wanted for itself, or by another line, a value is computed in any case; so is what it
    needs.
    """
    long = chain("b", "x", MIN_BRANCH_OPERATIONS + 4)
    other = [Line("y", "b3 * 2", ("b3",))] if wanted == ["r"] else []
    lines = [
        Line("x", "v[0]", ()),
        Line("c", "x < 0", ("x",)),
        *long,
        *other,
        chosen("r", "c", long[-1].name),
    ]
    done = arranged(lines, [*wanted, *(line.name for line in other)])
    outside = [line.name for line in done if isinstance(line, Line)]
    assert {"b0", "b1", "b2", "b3"} <= set(outside)
    [branch] = branches(done)
    assert [line.name for line in branch.lines] == [line.name for line in long[4:]]


def test_a_short_branch_is_not_worth_it():
    lines = [
        Line("x", "v[0]", ()),
        Line("c", "x < 0", ("x",)),
        *chain("b", "x", MIN_BRANCH_OPERATIONS - 1),
        chosen("r", "c", f"b{MIN_BRANCH_OPERATIONS - 2}"),
    ]
    assert not branches(arranged(lines, ["r"]))


def test_branches_that_need_each_other_come_in_order():
    first, second = chain("b", "x", MIN_BRANCH_OPERATIONS), chain("d", "r", MIN_BRANCH_OPERATIONS)
    lines = [
        Line("x", "v[0]", ()),
        Line("c", "x < 0", ("x",)),
        *first,
        chosen("r", "c", first[-1].name),
        Line("e", "r < 2", ("r",)),
        *second,
        chosen("s", "e", second[-1].name),
        Line("t", "s + r", ("s", "r")),
    ]
    done = arranged(lines, ["t"])
    assert len(branches(done)) == 2
    for hold in ((), ("c",), ("e",), ("c", "e")):
        assert "t" in computed(done, hold)


def test_what_two_conditions_need_under_a_third_is_computed_under_that():
    """Each of two values is chosen by a condition of its own, and then both by a third one, which
    alone may make them needless.
    """
    long = chain("b", "x", MIN_BRANCH_OPERATIONS)
    ends = [
        line
        for k, c in (("p", "d"), ("q", "e"))
        for line in (
            chosen(f"{k}1", c, long[-1].name),
            Line(f"{k}2", f"{k}1 * 3", (f"{k}1",)),
            chosen(f"{k}3", "c", f"{k}2"),
        )
    ]
    conditions = [Line("x", "v[0]", ()), *(Line(name, "x < 0", ("x",)) for name in "cde")]
    done = arranged([*conditions, *long, *ends, Line("r", "p3 + q3", ("p3", "q3"))], ["r"])
    [branch] = branches(done)
    assert branch.condition == "c"
    assert {line.name for line in long} <= {line.name for line in branch.lines}
    for hold in ((), ("c",)):
        assert computed(done, hold)[-1] == "r"


def test_a_branch_inside_another():
    long, longer = chain("b", "x", MIN_BRANCH_OPERATIONS), chain("d", "y", MIN_BRANCH_OPERATIONS)
    lines = [
        Line("x", "v[0]", ()),
        Line("c", "x < 0", ("x",)),
        *long,
        Line("e", "b1 < 2", ("b1",)),
        Line("y", "b2 * 2", ("b2",)),
        *longer,
        chosen("s", "e", longer[-1].name),
        Line("t", f"s + {long[-1].name}", ("s", long[-1].name)),
        chosen("r", "c", "t"),
    ]
    done = arranged(lines, ["r"])
    assert [each.condition for each in branches(done)] == ["c", "e"]
    assert computed(done, ("c", "e"))[-1] == "r"


def test_a_kernel_has_the_branch_in_c_and_the_expression_in_python():
    x = ca.SX.sym("x", 2)
    far = x[1]
    for _ in range(MIN_BRANCH_OPERATIONS):
        far = ca.sin(far) + x[0]
    function = ca.Function("turn", [x, ca.SX.sym("h")], [ca.if_else(x[0] < 0, far, x[1])])
    kernel = Kernel("turn", ((function, (0,)),), (3, 4), True)
    text = emit_c(kernel)
    inside = text[text.index("if (") : text.index("        }\n", text.index("if ("))]
    assert inside.count("sin(") == text.count("sin(") == MIN_BRANCH_OPERATIONS
    assert "if (" not in emit_python(kernel)
