"""Velocities that are differences of an encoder's readings are told from those of a tachometer, and
summed to the position.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis.init.proposal import propose
from bristle.diagnosis.report.proposed_model import model_text
from bristle.records import records_from_arrays
from bristle.records.differences import are_differences, summed
from bristle.records.layout import LayoutTable, layout_lines, layout_of
from bristle.records.resolution import common_step

H, COUNT, N = 2e-3, 2 * np.pi / 4096, 6000
TREE = {
    "time": {"column": "t", "unit": "s"},
    "input": {"column": "u", "unit": "N.m", "kind": "torque"},
    "output": {"column": "w", "unit": "rpm", "kind": "velocity", "differences": True},
}


def servo() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, torque and position of a servo that turns to and fro, with viscous and dry friction."""
    t = H * np.arange(N)
    u = 0.25 * np.sin(2 * np.pi * 0.4 * t) + 0.2 * np.sin(2 * np.pi * 1.7 * t)
    theta, v, y, step = 0.0, 0.0, np.empty(N), 0.1 * H
    for k, torque in enumerate(u):
        y[k] = theta
        for _ in range(10):
            free = v + step / 0.01 * (torque - 0.02 * v)
            v = np.sign(free) * max(abs(free) - step / 0.01 * 0.12, 0.0)
            theta += step * v
    return t, u, y


def velocities(y: np.ndarray) -> dict[str, np.ndarray]:
    """The speed [rpm] as an encoder and as a tachometer show it, each in its steps."""
    counts, rng = np.floor(y / COUNT) * COUNT, np.random.default_rng(0)
    smooth = np.gradient(y, H) * 30 / np.pi
    return {
        "encoder": np.round(np.diff(counts, prepend=0.0) / H * 30 / np.pi, 3),
        "tachometer": np.round((smooth + rng.standard_normal(N)) / 0.1) * 0.1,
        "coarse converter": np.round((smooth + 2 * rng.standard_normal(N)) / 5.0) * 5.0,
        "central differences": np.round(np.gradient(counts, H) * 30 / np.pi, 3),
    }


def test_only_the_differences_of_readings_are_taken_for_such() -> None:
    found = {name: are_differences(w, common_step(w)) for name, w in velocities(servo()[2]).items()}
    assert found == {
        "encoder": True,
        "tachometer": False,
        "coarse converter": False,
        "central differences": False,
    }
    assert not are_differences(velocities(servo()[2])["encoder"], None)
    assert not are_differences(np.zeros(100), 1.0)


def test_the_sum_is_the_reading_of_the_encoder_however_few_digits_the_speed_has() -> None:
    t, u, y = servo()
    counts = np.floor(y / COUNT) * COUNT
    speed = velocities(y)["encoder"] * np.pi / 30
    assert np.abs(summed(speed, H) - counts).max() < 0.1 * COUNT
    [record] = records_from_arrays(
        layout_of(LayoutTable.model_validate(TREE), "tree"), [("a", t, u, speed)]
    )
    assert record.resolution == pytest.approx(COUNT, rel=1e-5)
    assert np.abs(record.y - counts).max() < 0.1 * COUNT


def test_a_layout_of_differences_is_that_of_a_position_and_reads_back() -> None:
    layout = layout_of(LayoutTable.model_validate(TREE), "tree")
    assert (layout.output_kind, layout.output_unit, layout.columns["output"][1]) == (
        "position",
        "rad",
        "rad/s",
    )
    assert layout_lines(layout)[-2:] == ['kind = "velocity"', "differences = true"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"kind": "position", "unit": "rad"}, "only a velocity is one of readings"),
        ({"resolution": 0.1}, "the step of the position follows from the velocities"),
    ],
)
def test_what_differences_cannot_be_is_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(BristleError, match=said):
        layout_of(
            LayoutTable.model_validate({**TREE, "output": {**TREE["output"], **given}}), "tree"
        )


@pytest.mark.parametrize(("sensor", "is_sum"), [("encoder", True), ("tachometer", False)])
def test_a_proposal_says_which_it_is(sensor: str, is_sum: bool, tmp_path: Path) -> None:
    t, u, y = servo()
    table = np.column_stack([t, u, velocities(y)[sensor]])
    np.savetxt(
        tmp_path / "a.csv",
        table,
        delimiter=",",
        header="t [s],torque [Nm],speed [rpm]",
        comments="",
        fmt="%.6f",
    )
    found = propose(tmp_path / "a.csv")
    assert found.differences is is_sum
    assert ("differences = true" in model_text(found, "")) is is_sum
    assert found.rough["J"].value == pytest.approx(0.01, rel=0.1)
