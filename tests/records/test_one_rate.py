"""Records of several rates: the input of each new interval is the mean of what was held over it."""

import numpy as np
import pytest

from bristle.records import Record
from bristle.records.clock import one_rate


def record(name: str, h: float, u: np.ndarray) -> Record:
    time = 5.0 + h * np.arange(len(u))
    return Record(name, time, h, u, np.sin(time))


def mean_held(each: Record, begin: float, end: float) -> float:
    """The mean over an interval of an input of which each sample is held until the next one, and
    the last one on.
    """
    times = np.linspace(begin, end, 6001)[:-1] + (end - begin) / 12000
    return float(np.mean(each.u[np.searchsorted(each.time, times, side="right") - 1]))


@pytest.mark.parametrize("samples", [40, 41, 42, 43])
def test_the_held_input_is_averaged_over_each_new_interval_to_the_last(samples):
    """Whether the last new interval ends with the last sample's own, before, or beyond it."""
    fine = record("fine", 2e-3, np.random.default_rng(samples).uniform(1.0, 2.0, samples))
    coarse = record("coarse", 5e-3, np.ones(30))
    new, same = one_rate([fine, coarse])
    assert np.array_equal(same.u, coarse.u)
    assert new.h == coarse.h
    np.testing.assert_allclose(np.diff(new.time), coarse.h, rtol=1e-9)
    assert new.time[0] == fine.time[0]
    assert 0 <= fine.time[-1] - new.time[-1] < coarse.h
    expected = [mean_held(fine, begin, begin + coarse.h) for begin in new.time]
    np.testing.assert_allclose(new.u, expected, rtol=1e-3)
    np.testing.assert_allclose(new.y, np.sin(new.time), atol=1e-6)
