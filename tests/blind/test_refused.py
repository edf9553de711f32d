"""What thresholds could do is counted with the answers known: the least price of each number of right ones."""

from __future__ import annotations

import numpy as np
from refused import prices, refused

ALONE = ["gravity"]
BOTH = ["gravity", "bias/asymmetric_coulomb"]


def test_the_price_of_each_number_of_right_ones() -> None:
    missing = np.array([True, True, False, False])
    figures = np.array([[9.0, 1.0], [2.0, 1.0], [5.0, 0.5], [1.0, 2.0]])
    assert prices(missing, figures) == {1: 0, 2: 0}  # the second figure tells the third apart, the first one the fourth
    figures[2, 1] = 1.0
    assert prices(missing, figures) == {1: 0, 2: 1}


def test_what_was_refused_and_whether_it_was_missing() -> None:
    leader = {"name": "bias", "kept": 4.0}
    last = {"added": None, "decision": "'bias' is certain but small", "candidates": [leader]}
    last |= {"gain": 30.0, "null_level": 10.0, "size": 1.1}
    result = {"verdict": "named", "effects": [{"name": "gravity"}], "rounds": [{"gain": 60.0}, last]}
    alone, both = ({"group": "pair", "effects": [{"class": c} for c in classes]} for classes in (ALONE, BOTH))
    short, outside = result | {"rounds": [{"gain": 60.0}]}, {"group": "outside", "effects": []}
    pairs = [(both, result), (alone, result), (alone, short), (outside, result)]
    assert list(refused(pairs)) == [(True, (3.0, 0.5, 1.1, 4.0)), (False, (3.0, 0.5, 1.1, 4.0))]
