"""The search is told an answer, and only as long as it is to know it; what it says then is counted."""

from __future__ import annotations

import pytest
from oracle_search import table, told

from bristle.diagnosis.selection import candidates
from bristle.diagnosis.selection import stepwise as search

ANSWER = {
    "case": 7,
    "group": "pair",
    "effects": [
        {"name": "gravity", "class": "gravity", "form": "same", "parameters": {"amplitude": 0.2, "phase": None}},
        {"name": "dead_zone", "class": "dead_zone", "form": "same", "parameters": {}},
    ],
}


def test_an_answer_is_a_start_and_its_effects_are_followed_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(candidates, "start_values", lambda name, _: [{"amplitude": 0.1}])
    for module in (candidates, search):
        monkeypatch.setattr(module, "explore", lambda *arguments: arguments[-1])
        monkeypatch.setattr(module, "advance", lambda *arguments: arguments[-1])
    before = candidates.start_values, search.starts, search.explore, search.advance
    with told(ANSWER):
        assert search.starts("gravity", None) == [{"amplitude": 0.2}, {"amplitude": 0.1}]
        assert candidates.start_values("gravity", None) == search.starts("gravity", None)
        assert search.starts("dead_zone", None) == [{"amplitude": 0.1}]  # nothing is known of its parameters
        for name, effort in (("gravity", candidates.EXHAUSTIVE), ("dead_zone", candidates.EXHAUSTIVE), ("bias", candidates.QUICK)):
            assert search.explore(None, None, name, candidates.QUICK) is effort
            assert search.advance(candidates.Candidate(name, None), None, 0.0, candidates.QUICK) is effort
    assert before == (candidates.start_values, search.starts, search.explore, search.advance)


def test_what_is_right_when_told_is_counted_apart_from_what_is_refused_even_then() -> None:
    said = {"verdict": "named", "effects": [{"name": "gravity"}], "ties": []}
    last = {"added": None, "decision": "'dead_zone' is certain but small"}
    refused = said | {"rounds": [last | {"candidates": [{"name": "dead_zone", "gain": 30.0, "level": 10.0}]}]}
    right = said | {"effects": [{"name": "gravity"}, {"name": "dead_zone"}], "rounds": []}
    other = ANSWER | {"case": 8}
    lines = table([(ANSWER, said), (other, said)], lambda answer: right if answer["case"] == 7 else refused).splitlines()
    counts = dict(zip(lines[0].split(" | "), lines[2].split(" | "), strict=True))
    assert counts["not right"] == "2"
    assert counts["right when told"] == "1"
    assert counts["led and refused"] == "1"
    assert lines[-2].endswith("| gravity, dead_zone | gravity | gravity, dead_zone | right |")
    assert lines[-1].endswith("| gravity, dead_zone | gravity | gravity | led and refused |")
