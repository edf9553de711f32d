"""Signed numbers that a logger wrote as unsigned ones."""

import numpy as np
import pytest

from bristle.common.columns import Columns
from bristle.records.layout import LayoutTable, layout_of
from bristle.records.signed import signed_input

N = 400
TREE = {
    "time": {"column": "t", "unit": "s"},
    "input": {"column": "i", "kind": "current", "unit": "A", "scale": "0.001"},
    "output": {"column": "q", "kind": "position", "unit": "rad"},
}


def read(values, **table):
    tree = {**TREE, "input": {**TREE["input"], **table}}
    layout = layout_of(LayoutTable.model_validate(tree), "model.toml")
    columns = Columns({"t": np.arange(N) * 1e-3, "i": np.asarray(values, float)})
    return signed_input(layout, columns)


def wave(size=900):
    return np.round(size * np.sin(0.05 * np.arange(N)))


@pytest.mark.parametrize("bits", [16, 32])
def test_an_input_below_zero_is_read_as_such(bits):
    found = read(wave() % 2**bits)
    assert found["i"] == pytest.approx(wave(), abs=0)
    [line] = found.findings
    assert f"{2**bits - 1} is read as -1" in line


def test_samples_that_are_missing_stay_missing():
    values = wave() % 2**16
    values[7] = np.nan
    found = read(values)["i"]
    assert np.isnan(found[7])
    assert np.nanmin(found) == -900


@pytest.mark.parametrize(
    "values",
    [
        wave(),  # signed already
        wave() + 900,  # of one sign
        wave(32000) + 32767,  # all over the register
        np.where(wave() > 0, 65535, 0),  # switched
        wave() % 2**16 + 0.5,  # no register holds a half
    ],
)
def test_other_inputs_stay_as_they_are(values):
    found = read(values)
    assert (found["i"] == values).all()
    assert found.findings == ()


def test_a_goal_is_none():
    values = wave() % 2**16
    found = read(values, kind="setpoint", unit="rad")
    assert (found["i"] == values).all()
