"""What thresholds could do is counted with the answers known: the least price of each number of right ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from refused import prices, refused


def test_the_price_of_each_number_of_right_ones() -> None:
    missing = np.array([True, True, False, False])
    figures = np.array([[9.0, 1.0], [2.0, 1.0], [5.0, 0.5], [1.0, 2.0]])
    assert prices(missing, figures) == {1: 0, 2: 0}  # the second figure tells the third apart, the first one the fourth
    figures[2, 1] = 1.0
    assert prices(missing, figures) == {1: 0, 2: 1}


def test_what_was_refused_and_whether_it_was_missing(tmp_path: Path) -> None:
    def put(part: str, name: str, content: object) -> None:
        (tmp_path / part).mkdir(exist_ok=True)
        (tmp_path / part / f"{name}.json").write_text(json.dumps(content))

    leader = {"name": "bias", "kept": 4.0}
    last = {"added": None, "decision": "'bias' is certain but small", "candidates": [leader]}
    last |= {"gain": 30.0, "null_level": 10.0, "size": 1.1}
    result = {"verdict": "named", "effects": [{"name": "gravity"}], "rounds": [{"gain": 60.0}, last]}
    for name, hidden in (("1", ["gravity", "bias/asymmetric_coulomb"]), ("2", ["gravity"])):
        put("answers", name, {"group": "pair", "effects": [{"class": each} for each in hidden]})
        put("results", name, result)
    put("answers", "3", {"group": "pair", "effects": [{"class": "gravity"}]})
    put("results", "3", result | {"rounds": [{"gain": 60.0}]})
    put("answers", "4", {"group": "outside", "effects": []})
    put("results", "4", result)
    assert list(refused(tmp_path)) == [(True, (3.0, 0.5, 1.1, 4.0)), (False, (3.0, 0.5, 1.1, 4.0))]
