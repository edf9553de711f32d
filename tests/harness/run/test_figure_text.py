"""The texts of the figures of a run say what is seen."""

import math

import numpy as np
import pytest

from bristle.harness.metrics.estimates import Course
from bristle.harness.run.figure_text import seen
from bristle.harness.run.pictures import Pictures

FACTS = {
    "unit": "1/s",
    "true": 2.0,
    "final": 2.002,
    "valid": True,
    "error_percent": 0.1,
    "settling_s": 51.2,
}


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({}, "estimate of alpha2 settles at 51.2 s, ends at 2.002 1/s against a true 2"),
        (
            {"settling_s": math.inf},
            "estimate of alpha2 does not settle, ends at 2.002 1/s against a true 2",
        ),
        (
            {"true": 0.0, "error_percent": math.nan},
            "estimate of alpha2 ends at 2.002 1/s against a true 0",
        ),
        (
            {"true": None, "error_percent": None, "settling_s": None},
            "estimate of alpha2 ends at 2.002 1/s",
        ),
        (
            {"valid": False, "final": math.nan, "error_percent": math.nan},
            "estimate of alpha2 is not valid at the end",
        ),
    ],
)
def test_an_estimate_is_told_in_numbers(changed: dict[str, float], text: str) -> None:
    time = np.arange(3.0)
    course = {"alpha2": Course(time, np.ones(3))}
    assert seen("estimates", Pictures(time, {"alpha2": FACTS | changed}, course, {})) == text
