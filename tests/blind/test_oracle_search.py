"""The answer of a case is given to the search as options; what it names then is counted."""

from __future__ import annotations

from oracle_search import known_answer, table

from bristle.diagnosis import SearchOptions

ANSWER = {
    "case": 7,
    "group": "pair",
    "effects": [
        {
            "name": "gravity",
            "class": "gravity",
            "form": "same",
            "parameters": {"amplitude": 0.2, "phase": None},
        },
        {"name": "dead_zone", "class": "dead_zone", "form": "same", "parameters": {}},
    ],
}


def test_an_answer_becomes_start_values_and_effort() -> None:
    options = SearchOptions(**known_answer(ANSWER))
    # no parameter of the dead zone is known
    assert options.start_values == {"gravity": [{"amplitude": 0.2}]}
    assert set(options.exhaustive) == {"gravity", "dead_zone"}
    assert options.test_input_hold


def test_cases_right_with_the_answer_known_are_counted_apart_from_refused_ones() -> None:
    said = {"verdict": "named", "effects": [{"name": "gravity"}], "ties": []}
    last = {"added": None, "rejected": "dead_zone"}
    refused = said | {
        "rounds": [last | {"candidates": [{"name": "dead_zone", "gain": 30.0, "level": 10.0}]}]
    }
    right = said | {"effects": [{"name": "gravity"}, {"name": "dead_zone"}], "rounds": []}
    other = ANSWER | {"case": 8}
    lines = table(
        [(ANSWER, said), (other, said)], lambda answer: right if answer["case"] == 7 else refused
    ).splitlines()
    counts = dict(zip(lines[0].split(" | "), lines[2].split(" | "), strict=True))
    assert counts["not right"] == "2"
    assert counts["right with the answer known"] == "1"
    assert counts["led and refused"] == "1"
    assert lines[-2].endswith("| gravity, dead_zone | gravity | gravity, dead_zone | right |")
    assert lines[-1].endswith("| gravity, dead_zone | gravity | gravity | led and refused |")
