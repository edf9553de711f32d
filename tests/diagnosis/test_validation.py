"""A model or an FMU over whole records: the same errors by both, files that hold them, and an FMU
that cannot do it says so.
"""

from __future__ import annotations

import hashlib
import json
import math
import zipfile
from dataclasses import replace

import numpy as np
import pytest

import bristle
from bristle.common.errors import BristleError
from bristle.common.provenance import provenance_of
from bristle.diagnosis import Model, Record, validate, validate_fmu
from bristle.diagnosis.report.validation_page import (
    VALIDATION_FILES,
    render,
    sentences,
    write_validation,
)
from bristle.fmus import obtain
from bristle.model.native import Native
from bristle.plant.servo import servo_program

H = 1e-3
TREE = {
    "friction": "coulomb",
    "parameters": {"J": 0.01, "a2": 0.02, "Fc": 0.12, "b": 0.5},
    "effects": {"bias": {"torque": 0.01}},
    "time": {"column": "t", "unit": "s"},
    "input": {"column": "u", "kind": "voltage", "unit": "V"},
    "output": {"column": "theta", "kind": "position", "unit": "rad"},
}


def model(**parameters: float) -> Model:
    return Model.from_dict(TREE | {"parameters": TREE["parameters"] | parameters})


def record(seed: int, seconds: float = 4.0, start: float = 0.4) -> Record:
    t = 2.0 + H * np.arange(round(seconds / H))
    rng = np.random.default_rng(seed)
    u = sum(
        0.3 * np.sin(2 * np.pi * f * (t - 2.0)) * rng.uniform(0.6, 1.4)
        for f in (0.7, 1.3, 2.9, 4.3)
    )
    given = model().settings() | {"theta_start": start}
    out, _ = Native(servo_program("coulomb", encoder=False, effects=("bias",)), given).run(
        H, {"u": u}, ["theta"]
    )
    return Record(f"run {seed}", t, H, u, out[:-1, 0], resolution=1e-6)


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return [record(1), record(2, 2.5, -3.0)]


@pytest.fixture(scope="module")
def plant():
    return obtain("plant", law="coulomb", effects=("bias",), parameters=model().settings())


@pytest.mark.sampled(4)
def test_the_right_model_has_no_error_on_any_horizon(records):
    found = validate(model(), records)
    assert [r.name for r in found.records] == ["run 1", "run 2"]
    shown = found._repr_html_()
    assert all(f"<td>{name}</td>" in shown for name in ("run 1", "run 2"))
    assert shown.count("<tr>") == 3
    for r in found.records:
        assert r.rms < 1e-3
        assert 99.9 < r.fit_percent <= 100.0
        assert 0.0 <= r.mse_percent < 1e-3
        assert [s for s, _ in r.horizons] == pytest.approx(
            [0.4, 1.6, 4.0] if r.name == "run 1" else [0.4, 1.6, 2.5]
        )
        assert r.horizons[-1][1] == r.rms


def test_a_start_fitted_to_the_first_samples_knows_nothing_of_what_follows(records):
    [first, _] = records
    # what comes after moves the start that is fitted to all, and no other
    later = first.y + np.where(np.arange(len(first.y)) < 200, 0.0, 0.3)
    [found] = validate(model(), [replace(first, y=later)], 50).records
    after = found.after_start
    assert after.samples == 50
    assert abs(after.rms - 0.3 * math.sqrt(1 - 150 / (len(later) - 50))) < 0.02
    assert found.rms < 0.95 * after.rms


@pytest.mark.sampled(2)
@pytest.mark.parametrize("samples", [3, 50])
def test_the_right_model_has_no_error_from_its_first_samples_either(records, plant, samples):
    for found in (
        validate(model(), records, samples),
        validate_fmu(plant, model(), records, start_samples=samples),
    ):
        for r in found.records:
            assert r.after_start.rms < (0.05 if samples == 3 else 5e-3)
            assert f"first {samples} samples alone" in sentences(found)[0]
            assert found.to_dict()["records"][0]["after_start"]["samples"] == samples
    assert validate(model(), records).to_dict()["records"][0].get("after_start") is None


@pytest.mark.parametrize("samples", [2, 1251, -1])
def test_too_few_or_too_many_first_samples_are_refused(records, samples):
    with pytest.raises(BristleError, match=f"{samples} start samples: allowed are 3 to 1250"):
        validate(model(), records, samples)


