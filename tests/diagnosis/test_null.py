"""The null: as often as it says, chance reaches a gain, where the distribution is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from bristle.diagnosis.null import LEVEL, REPLICATES, Null, directions, largest_gain

SEGMENTS, BINS = 150, 12


def banks_of(rng, sizes, weight):
    """Directions (segments, bins, k) of several candidates, all orthonormal to each other in the weighted product."""
    whole = directions(rng.standard_normal((SEGMENTS, BINS, sum(sizes))), weight)
    ends = np.cumsum(sizes)
    return [whole[:, :, end - size : end] for end, size in zip(ends, sizes, strict=True)]


def gain_of(banks, rest, weight):
    """The largest score gain, computed without the bootstrap."""
    return max(0.5 * np.sum(np.einsum("s,snk,sn->k", weight, bank, rest) ** 2) for bank in banks)


@pytest.mark.parametrize("sizes", [(1,), (3,), (2, 2, 2), (1, 2, 3, 4)])
def test_the_level_is_that_of_the_closed_form(sizes):
    """Twice the gain of k white directions is chi2 with k degrees; that of several candidates their largest."""
    gains = np.linspace(0.1, 40.0, 4000)
    below = np.prod([chi2.cdf(2 * gains, k) for k in sizes], axis=0)
    exact = float(np.interp(1 - LEVEL, below, gains))
    found = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        weight = np.ones(SEGMENTS)
        found.append(largest_gain(banks_of(rng, sizes, weight), rng.standard_normal((SEGMENTS, BINS)), weight).level)
    assert np.mean(found) == pytest.approx(exact, rel=0.07)
    assert np.ptp(found) < 0.7 * exact


def test_p_is_as_often_small_as_it_says():
    """Against direct draws: gains of fresh residuals, each judged by the bootstrap of its own."""
    rng, weight, ps = np.random.default_rng(4), np.ones(SEGMENTS), []
    banks = banks_of(rng, (2, 2, 3), weight)
    for _ in range(400):
        rest = rng.standard_normal((SEGMENTS, BINS))
        ps.append(largest_gain(banks, rest, weight, replicates=299).p(gain_of(banks, rest, weight)))
    for share in (0.05, 0.2, 0.5):
        assert abs(np.mean(np.array(ps) <= share) - share) < 3 * np.sqrt(share * (1 - share) / len(ps)) + 0.01


def test_segments_may_differ_in_spread():
    """Where few segments are loud, the direct distribution is wider than chi2 of the mean; the bootstrap follows it."""
    rng, weight = np.random.default_rng(6), np.ones(SEGMENTS)
    often = np.arange(SEGMENTS) % 3 == 0
    banks = [directions(rng.standard_normal((SEGMENTS, BINS, 2)) * np.where(often, 3.0, 1.0)[:, None, None], weight)]
    rests = np.where(often, 6.0, 1.0)[:, None] * rng.standard_normal((4020, SEGMENTS, BINS))
    direct = np.quantile([gain_of(banks, rest, weight) for rest in rests[20:]], 0.99)
    levels = [np.quantile(largest_gain(banks, rest, weight).draws, 0.99) for rest in rests[:20]]
    assert np.mean(levels) == pytest.approx(direct, rel=0.1)
    assert direct > 1.5 * chi2.ppf(0.99, 2) / 2 * np.mean(rests**2)


def test_p_is_never_below_what_the_replicates_can_show():
    rng, weight = np.random.default_rng(1), np.ones(SEGMENTS)
    null = largest_gain(banks_of(rng, (2,), weight), rng.standard_normal((SEGMENTS, BINS)), weight)
    assert len(null.draws) == REPLICATES
    assert null.p(1e9) == 1 / (REPLICATES + 1)
    assert null.p(0.0) == 1.0
    assert Null(np.array([1.0, 2.0, 3.0])).p(2.0) == 0.75  # itself and two of three
    ps = [null.p(gain) for gain in np.linspace(0, 20, 50)]
    assert ps == sorted(ps, reverse=True)


def test_what_is_not_judged_does_not_count():
    rng, weight = np.random.default_rng(2), (np.arange(SEGMENTS) % 3 > 0).astype(float)
    [bank] = banks_of(rng, (2,), weight)
    rest = rng.standard_normal((SEGMENTS, BINS))
    spoilt = np.where(weight[:, None] > 0, rest, 1e6)
    np.testing.assert_array_equal(largest_gain([bank], rest, weight).draws, largest_gain([bank], spoilt, weight).draws)
    assert largest_gain([bank], 2 * rest, weight).level == pytest.approx(4 * largest_gain([bank], rest, weight).level)


def test_it_is_the_same_every_time_and_whatever_the_order():
    rng, weight = np.random.default_rng(3), np.ones(SEGMENTS)
    banks, rest = banks_of(rng, (1, 2), weight), rng.standard_normal((SEGMENTS, BINS))
    np.testing.assert_array_equal(largest_gain(banks, rest, weight).draws, largest_gain(banks[::-1], rest, weight).draws)
    assert np.any(largest_gain(banks, rest, weight, seed=9).draws != largest_gain(banks, rest, weight).draws)


def test_directions_are_orthonormal_and_span_what_they_came_from():
    rng = np.random.default_rng(5)
    weight = rng.uniform(0.5, 2.0, SEGMENTS)
    columns = rng.standard_normal((SEGMENTS, BINS, 3)) * np.array([1e-6, 1.0, 1e4])
    dependent = np.concatenate([columns, columns @ (rng.standard_normal((3, 5)) * np.array([[1e6], [1.0], [1e-4]]))], axis=2)
    found = directions(dependent, weight)
    assert found.shape[2] == 3
    np.testing.assert_allclose(np.einsum("s,snk,snl->kl", weight, found, found), np.eye(3), atol=1e-9)
    scaled = found.reshape(-1, 3)
    for column in columns.reshape(-1, 3).T:
        rest = column - scaled @ np.linalg.lstsq(scaled, column, rcond=None)[0]
        assert np.linalg.norm(rest) < 1e-6 * np.linalg.norm(column)
