"""The input between two samples."""

import numpy as np

from bristle.records.input_hold import mixed


def test_an_input_is_a_mean_of_each_sample_and_the_next():
    u = np.array([1.0, 3.0, -1.0])
    np.testing.assert_array_equal(mixed(u, 0.0), u)
    np.testing.assert_array_equal(mixed(u, 1.0), [3.0, -1.0, -1.0])
    np.testing.assert_allclose(mixed(u, 0.25), [1.5, 2.0, -1.0])