def test_velocities_are_compared_as_they_are(records):
    moved = record(1)
    program = servo_program("coulomb", encoder=False, effects=("bias",))
    v = Native(program, model().settings()).run(H, {"u": moved.u}, ["v"])[0][:-1, 0]
    fast = Model.from_dict(TREE | {"output": {"column": "v", "kind": "velocity", "unit": "rad/s"}})
    [found] = validate(fast, [Record("run", moved.time, H, moved.u, v, resolution=1e-6)]).records
    assert found.unit == "rad/s"
    assert found.fit_percent > 99.5


def test_the_errors_of_a_wrong_model_are_those_of_its_simulation(records):
    """The run of the plain servo from the true start is the reference; the fit of the start may
    only improve on it.
    """
    wrong = model(Fc=0.1)
    [found] = validate(wrong, records[:1]).records
    given = wrong.settings() | {"theta_start": 0.4}
    program = servo_program("coulomb", encoder=False, effects=("bias",))
    y = Native(program, given).run(H, {"u": records[0].u}, ["theta"])[0][:-1, 0]
    error = records[0].y - y
    assert 0.9 * np.std(error) < found.rms < np.sqrt(np.mean(error**2))
    assert found.fit_percent == pytest.approx(100 * (1 - found.rms / np.std(records[0].y)))
    assert found.mse_percent == pytest.approx(
        100 * np.var(found.measured - found.simulated) / np.var(records[0].y)
    )


@pytest.mark.long
def test_an_fmu_has_the_errors_of_the_model_it_was_made_from(records):
    """Both wrong by the same friction: measured was a servo with more of it."""
    wrong = obtain("plant", law="coulomb", effects=("bias",), parameters=model(Fc=0.1).settings())
    by_fmu = validate_fmu(wrong, model(), records[:1])
    [ours], [own] = by_fmu.records, validate(model(Fc=0.1), records[:1]).records
    assert by_fmu.findings == ()
    assert ours.rms == pytest.approx(own.rms, rel=0.02)
    assert [s for s, _ in ours.horizons] == [s for s, _ in own.horizons]


