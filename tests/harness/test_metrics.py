"""Metrics against closed forms, and: what is not a number never passes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bristle.common.output import plain
from bristle.harness import metrics
from bristle.harness.scenario import Check

TIME = np.arange(1001) * 0.01
TRUE = np.full(1001, 4.0)
SOUND = np.ones(1001)


def test_mse_of_a_sine_with_a_known_error() -> None:
    t = np.linspace(0, 2 * math.pi, 100_001)[:-1]
    measured = 3.0 * np.sin(t)
    # error 0.3 cos t plus a constant, which the variance does not see: 100 * 0.3^2 / 3^2
    assert metrics.mse_percent(measured, measured + 0.3 * np.cos(t) + 5.0) == pytest.approx(1.0, rel=1e-9)
    assert metrics.mse_percent(measured, measured) == 0.0
    assert metrics.mse_percent(measured, 0 * measured) == pytest.approx(100.0)


def test_settling_of_an_exponential() -> None:
    # an error of exp(-t) leaves a band of 5 % at ln 20
    hat = TRUE * (1 + np.exp(-TIME))
    found = metrics.estimate(TIME, hat, SOUND, TRUE, "1/s")
    assert found["settling_s"] == pytest.approx(math.log(20), abs=0.01)
    assert found["error_percent"] == pytest.approx(100 * math.exp(-10), rel=1e-6)
    assert found["moved_percent"] == pytest.approx(100 * (1 - math.exp(-10)), rel=1e-9)


def test_error_has_a_sign_even_for_a_negative_truth() -> None:
    assert metrics.error_percent(np.array([-4.4]), -4.0)[0] == pytest.approx(-10.0)
    assert metrics.error_percent(np.array([3.6]), 4.0)[0] == pytest.approx(-10.0)


def test_settling_time_is_nan_if_the_error_does_not_settle() -> None:
    late = np.where(TIME >= 9.995, 9.9, 4.0)  # only the last sample is out
    assert math.isnan(metrics.estimate(TIME, late, SOUND, TRUE, "1")["settling_s"])
    assert metrics.estimate(TIME, TRUE.copy(), SOUND, TRUE, "1")["settling_s"] == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_bad_end_gives_no_error_and_no_settling(bad: float) -> None:
    hat = TRUE.copy()
    hat[-1] = bad
    found = metrics.estimate(TIME, hat, SOUND, TRUE, "1")
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
    found = metrics.estimate(TIME, TRUE.copy(), valid, TRUE, "1")
    assert (found["valid"], math.isnan(found["final"]), math.isnan(found["error_percent"])) == (False, True, True)
    early = metrics.estimate(TIME, TRUE.copy(), 1 - valid, TRUE, "1")
    assert early["settling_s"] == pytest.approx(4.99)


def test_an_observer_that_is_switched_off_has_not_moved() -> None:
    assert metrics.estimate(TIME, TRUE.copy(), SOUND, TRUE, "1")["moved_percent"] == 0.0


def test_without_truth_nothing_is_scored() -> None:
    found = metrics.estimate(TIME, TRUE.copy(), SOUND, None, "1")
    assert (found["true"], found["error_percent"], found["settling_s"]) == (None, None, None)
    assert found["final"] == 4.0


RESULT = {"a": {"b": 1.0, "nan": math.nan, "inf": math.inf, "none": None, "flag": True, "text": "1"}}


@pytest.mark.parametrize("path", ["a.nan", "a.inf", "a.none", "a.flag", "a.text", "a.missing", "missing.b", "a.b.c", "a"])
def test_nothing_but_a_finite_number_passes(path: str) -> None:
    for limits in ({"min": -1e300}, {"max": 1e300}, {"max_abs": 1e300}):
        [line] = metrics.judge(RESULT, [Check(quantity=path, **limits)])
        assert line["pass"] is False


def test_every_limit_is_a_line_of_its_own() -> None:
    lines = metrics.judge(RESULT, [Check(quantity="a.b", min=0.5, max=0.9, max_abs=2.0)])
    assert [(line["kind"], line["pass"]) for line in lines] == [("min", True), ("max", False), ("max_abs", True)]


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_limits_mean_what_they_say(value: float, limit: float) -> None:
    result = {"x": value}
    judged = {
        line["kind"]: line["pass"] for line in metrics.judge(result, [Check(quantity="x", min=limit, max=limit, max_abs=limit)])
    }
    assert judged == {"min": value >= limit, "max": value <= limit, "max_abs": abs(value) <= limit}


def test_json_has_null_for_what_is_not_a_number() -> None:
    assert plain({"x": [math.nan, np.float64(1.5), np.bool_(True), np.int64(3)]}) == {"x": [None, 1.5, True, 3]}
