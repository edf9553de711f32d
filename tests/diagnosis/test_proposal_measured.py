"""What bristle init proposes from measured data; each test is skipped where its data are absent."""

import csv
import gzip
import json
import os
from pathlib import Path

import pytest

from bristle.diagnosis.init.proposal import propose
from bristle.diagnosis.report.proposed_model import write_model
from bristle.diagnosis.report.text.said import said

DATA = Path(os.environ.get("BRISTLE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
FORCE_PER_VOLT = 35.1507  # N/V, of the drive of EMPS
# of EMPS, by its authors' inverse dynamic model
PUBLISHED = {"J": 95.1089, "a2": 203.5034, "Fc": 20.3935}


@pytest.fixture
def data():
    if not DATA.is_dir():
        pytest.skip(f"no measured data: {DATA} is not there (set BRISTLE_DATA)")
    return DATA


def chosen(found):
    return [each.column.column for each in (found.time, found.input, found.output)]


def test_emps(data, tmp_path):
    """Names that say nothing: the reference qg, the position qm and the drive's voltage vir; the
    unit alone is given.
    """
    found = propose(data / "emps" / "DATA_EMPS.mat", units={"qm": "m", "qg": "m"})
    assert chosen(found) == ["t", "vir", "qm"]
    assert (found.input.kind, found.output.kind) == ("voltage", "position")
    for name, value in PUBLISHED.items():
        assert found.rough[name].value * FORCE_PER_VOLT == pytest.approx(value, rel=0.1)
    assert any(
        "2 columns may be the output: 'qm' is taken" in line
        for line in [said(each) for each in found.doubts]
    )
    write_model(found, tmp_path / "model.toml")


def test_emps_without_any_hint(data):
    assert chosen(propose(data / "emps" / "DATA_EMPS.mat")) == ["t", "vir", "qm"]


def test_a_speed_without_its_sign(data):
    found = propose(sorted((data / "ced").glob("record[12].csv")))
    assert chosen(found) == ["t", "u", "speed"]
    assert found.input.column.scale is None
    assert any(
        "was the speed measured without its sign?" in line
        for line in [said(each) for each in found.doubts]
    )
    assert any(
        "explain only 1% of the input" in line for line in [said(each) for each in found.doubts]
    )


def test_one_direction_of_motion(data):
    """Cogging and the drive that opposes it look like a negative inertia; the sign of the input is
    right for all that.
    """
    found = propose(sorted((data / "laas_cogging").glob("*.csv")))
    assert chosen(found) == ["t", "u", "y"]
    assert found.input.column.scale is None
    assert "nearly always in one direction" in " ".join(map(said, found.excited.caveats))


@pytest.mark.parametrize(
    ("folder", "columns"),
    [
        ("bam_go1_load", ["timestamp", "torque_demand", "position"]),
        ("bam_xl330_gain", ["timestamp", "load", "position"]),
    ],
)
def test_pendulums(folder, columns, data, tmp_path):
    paths = []
    for source in sorted((data / folder).glob("*.gz"))[:2]:
        entries = json.loads(gzip.decompress(source.read_bytes()))["entries"]
        paths.append(tmp_path / f"{source.name[:-8]}.csv")
        with paths[-1].open("w", newline="") as stream:
            writer = csv.DictWriter(stream, list(entries[0]))
            writer.writeheader()
            writer.writerows(entries)
    found = propose(paths)
    assert chosen(found) == columns
    write_model(found, tmp_path / "model.toml")


def test_arrays_without_names(data):
    found = propose(sorted((data / "odrive_cogging" / "slow2").glob("nocomp_[01].npy")))
    assert chosen(found) == ["array[:, 0]", "array[:, 2]", "array[:, 1]"]
    assert "no column is called a time; 'array[:, 0]' rises evenly" in [
        said(each) for each in found.doubts
    ]


def test_a_swing_up_shows_its_inertia_beside_gravity(data):
    """Of a pendulum that its drive cannot lift: .18 kg.m2 by a regression with gravity; without it,
    or on an acceleration with noise in it, half of that.
    """
    swung = data / "dfki_pendulum" / "ddp.csv"
    units = {"time": "s", "position": "rad", "torque": "N.m"}
    found = propose(swung, {"output": "position"}, units)
    assert found.rough["J"].value == pytest.approx(0.18, rel=0.3)
    doubts = [said(each) for each in found.doubts]
    assert any("such as gravity or a spring, 97%" in line for line in doubts)