@pytest.mark.sampled(4)
def test_an_fmu_without_start_values_is_compared_over_whole_records(records, plant, tmp_path):
    hidden = tmp_path / "hidden.fmu"
    with zipfile.ZipFile(plant) as old, zipfile.ZipFile(hidden, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                data = data.replace(b'name="theta_start"', b'name="begin"').replace(
                    b'name="v_start"', b'name="speed"'
                )
            new.writestr(name, data)
    found = validate_fmu(hidden, model(), records)
    assert "cannot be started from a measured state" in found.findings[0]
    for r in found.records:  # it starts at 0, and is moved onto the record
        assert [s for s, _ in r.horizons] == pytest.approx([4.0] if r.name == "run 1" else [2.5])
        assert r.rms < 1e-3


def test_model_file_and_fmu_are_known_by_their_hashes(tmp_path):
    model_file, fmu = tmp_path / "m.toml", tmp_path / "p.fmu"
    model_file.write_bytes(b"m")
    fmu.write_bytes(b"p")
    found = provenance_of(model_file, [], "bristle validate", fmu)
    assert found["model_sha256"] == hashlib.sha256(b"m").hexdigest()
    assert found["fmu_sha256"] == hashlib.sha256(b"p").hexdigest()
    assert "fmu_sha256" not in provenance_of(model_file, [])


def test_the_files_hold_the_result(records, tmp_path):
    found = validate(model(), records)
    source = tmp_path / "a.csv"
    source.write_text("t,u,theta\n", encoding="utf-8")
    written = write_validation(
        found, tmp_path / "out", provenance_of(None, [source], "bristle validate")
    )
    assert [path.name for path in written] == list(VALIDATION_FILES)
    content = json.loads(written[0].read_text(encoding="utf-8"))
    assert set(content["records"][0]) == {
        "name",
        "unit",
        "rms",
        "fit_percent",
        "mse_percent",
        "horizons",
    }
    assert content["records"][1]["horizons"][-1] == [2.5, content["records"][1]["rms"]]
    assert {"version", "date", "platform", "records_sha256", "command"} <= set(
        content["provenance"]
    )
    page = written[1].read_text(encoding="utf-8")
    assert page.count("<img") == 4  # the record and the error against the horizon, of two records
    assert "run 2" in page


def test_a_simulation_that_fails_is_null_and_said_so(records):
    [good, _] = validate(model(), records).records
    failed = validate(model(), records[:1])
    nothing = np.full(len(good.time), math.nan)
    row = type(good)(
        "run",
        "rad",
        math.nan,
        math.nan,
        math.nan,
        ((4.0, math.nan),),
        good.time,
        good.input,
        good.measured,
        nothing,
    )
    bad = type(failed)("model.toml", "position", (row,))
    assert bad.to_dict()["records"][0]["rms"] is None
    assert "the simulation fails" in render(bad, {})


def test_a_model_file_and_records_in_one_call(tmp_path, records):
    lines = "\n".join(
        f"{t!r},{u!r},{y!r}"
        for t, u, y in zip(
            *(x.tolist() for x in (records[0].time, records[0].u, records[0].y)), strict=True
        )
    )
    (tmp_path / "a.csv").write_text(f"t,u,theta\n{lines}\n", encoding="utf-8")
    found = bristle.validate(model(), tmp_path / "a.csv", tmp_path / "out")
    assert found.records[0].rms < 1e-3
    assert (tmp_path / "out" / "report.html").is_file()
    with pytest.raises(BristleError, match="would be replaced"):
        bristle.validate(model(), tmp_path / "out" / "validation.json", tmp_path / "out")


@pytest.mark.slow
def test_an_fmu_with_names_and_units_of_its_own_has_the_same_errors(records, plant, tmp_path):
    """The same FMU, its variables renamed and declared in other units: here in the units that its
    numbers are not in.
    """
    renamed = tmp_path / "mine.fmu"
    with zipfile.ZipFile(plant) as old, zipfile.ZipFile(renamed, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                for word, other in ((b'"u"', b'"voltage"'), (b'"theta"', b'"pos"')):
                    data = data.replace(b"name=" + word, b"name=" + other)
            new.writestr(name, data)
    with pytest.raises(BristleError, match=r"no real input 'u' .*\[variables\] u = "):
        validate_fmu(renamed, model(), records)
    named = replace(model(), variables={"u": "voltage", "theta": {"name": "pos"}})
    expected, found = validate_fmu(plant, model(), records), validate_fmu(renamed, named, records)
    assert [r.rms for r in found.records] == pytest.approx(
        [r.rms for r in expected.records], rel=1e-9
    )
    scaled = replace(named, variables={"u": "voltage", "theta": {"name": "pos", "scale": 2.0}})
    assert validate_fmu(renamed, scaled, records).records[0].rms > 2 * expected.records[0].rms
    with pytest.raises(BristleError, match=r"variables\.uu: .*did you mean 'u'"):
        validate_fmu(renamed, replace(model(), variables={"uu": "voltage"}), records)


@pytest.mark.sampled(4)
def test_an_event_counts_time_over_records_that_each_begin_anew(records):
    """A step at the beginning of the second record; the same records by one clock need no such
    order.
    """
    given = TREE | {"effects": {"disturbance_step": {"torque": 0.05, "onset": 6.0, "rise": 1e-3}}}
    t = H * np.arange(4000)
    runs = []
    for name, seed, torque in (("before", 1, 0.0), ("after", 2, 0.05)):
        rng = np.random.default_rng(seed)
        u = sum(
            0.3 * np.sin(2 * np.pi * f * t) * rng.uniform(0.6, 1.4) for f in (0.7, 1.3, 2.9, 4.3)
        )
        values = Model.from_dict(TREE).settings() | {"bias.torque": torque}
        out, _ = Native(servo_program("coulomb", encoder=False, effects=("bias",)), values).run(
            H, {"u": u}, ["theta"]
        )
        runs.append(Record(name, 2.0 + t, H, u, out[:-1, 0], resolution=1e-6))
    found = validate(Model.from_dict(given), runs)
    assert [r.rms < 1e-2 for r in found.records] == [True, True]
    assert found.findings[0].endswith(
        "by the time over the records one after the other, in the order given: before, after"
    )
    assert [r.rms < 1e-2 for r in validate(Model.from_dict(given), runs[::-1]).records] == [
        False,
        False,
    ]
    one_clock = [runs[0], replace(runs[1], time=runs[1].time + 4.0)]
    again = validate(Model.from_dict(given), one_clock)
    assert [r.rms < 1e-2 for r in again.records] == [True, True]
    assert again.findings == ()
    drifting = Model.from_dict(TREE | {"effects": {"friction_drift": {"rate": 0.01}}})
    assert (
        validate(drifting, runs).findings[0]
        == "friction_drift begins anew in each record, since each has a clock of its own"
    )
