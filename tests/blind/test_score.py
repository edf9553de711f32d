"""The scorer counts what it should: fabricated diagnoses, right and wrong ones."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from cases import seal
from forms import class_of
from run import check_seal
from score import Judged, figures, normalise, parameter_error, parameter_rows, tables
from shared import upper_bound

Json = dict[str, Any]
Pair = tuple[Json, Json]


def effect(name: str, **parameters: float) -> Json:
    return {"name": name, "class": class_of(name), "form": "same", "parameters": parameters}


def answer(group: str, *effects: Json, variant: str | None = None, ratio: float = 5.0) -> Json:
    kind = {"same": "single", "other": "single", "low": "single", "faint": "single"}.get(
        group, group
    )
    gap = {"base": ratio, "floor": 1.0, "ratio": ratio}
    return {
        "kind": kind,
        "group": group,
        "variant": variant,
        "effects": list(effects),
        "gap": gap,
        "rejected": [],
        "fields": {},
    }


def result(
    verdict: str, *effects: Json, flag: bool = False, ties: list[list[str]] | None = None
) -> Json:
    found = []
    for e in effects:
        near = {k: {"value": v, "ci95": [v - 0.1, v + 0.1]} for k, v in e["parameters"].items()}
        found.append({"name": e["name"], "class": e["class"], "parameters": near})
    remains = {"flag": flag, "view": None, "share": 0.0}
    return {
        "verdict": verdict,
        "effects": found,
        "ties": ties or [],
        "remains": remains,
        "gap": {"shrink": 1.0},
        "seconds": 2.0,
    }


GRAVITY, COGGING, BIAS = (
    effect("gravity", amplitude=0.3, phase=1.0),
    effect("cogging", amplitude=0.2),
    effect("bias", torque=0.5),
)


def perfect() -> list[Pair]:
    """Return a run without a fault, of every group."""
    ratios = {"same": 5.0, "other": 9.0, "low": 1.5, "faint": 1.2}
    one = [
        (answer(group, GRAVITY, ratio=ratio), result("named", GRAVITY))
        for group, ratio in ratios.items()
    ]
    return [
        *(deepcopy(pair) for pair in one for _ in range(300)),
        *((answer("control", variant="noise_only"), result("none")) for _ in range(240)),
        *((answer("outside", variant="timed_tone"), result("none", flag=True)) for _ in range(240)),
        *((answer("pair", GRAVITY, BIAS), result("named", BIAS, GRAVITY)) for _ in range(160)),
        *((answer("poor", GRAVITY), result("tie", ties=[["bias", "gravity"]])) for _ in range(160)),
    ]


def unmet(pairs: list[Pair]) -> set[str]:
    return {
        figure.name for figure in figures([Judged(*pair) for pair in pairs]) if figure.met is False
    }


def spoil(group: str, count: int, change: Callable[[Json], None]) -> set[str]:
    """Return the goals missed once `count` results of a group are changed."""
    pairs = perfect()
    for _, each in [pair for pair in pairs if pair[0]["group"] == group][:count]:
        change(each)
    return unmet(pairs)


def says(verdict: str, *effects: Json, **more: Any) -> Callable[[Json], None]:
    return lambda each: each.update(result(verdict, *effects, **more))


def test_a_faultless_run_meets_every_goal_but_that_of_intervals() -> None:
    # all of them cover: too wide
    assert unmet(perfect()) == {"95 % intervals that cover the truth, own form"}


def test_few_intervals_that_all_cover_the_truth_are_not_too_wide() -> None:
    assert "95 % intervals that cover the truth, own form" not in unmet(perfect()[:6])


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("group", "allowed", "change", "goal"),
    [
        ("same", 3, says("none"), "not named right, own form, ratio >= 2"),
        (
            "other",
            9,
            says("tie", ties=[["gravity", "bias"]]),
            "not named right, other form, ratio >= 2",
        ),
        ("low", 45, says("none"), "named right, ratio 1.3 to 2"),
        ("control", 1, says("named", BIAS), "false alarm on a control (anything named)"),
        ("outside", 1, says("named", BIAS), "outside: misnamed without a flag"),
        ("outside", 6, says("none"), "outside: not flagged"),
        ("pair", 3, says("named", GRAVITY), "pairs: an effect missed"),
        ("pair", 1, says("named", GRAVITY, BIAS, COGGING), "pairs: a wrong extra effect"),
        (
            "poor",
            3,
            says("tie", ties=[["cogging", "bias"]]),
            "poor excitation: truth neither named nor in the tie, nor called not identifiable",
        ),
        ("same", 0, says("error"), "cases that ended in an error"),
    ],
)
def test_faults_are_counted_and_one_too_many_misses_the_goal(
    group: str, allowed: int, change: Callable[[Json], None], goal: str
) -> None:
    assert goal not in spoil(group, allowed, change)
    assert goal in spoil(group, allowed + 1, change)


def test_wrong_names_count_wherever_they_are() -> None:
    pairs = perfect()
    for group in ("same", "faint", "pair", "poor"):
        next(r for a, r in pairs if a["group"] == group).update(result("named", COGGING))
    found = {f.name: f for f in figures([Judged(*pair) for pair in pairs])}
    assert found["a wrong class among all that were named"].count == 4
    assert found["poor excitation: a wrong name, or a tie without the truth"].count == 1


def test_a_name_of_the_same_class_is_right_but_not_strictly() -> None:
    case = Judged(answer("same", BIAS), result("named", effect("asymmetric_coulomb", share=0.1)))
    assert case.right
    assert not case.strict
    assert not Judged(answer("same", BIAS), result("named", BIAS, GRAVITY)).right
    assert Judged(answer("same", BIAS), result("tie", BIAS)).named == []  # a tie names nothing


def test_other_forms_are_counted_apart_by_whether_the_catalogue_can_take_them() -> None:
    stop = effect("hard_stop", stiffness=1.0)
    drawn = [
        (GRAVITY, {}),
        (COGGING, {}),
        (stop, {"hard_stop_kind": 1.0}),
        (stop, {"hard_stop_kind": 2.0}),
    ]
    pairs = [(answer("other", e) | {"fields": fields}, result("none")) for e, fields in drawn]
    found = {f.name: f for f in figures([Judged(*pair) for pair in pairs])}
    for words in ("the catalogue can take", "it cannot take"):
        assert found[f"of these, a form that {words}"].count == 2


def test_one_of_two_is_in_part_and_none_is_no_help_on_poor_records() -> None:
    assert Judged(answer("pair", GRAVITY, COGGING), result("named", COGGING)).outcome == "in part"
    silent = result("none") | {"experiment": "record steps of many sizes"}
    pairs = [(answer("poor", GRAVITY), silent)]
    found = {f.name: f for f in figures([Judged(*pair) for pair in pairs])}
    assert (
        found[
            "poor excitation: truth neither named nor in the tie, nor called not identifiable"
        ].count
        == 1
    )


def test_the_class_is_the_scorers_own() -> None:
    lie = result("named", COGGING)
    lie["effects"][0]["class"] = "gravity"
    assert Judged(answer("same", GRAVITY), lie).outcome == "wrong"


def test_bounds() -> None:
    assert upper_bound(0, 60) == pytest.approx(1 - 0.05 ** (1 / 60))
    assert upper_bound(1, 1) == 1.0
    assert upper_bound(3, 300) < 0.026


def test_waves_are_compared_up_to_sign_and_turn() -> None:
    seen = normalise("gravity", {"amplitude": -0.3, "phase": 1.0 - math.pi})
    assert seen == pytest.approx({"amplitude": 0.3, "phase": 1.0})
    assert parameter_error("phase", 3.1, -3.1) == pytest.approx((2 * math.pi - 6.2) / (2 * math.pi))
    assert parameter_error("amplitude", 0.2, 0.25) == pytest.approx(0.25)
    flipped = effect("gravity", amplitude=-0.3, phase=1.0 - math.pi)
    rows = parameter_rows([Judged(answer("same", GRAVITY), result("named", flipped))])
    assert [covered for *_, covered in rows] == [True, True]
    assert max(error for _, error, _ in rows) < 1e-9
    off = effect("gravity", amplitude=0.45, phase=1.3)
    rows = parameter_rows([Judged(answer("same", GRAVITY), result("named", off))])
    assert [covered for *_, covered in rows] == [False, False]


def test_tables_are_complete() -> None:
    head, markdown, data = tables(perfect())
    assert "| figure | value |" in head
    assert data["cases"] == len(perfect())
    for head in (
        "Outcomes",
        "By gap ratio",
        "By effect",
        "Controls",
        "Outside the catalogue",
        "Confusion",
        "Parameters",
    ):
        assert f"## {head}" in markdown
    json.dumps(data, allow_nan=False)


def test_an_empty_run_has_tables_too() -> None:
    assert tables([])[2]["cases"] == 0


def test_a_changed_answer_breaks_the_seal(tmp_path: Path) -> None:
    folder = tmp_path / "answers"
    folder.mkdir()
    (folder / "00001.json").write_text("{}", encoding="utf-8")
    seal(tmp_path)
    check_seal(tmp_path)
    (folder / "00001.json").write_text("[]", encoding="utf-8")
    with pytest.raises(SystemExit, match=r"does not match answers\.sha256"):
        check_seal(tmp_path)


def test_a_name_is_in_doubt_by_each_of_four_signs() -> None:
    sure = result("named", GRAVITY | {"parameters": {"amplitude": 0.3}})
    assert not Judged(answer("same", GRAVITY), sure).doubted
    assert Judged(answer("same", GRAVITY), sure | {"remains": {"flag": True}}).doubted
    assert Judged(answer("same", GRAVITY), sure | {"agreement": {"holds": False}}).doubted
    assert not Judged(answer("same", GRAVITY), sure | {"agreement": {"holds": True}}).doubted
    for after, doubted in ((2.0, True), (0.5, False), (None, True)):
        horizons = {"horizons": [{"before": 1.0, "after": after}]}
        assert Judged(answer("same", GRAVITY), sure | {"whole_record": horizons}).doubted is doubted
    weak = result("named", GRAVITY | {"parameters": {"amplitude": 0.19, "phase": 0.0}})
    assert Judged(answer("same", GRAVITY), weak).doubted  # 0.19 +- 0.1
    found = {f.name: f for f in figures([Judged(answer("same", GRAVITY), r) for r in (sure, weak)])}
    assert found["in doubt (no green heading) although named right"].count == 1
    found = {f.name: f for f in figures([Judged(answer("same", COGGING), r) for r in (sure, weak)])}
    assert found["a wrong name, and no doubt said"].count == 1
