"""Results in the forms that notebooks use: tables of pandas, data sets of xarray, HTML."""

from __future__ import annotations

import sys
import xml.etree.ElementTree
from pathlib import Path

import numpy as np
import pytest

import bristle

HIDDEN = Path(__file__).resolve().parents[2] / "scenarios" / "hidden" / "07"


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    overrides = {"duration": "3 s", "checks.0.max_abs": 1e-9}
    return bristle.run("quick", tmp_path_factory.mktemp("frames"), overrides=overrides)


def test_the_tables_of_pandas_hold_what_the_result_holds(result):
    pandas = pytest.importorskip("pandas")
    signals, written = result.to_pandas(), result.signals()
    assert signals.index.name == "time"
    np.testing.assert_array_equal(signals.index, written["time"])
    assert [*signals.columns] == [name for name in written if name != "time"]
    np.testing.assert_array_equal(signals["u"], written["u"])
    estimates = result.to_pandas("estimates")
    assert [*estimates.index] == [*result.estimates]
    assert estimates.loc["b", "true"] == result.estimates["b"]["true"]
    assert estimates.loc["b", "unit"] == "rad/(s2.V)"
    checks = result.to_pandas("checks")
    assert [*checks["name"]] == [check["name"] for check in result.checks]
    assert checks["pass"].dtype == bool
    assert isinstance(checks, pandas.DataFrame)


def test_the_data_set_of_xarray_has_signals_and_estimates(result):
    pytest.importorskip("xarray")
    found = result.to_xarray()
    assert found.attrs == {"scenario": "quick", "verdict": "fail"}
    np.testing.assert_array_equal(found["theta"].values, result.signals()["theta"])
    assert found["u"].dims == ("time",)
    assert found["time"].attrs["units"] == "s"
    chosen = found.sel(parameter="b")
    assert float(chosen["estimate_true"]) == result.estimates["b"]["true"]
    assert str(chosen["unit"].values) == "rad/(s2.V)"
    none = [name for name, e in result.estimates.items() if e["error_percent"] is None]
    assert none
    assert np.isnan(found["estimate_error_percent"].sel(parameter=none).values).all()
    assert set(found["estimate_valid"].values) <= {0.0, 1.0}


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_without_the_extra_the_error_says_how_to_get_it(result, monkeypatch, message, name):
    monkeypatch.setitem(sys.modules, name, None)
    said = message(getattr(result, f"to_{name}"))
    assert said == f"{name} is not installed; run: pip install 'bristle[frames]'"


def test_an_unknown_table_is_refused(result, message):
    assert message(lambda: result.to_pandas("honey")).startswith(
        "table is 'honey'; choose one of: 'signals'"
    )


def test_a_notebook_shows_the_verdict_and_every_estimate(result):
    page = xml.etree.ElementTree.fromstring(
        f"<div>{result._repr_html_().replace('<wbr>', '')}</div>"
    )
    texts = [cell.text for cell in page.iter("td")]
    assert {*result.estimates} <= {*texts}
    assert next(page.iter("b")).text == "quick: fail"
    assert texts.count("FAIL") == sum(not check["pass"] for check in result.checks) > 0
    assert "nan" not in result._repr_html_().lower()


def test_a_name_with_marks_of_html_is_text(result, tmp_path):
    data = {
        **result.data,
        "checks": [
            {"name": "a < b & c", "kind": "max", "value": None, "limit": 1.0, "pass": False}
        ],
    }
    assert "<td>a &lt; b &amp; c</td>" in bristle.Result(data, tmp_path)._repr_html_()


def test_a_notebook_shows_what_a_diagnosis_says(tmp_path):
    model = tmp_path / "model.toml"
    model.write_text(
        (HIDDEN / "model.toml").read_text(encoding="utf-8").replace('"N.m"', '"mN.m"'),
        encoding="utf-8",
    )
    found = bristle.diagnose(model, [HIDDEN / "a.npz", HIDDEN / "b.npz"])
    shown = found._repr_html_()
    assert "(not identifiable)" in shown
    assert all(
        sentence.partition("'")[0].partition("<")[0] in shown for sentence in found.statement
    )
    assert "<table>" not in shown
