"""What thresholds could do is counted with the answers known: where the missing stood, and the
least price of the right ones.
"""

from __future__ import annotations

import numpy as np
import pytest
from refused import STANDS, prices, refused, standings, stood, unflagged
from score import Judged

ALONE = ["gravity"]
BOTH = ["gravity", "bias/asymmetric_coulomb"]


def test_the_price_of_each_number_of_right_ones() -> None:
    missing = np.array([True, True, False, False])
    figures = np.array([[9.0, 1.0], [2.0, 1.0], [5.0, 0.5], [1.0, 2.0]])
    # the second figure tells the third apart, the first one the fourth
    assert prices(missing, figures) == {1: 0, 2: 0}
    figures[2, 1] = 1.0
    assert prices(missing, figures) == {1: 0, 2: 1}


def test_what_was_refused_and_whether_it_was_missing() -> None:
    leader = {"name": "bias", "kept": 4.0}
    last = {"added": None, "rejected": "bias", "candidates": [leader]}
    last |= {"gain": 30.0, "null_level": 10.0, "size": 1.1}
    result = {
        "verdict": "named",
        "effects": [{"name": "gravity"}],
        "rounds": [{"gain": 60.0}, last],
    }
    alone, both = (
        {"group": "pair", "effects": [{"name": c} for c in classes]} for classes in (ALONE, BOTH)
    )
    short, outside = result | {"rounds": [{"gain": 60.0}]}, {"group": "outside", "effects": []}
    pairs = [(both, result), (alone, result), (alone, short), (outside, result)]
    assert list(refused(pairs)) == [(True, (3.0, 0.5, 1.1, 4.0)), (False, (3.0, 0.5, 1.1, 4.0))]


def test_what_was_named_without_a_flag_and_what_its_views_show() -> None:
    left, gap = {"flag": False, "view": "v", "share": 0.4}, {"before": 8.0, "after": 2.0}
    right = {"verdict": "named", "effects": [{"name": "gravity"}], "remains": left, "gap": gap}
    wrong, chance, flagged = (
        {**right, **more}
        for more in (
            {"effects": [{"name": "bias"}]},
            {"remains": left | {"view": None}},
            {"remains": left | {"flag": True}},
        )
    )
    alone, outside = (
        {"group": "same", "effects": [{"name": "gravity"}]},
        {"group": "outside", "effects": []},
    )
    pairs = [
        (alone, right),
        (alone, wrong),
        (alone, chance),
        (alone, flagged),
        (outside, right),
        (outside, flagged),
    ]
    # flags are asked about where the excitation is rich
    pairs.append((alone | {"group": "poor"}, right))
    assert list(unflagged(pairs)) == [(False, (0.4, 0.1)), (False, (0.0, 0.0)), (True, (0.4, 0.1))]
    assert list(unflagged([(outside, right | {"verdict": "tie"})])) == []


def case(classes, named, rejected="hard_stop", **more):
    """Return a case of the given truth whose last round tried a stop (30 nats), a bias (20 nats)
    and no dead zone.
    """
    answer = {"group": "pair", "effects": [{"name": c, "form": "other"} for c in classes]}
    tried = [
        {"name": "hard_stop", "gain": 30.0, "level": 10.0},
        {"name": "bias", "gain": 20.0, "level": 10.0},
    ]
    tried.append({"name": "dead_zone", "gain": None, "level": 10.0})
    last = {"added": None, "rejected": rejected, "candidates": tried}
    return answer, {
        "verdict": "named",
        "effects": [{"name": n} for n in named],
        "ties": [],
        "rounds": [last | more],
    }


@pytest.mark.parametrize(
    ("truth", "named", "more", "stand"),
    [
        (["gravity", "hard_stop"], ["gravity"], {}, "led and refused"),
        (["gravity", "bias/asymmetric_coulomb"], ["gravity"], {}, "behind another"),
        (["gravity", "dead_zone"], ["gravity"], {}, "not beyond chance"),
        (["gravity", "hard_stop"], ["gravity"], {"added": "gravity"}, "no round left"),
        (["gravity"], ["gravity", "hard_stop"], {"added": "hard_stop"}, "named, one too many"),
    ],
)
def test_where_the_missing_effect_stood(truth, named, more, stand):
    assert stood(Judged(*case(truth, named, **more))) == stand
    assert stand in STANDS


def test_those_not_right_are_counted_by_group_and_form():
    right, wrong = case(["gravity"], ["gravity"]), case(["gravity", "hard_stop"], ["gravity"])
    assert standings([right, wrong]) == {("pair", "other"): {"": 2, "led and refused": 1}}
