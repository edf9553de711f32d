"""Measured records: what is read, and one line for every record that cannot be used."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bristle.harness.record import read_record
from bristle.harness.scenario import Column, Record

Message = Callable[[Callable[[], object]], str]

TIME = np.arange(200) * 2e-3
THETA = np.sin(5 * TIME)
V = 5 * np.cos(5 * TIME)
U = 2 * np.cos(3 * TIME)


def declared(
    file: str, *, theta: bool = True, v: bool = False, unit: str = "rad", scale: str | None = None, time_unit: str = "s"
) -> Record:
    return Record(
        file=file,
        time=Column(column="t", unit=time_unit),
        u=Column(column="volt", unit="V"),
        theta=Column(column="pos", unit=unit, scale=scale) if theta else None,
        v=Column(column="speed", unit="rad/s") if v else None,
    )


def write_csv(path: Path, header: str = "t,volt,pos,speed", **changed: np.ndarray) -> Path:
    columns = {"t": TIME, "volt": U, "pos": THETA, "speed": V, **changed}
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=header, comments="", fmt="%.17g")
    return path


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".mat"])
def test_formats_give_the_same_numbers(suffix: str, tmp_path: Path) -> None:
    from scipy.io import savemat

    path = tmp_path / f"record{suffix}"
    columns = {"t": TIME, "volt": U, "pos": THETA, "speed": V}
    if suffix == ".csv":
        write_csv(path)
    elif suffix == ".npz":
        np.savez(path, **columns)
    else:
        savemat(path, {name: values[:, None] for name, values in columns.items()} | {"gain": 3.0})
    samples = read_record(path, declared(path.name, v=True))
    assert samples.h == pytest.approx(2e-3)
    for have, want in ((samples.u, U), (samples.theta, THETA), (samples.v, V)):
        assert np.array_equal(have, want)


def test_units_are_converted(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "r.csv", t=TIME * 1000, pos=np.degrees(THETA))
    samples = read_record(path, declared("r.csv", unit="deg", time_unit="ms"))
    assert samples.h == pytest.approx(2e-3)
    assert np.allclose(samples.theta, THETA, rtol=0, atol=1e-14)


def test_a_scale_turns_metres_into_radians(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "r.csv", pos=THETA * 0.05)
    assert np.allclose(read_record(path, declared("r.csv", unit="m", scale="20 rad/m")).theta, THETA)


def test_what_is_not_measured_follows_from_what_is(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "r.csv")
    from_theta = read_record(path, declared("r.csv"))
    assert from_theta.measured == ("theta",)
    assert np.allclose(from_theta.v[1:], np.diff(THETA) / 2e-3)
    from_v = read_record(path, declared("r.csv", theta=False, v=True))
    assert np.allclose(from_v.theta, THETA - THETA[0], atol=1e-4)


def mend(values: np.ndarray, index: int, value: float) -> np.ndarray:
    out = values.copy()
    out[index] = value
    return out


def test_every_bad_record_is_one_line(tmp_path: Path, message: Message) -> None:
    gap = TIME.copy()
    gap[100:] += 0.01
    cases = [
        (write_csv(tmp_path / "gap.csv", t=gap), {}, ["not uniform", "after sample 99", "resample"]),
        (write_csv(tmp_path / "back.csv", t=mend(TIME, 50, 0.0)), {}, ["does not increase at sample 50"]),
        (write_csv(tmp_path / "nan.csv", volt=mend(U, 7, np.nan)), {}, ["sample 7", "volt", "not finite"]),
        (write_csv(tmp_path / "unit.csv"), {"unit": "m"}, ["theta", "unit 'm' does not fit", "scale"]),
        (write_csv(tmp_path / "name.csv", "t,volts,pos,speed"), {}, ["no column 'volt'", "did you mean 'volts'"]),
        (write_csv(tmp_path / "none.csv", "0,1,2,3"), {}, ["first line holds numbers"]),
        (tmp_path / "nowhere.csv", {}, ["No such file"]),
        (tmp_path / "record.xlsx", {}, ["unknown format", ".csv", ".mat", ".npz"]),
    ]
    broken = tmp_path / "broken.mat"
    broken.write_bytes(
        b"not a mat file at all, only some words that are long enough to look at, and then some more of them here, and more"
    )
    ragged = tmp_path / "ragged.csv"
    ragged.write_text("t,volt,pos,speed\n0,1,2,3\n0.1,1,2\n")
    words = tmp_path / "words.csv"
    words.write_text("t,volt,pos,speed\n0,1,2,fast\n0.1,1,2,slow\n")
    short = tmp_path / "short.csv"
    short.write_text("t,volt,pos,speed\n0,1,2,3\n0.1,1,2,3\n")
    cases += [
        (broken, {}, ["cannot be read"]),
        (ragged, {}, ["line 3 has 3 values"]),
        (words, {}, ["fast"]),
        (short, {}, ["2 samples"]),
    ]
    for path, options, expected in cases:
        line = message(lambda path=path, options=options: read_record(path, declared(path.name, **options)))
        assert str(path) in line
        for word in expected:
            assert word in line, line


def test_rls_on_the_emps_record(tmp_path: Path) -> None:
    """The published least-squares model of this axis: M 95.1 kg, Fv 203.5 N.s/m, Fc 20.4 N, 35.15 N/V."""
    from bristle.harness.run import run

    folder = Path(os.environ.get("BRISTLE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
    record = folder / "emps" / "DATA_EMPS.mat"
    if not record.exists():
        pytest.skip(f"no measured data: {record} is not there (set BRISTLE_DATA)")
    path = tmp_path / "emps.toml"
    path.write_text(f"""
[record]
file = {str(record)!r}
time = {{ column = "t", unit = "s" }}
u = {{ column = "vir", unit = "V" }}
theta = {{ column = "qm", unit = "m", scale = "1 rad/m" }}
[observer]
method = "rls"
[observer.parameters]
rls.vc = "0.02 rad/s"
[[checks]]
quantity = "estimates.b.final"
min = {0.9 * 35.1507 / 95.1089}
max = {1.1 * 35.1507 / 95.1089}
""")
    done = run(path, tmp_path / "out")
    assert done.passed
    assert done.result["steps"] == 24840
    assert done.result["estimates"]["alpha2"]["final"] == pytest.approx(203.5034 / 95.1089, rel=0.15)
    assert done.result["estimates"]["Fc"]["final"] == pytest.approx(20.3935 / 95.1089, rel=0.15)
    assert done.result["estimates"]["b"]["true"] is None
