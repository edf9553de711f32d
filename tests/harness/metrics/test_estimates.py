"""Metrics against closed forms, and: what is not a number never passes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bristle.common.output import plain
from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import BusTrace, Port, Readings
from bristle.harness.metrics import checks
from bristle.harness.metrics import estimates as metrics
from bristle.harness.metrics.estimates import Course
from bristle.harness.scenario.scenario import Check

TIME = np.arange(1001) * 0.01
TRUE = np.full(1001, 4.0)
SOUND = np.ones(1001)


def readings(found: dict[Port, float]) -> Readings:
    return Readings.of(tuple(found), [(0, list(found.values()))])


def test_settling_of_an_exponential() -> None:
    # an error of exp(-t) leaves a band of 5 % at ln 20
    hat = TRUE * (1 + np.exp(-TIME))
    found = metrics.estimate(TIME, Course(hat, SOUND), TRUE)
    assert found["settling_s"] == pytest.approx(math.log(20), abs=0.01)
    assert found["error_percent"] == pytest.approx(100 * math.exp(-10), rel=1e-6)
    assert found["moved_percent"] == pytest.approx(100 * (1 - math.exp(-10)), rel=1e-9)


def test_error_has_a_sign_even_for_a_negative_truth() -> None:
    assert metrics.error_percent(np.array([-4.4]), -4.0)[0] == pytest.approx(-10.0)
    assert metrics.error_percent(np.array([3.6]), 4.0)[0] == pytest.approx(-10.0)


def test_settling_time_is_nan_if_the_error_does_not_settle() -> None:
    late = np.where(TIME >= 9.995, 9.9, 4.0)  # only the last sample is out
    assert math.isnan(metrics.estimate(TIME, Course(late, SOUND), TRUE)["settling_s"])
    assert metrics.estimate(TIME, Course(TRUE.copy(), SOUND), TRUE)["settling_s"] == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_bad_end_gives_no_error_and_no_settling(bad: float) -> None:
    hat = TRUE.copy()
    hat[-1] = bad
    found = metrics.estimate(TIME, Course(hat, SOUND), TRUE)
    assert math.isnan(found["error_percent"])
    assert math.isnan(found["settling_s"])
    assert not found["valid"]


def test_an_error_that_is_not_a_number_is_outside_every_band() -> None:
    error = np.zeros(1001)
    error[500] = math.nan
    assert metrics.settling(TIME, error) == pytest.approx(5.0)
    error[-1] = math.nan
    assert math.isnan(metrics.settling(TIME, error))


def test_not_valid_counts_as_an_error_without_bound() -> None:
    valid = (TIME < 5.0).astype(float)
    found = metrics.estimate(TIME, Course(TRUE.copy(), valid), TRUE)
    assert (found["valid"], math.isnan(found["final"]), math.isnan(found["error_percent"])) == (
        False,
        True,
        True,
    )
    early = metrics.estimate(TIME, Course(TRUE.copy(), 1 - valid), TRUE)
    assert early["settling_s"] == pytest.approx(4.99)


def test_an_observer_that_is_switched_off_has_not_moved() -> None:
    assert metrics.estimate(TIME, Course(TRUE.copy(), SOUND), TRUE)["moved_percent"] == 0.0


def test_without_truth_nothing_is_scored() -> None:
    found = metrics.estimate(TIME, Course(TRUE.copy(), SOUND))
    assert (found["true"], found["error_percent"], found["settling_s"]) == (None, None, None)
    assert found["final"] == 4.0


RESULT = {
    "a": {"b": 1.0, "nan": math.nan, "inf": math.inf, "none": None, "flag": True, "text": "1"}
}


@pytest.mark.parametrize(
    "path", ["a.nan", "a.inf", "a.none", "a.text", "a.missing", "missing.b", "a.b.c", "a"]
)
def test_nothing_but_a_finite_number_passes(path: str) -> None:
    for limits in ({"min": -1e300}, {"max": 1e300}, {"max_abs": 1e300}):
        [line] = checks.judge(RESULT, [Check(quantity=path, **limits)])
        assert line["pass"] is False


def test_true_and_false_are_checked_as_1_and_0() -> None:
    found = {"good": True, "bad": False}
    lines = checks.judge(
        found,
        [Check(quantity="good", min=1), Check(quantity="bad", min=1), Check(quantity="bad", max=0)],
    )
    assert [line["pass"] for line in lines] == [True, False, True]


@pytest.mark.parametrize(("last", "sd"), [(0.25, 0.25), (0.0, None), (math.inf, None)])
def test_a_standard_deviation_of_0_is_none(last: float, sd: float | None) -> None:
    assert metrics.estimate(TIME, Course(TRUE.copy(), SOUND, np.full(1001, last)))["sd"] == sd


def test_who_does_not_say_whether_he_adapted_is_judged_by_whether_the_estimate_moved() -> None:
    moved = TRUE.copy()
    moved[500:] += 1.0
    assert [
        metrics.estimate(TIME, Course(hat, SOUND))["adapted"] for hat in (TRUE.copy(), moved)
    ] == [False, True]
    assert [
        metrics.estimate(TIME, Course(moved, SOUND, adapted=said))["adapted"]
        for said in (False, True)
    ] == [False, True]


def test_an_estimate_that_is_never_valid_is_listed_and_one_that_a_method_does_not_have_is_not() -> (
    None
):
    record = tuple(("observer", f"{name}_hat") for name in ("b", "c", "Fc"))
    values = np.column_stack([np.zeros(5), np.arange(5.0), np.zeros(5)])
    flags = {
        ("observer", "b_valid"): 0.0,
        ("observer", "c_valid"): 0.0,
        ("observer", "Fc_valid"): 1.0,
    }
    found = metrics.courses(BusTrace(record, values, 1.0, readings(flags)), {"c": "1/rad"})
    assert [(name, course.unit, course.valid[-1]) for name, course in found.items()] == [
        ("c", "1/rad", 0.0),
        ("Fc", "1", 1.0),
    ]


def test_an_estimate_that_stays_0_is_listed_if_it_has_a_standard_deviation() -> None:
    record = (
        ("observer", "b_hat"),
        ("observer", "c_hat"),
        ("observer", "b_sd"),
        ("observer", "c_sd"),
    )
    values = np.column_stack([np.zeros((5, 2)), np.full(5, 1e9), np.zeros(5)])
    found = metrics.courses(
        BusTrace(
            record, values, 1.0, readings({("observer", f"{name}_valid"): 0.0 for name in "bc"})
        ),
        {},
    )
    assert list(found) == ["b"]


def test_a_state_that_the_observer_does_not_estimate_has_no_error() -> None:
    port, said = ("observer", "w_hat"), ("observer", "w_hat_valid")
    for known, expected in ((1.0, {"w"}), (0.0, set())):
        trace = BusTrace((port,), np.zeros((5, 1)), 1.0, readings({said: known}))
        assert set(metrics.state_errors(trace, {"w": np.ones(5)}, {})) == expected
    # another's FMU, without the flag
    assert metrics.estimates_state(BusTrace((port,), np.zeros((5, 1)), 1.0, readings({})), "w")
    assert not metrics.estimates_state(
        BusTrace((port,), np.full((5, 1), np.nan), 1.0, readings({})), "w"
    )


RESULT_OF_RECORD = {
    "adapted": True,
    "innovation": 1.0,
    "estimates": {n: {"valid": n != "c"} for n in ("alpha2", "b", "c")},
}


@pytest.mark.parametrize(
    ("changed", "failed"),
    [
        ({}, []),
        ({"adapted": False}, ["adapted"]),
        ({"innovation": 4.1}, ["innovation"]),
        ({"estimates": {"alpha2": {"valid": False}, "b": {"valid": True}}}, ["alpha2 valid"]),
        ({"estimates": {"vc": {"valid": True}, "c": {"valid": False}}}, ["c valid"]),
        ({"adapted": False, "estimates": {}}, ["adapted"]),
        # a start value
        ({"adapted": False, "innovation": 9.0, "estimates": {"c": {"valid": False}}}, ["adapted"]),
    ],
)
def test_without_checks_a_record_is_judged_by_what_the_observer_says(
    changed: dict[str, object], failed: list[str]
) -> None:
    result = {**RESULT_OF_RECORD, **changed}
    lines = checks.judge(result, checks.validity_checks(result, 4.0))
    assert [line["name"] for line in lines if not line["pass"]] == failed
    # a method without a limit, whose deviations grow
    without = checks.judge(result, checks.validity_checks(result, None))
    assert [line["name"] for line in without if not line["pass"]] == [
        name for name in failed if name != "innovation"
    ]


def test_every_limit_is_a_line_of_its_own() -> None:
    lines = checks.judge(RESULT, [Check(quantity="a.b", min=0.5, max=0.9, max_abs=2.0)])
    assert [(line["kind"], line["pass"]) for line in lines] == [
        ("min", True),
        ("max", False),
        ("max_abs", True),
    ]


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_limits_mean_what_they_say(value: float, limit: float) -> None:
    size = abs(limit)
    demands = [Check(quantity="x", min=limit, max=limit), Check(quantity="x", max_abs=size)]
    judged = {line["kind"]: line["pass"] for line in checks.judge({"x": value}, demands)}
    assert judged == {"min": value >= limit, "max": value <= limit, "max_abs": abs(value) <= size}


def test_json_has_null_for_what_is_not_a_number() -> None:
    assert plain({"x": [math.nan, np.float64(1.5), np.bool_(True), np.int64(3)]}) == {
        "x": [None, 1.5, True, 3]
    }


@pytest.mark.sampled(3, "observer")
def test_elements_side_by_side_are_compared_only_with_those_of_the_same_distances() -> None:
    plant, observer = (Fmu(obtain(what)) for what in ("plant", "observer"))
    own, other = metrics.element_distances(plant, {}), metrics.element_distances(observer, {})
    assert (own, other) == (
        {"c1": 50.0, "c2": 150.0, "c3": 450.0},
        {"c1": 30.0, "c2": 100.0, "c3": 300.0},
    )
    true = {"alpha2": np.ones(2), "sigma0_1": np.ones(2)}
    assert list(metrics.of_same_elements(true, own, other)) == ["alpha2"]
    same = metrics.element_distances(
        observer, {f"parallel_elements.{name}": c for name, c in own.items()}
    )
    assert list(metrics.of_same_elements(true, own, same)) == ["alpha2", "sigma0_1"]
