"""MAT files with objects: timeseries as Simulink writes them, and tables."""

import sys
import warnings

import numpy as np
import pandas as pd
import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis import Model, load_records
from bristle.records.formats.reading import read_columns

matio = pytest.importorskip("matio")
from matio.utils.matclass import MatlabOpaque  # noqa: E402  # after the check that it is there

N, H = 4000, 1e-3
T = H * np.arange(N)
EMPTY = np.zeros((0, 0))
VERSIONS = ("v7", "v7.3")


def series(data, time=None, unit="seconds"):
    """Return a timeseries; without a time, as start and interval."""
    own = {"Time_": EMPTY, "Start_": 0.0, "Increment_": H} if time is None else {}
    info = {"Units": unit, "Length": float(N), "Time_": time, "Start_": EMPTY} | own
    parts = {"Name": "", "Data_": data, "Time_": EMPTY}
    return MatlabOpaque(
        parts | {"TimeInfo": MatlabOpaque(info, "tsdata.timemetadata")}, "timeseries"
    )


def written(path, version, **values):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of durations in ns
        matio.save_to_mat(str(path), values, version=version)
    return path


@pytest.mark.parametrize("version", VERSIONS)
def test_a_timeseries_has_a_time_of_its_own(version, tmp_path):
    u, q = np.sin(T), np.cos(T)
    held = {"q": series(q.reshape(1, 1, -1), 1e3 * T[:, None], "milliseconds"), "k": 3.0}
    columns = read_columns(written(tmp_path / "r.mat", version, u=series(u[:, None]), out=held))
    assert set(columns) == {"u.Time", "u.Data", "out.q.Time", "out.q.Data", "out.k"}
    assert columns["u.Time"] == pytest.approx(T)
    assert columns["out.q.Time"] == pytest.approx(T)
    assert columns["u.Data"] == pytest.approx(u)
    assert columns["out.q.Data"] == pytest.approx(q)
    assert columns.times["out.q.Data"] == "out.q.Time"
    assert columns.units == {"u.Time": "s", "out.q.Time": "s"}


def test_two_channels_of_one_timeseries(tmp_path):
    both = np.stack([np.sin(T), np.cos(T)], axis=1)
    columns = read_columns(written(tmp_path / "r.mat", "v7", y=series(both)))
    assert columns["y.Data(:,2)"] == pytest.approx(np.cos(T))
    assert columns.times["y.Data(:,2)"] == "y.Time"


def test_a_record_of_timeseries_at_two_rates(tmp_path):
    slow = series(np.cos(T[::4]), T[::4])
    path = written(tmp_path / "r.mat", "v7", u=series(np.sin(T)), q=slow)
    tree = {
        "friction": "coulomb",
        "parameters": {"J": 0.01, "a2": 0.1, "Fc": 0.1},
        "time": {"column": "q.Time", "unit": "s"},
        "input": {"column": "u.Data", "kind": "torque", "unit": "N.m"},
        "output": {"column": "q.Data", "kind": "position", "unit": "rad"},
    }
    [record] = load_records(Model.from_dict(tree), [path])
    assert record.h == pytest.approx(4e-3)
    assert record.u == pytest.approx(np.sin(T[::4]))


@pytest.mark.parametrize("version", VERSIONS)
def test_a_timetable_has_its_time_in_seconds(version, tmp_path):
    table = pd.DataFrame({"u": np.sin(T)}, index=pd.to_timedelta(T, unit="s"))
    table.index.name = "Time"
    columns = read_columns(written(tmp_path / "r.mat", version, log=table))
    assert columns["log.u"] == pytest.approx(np.sin(T))
    assert columns["log.Time"] == pytest.approx(T)


def test_without_the_library_it_says_what_to_install(tmp_path, monkeypatch):
    path = written(tmp_path / "r.mat", "v7", u=series(np.sin(T)))
    monkeypatch.setitem(sys.modules, "matio", None)
    with pytest.raises(BristleError, match=r"needs mat-io; run: pip install 'bristle\[logs\]'"):
        read_columns(path)
