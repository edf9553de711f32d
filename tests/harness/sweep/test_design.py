"""Which runs a sweep has, and how its values are drawn."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from bristle.harness.sweep.design import Design, axis_of, design

Message = Callable[[Callable[[], object]], str]


def drawn(found: Design, path: str) -> np.ndarray:
    axis = next(axis for axis in found.axes if axis.path == path)
    place = found.axes.index(axis)
    return np.array([axis.value(point.overrides[place]) for point in found.points()], dtype=float)


def test_lists_and_grids_are_crossed_and_seeds_change_fastest() -> None:
    found = design(["a=[x, y]", "b=0:1:3 ms"], seeds=[4, 7])
    points = list(found.points())
    assert found.runs == len(points) == 12
    assert [point.index for point in points] == list(range(12))
    assert [(point.overrides, point.seed) for point in points[:3]] == [
        (("a=x", "b=0 ms"), 4),
        (("a=x", "b=0 ms"), 7),
        (("a=x", "b=0.5 ms"), 4),
    ]
    assert len({(point.overrides, point.seed) for point in points}) == 12


def test_drawn_values_stay_in_the_order_of_the_keys() -> None:
    found = design(["a=uniform(0, 1)", "b=[1, 2]"], samples=2)
    assert [[each.partition("=")[0] for each in point.overrides] for point in found.points()] == [
        ["a", "b"]
    ] * 4
    # the same drawn values with each of the list
    assert len({point.overrides[0] for point in found.points()}) == 2


@pytest.mark.parametrize("sampling", ["lhs", "sobol", "random"])
def test_values_follow_their_distribution(sampling: str) -> None:
    """Against closed forms: mean and variance of the uniform and the normal, quantiles of the
    log-normal distribution.
    """
    vary = ["u=uniform(2, 5)", "n=norm(3, 2)", "l=lognorm(0.5, 7)", "k=norm(loc=1, scale=0.1) ms"]
    found = design(vary, samples=4096, sampling=sampling, sampling_seed=3)  # type: ignore[arg-type]
    u, n, log, k = (drawn(found, each[0]) for each in vary)
    assert 2 < u.min() < u.max() < 5
    assert u.mean() == pytest.approx(3.5, abs=0.06)
    assert u.var() == pytest.approx(9 / 12, rel=0.06)
    assert n.mean() == pytest.approx(3.0, abs=0.12)
    assert n.var() == pytest.approx(4.0, rel=0.1)
    assert np.median(log) == pytest.approx(7.0, rel=0.04)
    assert np.quantile(log, 0.8413447) == pytest.approx(7 * math.exp(0.5), rel=0.06)
    assert k.mean() == pytest.approx(1e-3, rel=0.01)  # in SI units
    assert np.corrcoef(u, n)[0, 1] == pytest.approx(0, abs=0.06)


def test_a_latin_hypercube_has_one_value_in_each_stratum() -> None:
    values = drawn(design(["u=uniform(0, 1)"], samples=50), "u")
    assert sorted(np.floor(values * 50)) == list(range(50))


def test_a_seed_gives_the_same_values_again_and_another_does_not() -> None:
    one, again, other = (
        design(["u=uniform(0, 1)"], samples=9, sampling_seed=seed) for seed in (1, 1, 2)
    )
    assert list(one.points()) == list(again.points()) != list(other.points())


def test_trials_have_each_listed_value_and_the_ends_of_a_distribution() -> None:
    found = design(["a=[x, y, z]", "u=uniform(10, 20)"], samples=4)
    trials = list(found.trials())
    assert {trial[0] for trial in trials} == {"a=x", "a=y", "a=z"}
    ends = sorted({float(trial[1].partition("=")[2]) for trial in trials})
    assert ends == pytest.approx([10.01, 15, 19.99])


def test_a_column_has_numbers_in_si_units_or_text() -> None:
    axis = axis_of('x=["1 ms", "2 s"]')
    assert [axis.value(each) for each in axis.overrides] == [0.001, 2.0]
    for spec in ('["1 ms", "2 m"]', "[1, clean]", "[true, false]"):
        axis = axis_of(f"x={spec}")
        assert not axis.numeric
        assert all(isinstance(axis.value(each), str) for each in axis.overrides)


@pytest.mark.parametrize(
    ("vary", "options", "said"),
    [
        (["x=unifrm(1, 2)"], {"samples": 4}, "did you mean 'uniform'"),
        (["x=norm(1, 2, 3, 4)"], {"samples": 4}, "its parameters are loc, scale"),
        (["x=lognorm()"], {"samples": 4}, "parameter s of lognorm is missing"),
        (["x=norm(1, -2)"], {"samples": 4}, "no values for these parameters"),
        (["x=norm(1, spread=2)"], {"samples": 4}, "its parameters are loc, scale"),
        (["x=norm(__import__('os').system('true'), 1)"], {"samples": 4}, "must be plain numbers"),
        (["x=uniform(1, 2)"], {}, "give samples"),
        (["x=[1, 2]"], {"samples": 4}, "no distribution to draw from"),
        (["x=uniform(1, 2)"], {"samples": 100, "sampling": "sobol"}, "write 64 or 128"),
        (["x=uniform(1)"], {"samples": 4}, "needs both its ends"),
        (["x=[1, 1]"], {}, "1 is in the list twice"),
        (["x=[a, 'b, c']"], {}, "put quotes around each text"),
        (["x=uniform(1, 2)"], {"samples": 0}, "draw at least 1"),
        (["x=uniform(1, 2)"], {"samples": 1, "sampling_seed": -1}, "must be 0 or more"),
        (
            ["x"],
            {},
            (
                "not PATH=SPEC; a SPEC is a:b:n (n values from a to b), or a list [v1, v2], or a"
                " distribution"
            ),
        ),
        (["x=0:1:10000", "y=0:1:10000"], {}, "100000000 runs; at most 10000000"),
    ],
)
def test_what_is_no_design_is_said_in_a_line(
    vary: list[str], options: dict[str, object], said: str, message: Message
) -> None:
    line = message(lambda: design(vary, **options))  # type: ignore[arg-type]
    assert said in line
    assert "\n" not in line
