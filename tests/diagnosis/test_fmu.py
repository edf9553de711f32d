"""A plant FMU as the model: the effect it lacks is named, one it has is not, and peculiarities of
the FMU are reported.
"""

from __future__ import annotations

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis import Model, diagnose_fmu, records_from_arrays
from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.fmus.playback import Replay, ReplaySegment, _Replayer, _whole, replay_records
from bristle.model.native import Native
from bristle.plant.servo import servo_program

SERVO = {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12, "b": 1.0, "u_max": 1e6}


@pytest.fixture
def records(measured, model):
    """Return what gives two records of a servo with an effect, or of one without."""

    def of(name=None):
        runs = {
            seed: measured(name, seed) if name else measured(seed=seed, plain=1) for seed in (1, 2)
        }
        return records_from_arrays(
            model,
            [(f"run {seed}", t[:8000], u[:8000], y[:8000]) for seed, (t, u, y, _) in runs.items()],
        )

    return of


def said(found, *words):
    assert any(all(word in line for word in words) for line in found.findings), found.findings


@pytest.mark.long
def test_what_the_fmu_lacks_is_named(model, records):
    fmu = obtain("plant", law="coulomb", parameters=SERVO)
    found = diagnose_fmu(fmu, model, records("gravity"))
    assert [e.name for e in found.effects] == ["gravity"]
    assert found.effects[0].parameters["amplitude"].value == pytest.approx(0.3, rel=0.03)
    assert found.gap.after < 0.01 * found.gap.before
    said(found, "for each of 40 segments")
    said(found, "a servo with coulomb friction follows")


@pytest.mark.long
def test_an_fmu_without_fault_agrees_though_the_servo_follows_it_no_closer_than_the_sensor_sees(
    model, measured
):
    native, rng = Native(servo_program("coulomb", encoder=False), SERVO), np.random.default_rng(1)
    runs = []
    for seed in (1, 2):
        t, u, *_ = (x[:8000] for x in measured(seed=seed, plain=1))
        theta = native.run(t[1], {"u": u}, ["theta"])[0][:-1, 0]
        runs.append((f"run {seed}", t, u, theta + 1e-4 * rng.standard_normal(len(t))))
    found = diagnose_fmu(
        obtain("plant", law="coulomb", parameters=SERVO), model, records_from_arrays(model, runs)
    )
    assert found.verdict == "none"
    assert "agrees with the records: rms" in found.statement[0]


@pytest.mark.long
def test_without_a_model_that_comes_near_the_fmu_nothing_is_named(model, records):
    fmu = obtain(
        "plant", law="coulomb", effects=("gravity",), parameters=SERVO | {"gravity.amplitude": 0.3}
    )
    found = diagnose_fmu(fmu, model, records("gravity"))
    assert found.verdict == "not_identifiable"
    assert "Give a MODEL.toml with the FMU's own friction law, effects" in found.statement[0]


@pytest.mark.long
def test_effects_of_the_fmu_are_not_named_and_its_wrong_parameter_is_reported(tree, records):
    model = Model.from_dict(tree | {"effects": {"gravity": {"amplitude": 0.3, "phase": 0.0}}})
    off = SERVO | {"coulomb.Fc": 0.09, "gravity.amplitude": 0.3}
    fmu = obtain("plant", law="coulomb", effects=("gravity",), parameters=off)
    found = diagnose_fmu(fmu, model, records("gravity"))
    assert found.verdict == "none"
    said(found, "coulomb.Fc", "25% too low")
    assert "agrees" not in found.statement[0]


@pytest.mark.usefixtures("few")
@pytest.mark.sampled(4)
def test_an_fmu_outside_the_bounds_of_the_model_is_followed_there(model, records):
    found = diagnose_fmu(
        obtain("plant", law="coulomb", parameters=SERVO | {"J": 0.15, "a2": 0.3}),
        model,
        records("gravity"),
    )
    assert [e.name for e in found.effects] == ["gravity"]
    assert found.model.parameters["J"] == pytest.approx(0.15, rel=0.01)


@pytest.mark.slow
@pytest.mark.usefixtures("few")
def test_an_input_in_another_unit_is_reported(model, records):
    found = diagnose_fmu(
        obtain("plant", law="coulomb", parameters=SERVO | {"b": 0.5}), model, records()
    )
    said(found, "is in V, that of the records in N.m", "given their numbers")


def test_an_output_that_is_no_number_is_reported_with_its_time(monkeypatch):
    shown = iter([[0.1]] * 30)
    monkeypatch.setattr(_Replayer, "_shown", lambda self: next(shown, [np.nan]))
    play = Replay(Fmu(obtain("plant", law="coulomb")), 0.1, (), ("theta",), {})
    with pytest.raises(
        BristleError, match=r"coulomb.*\.fmu: output theta is nan at 3 s, not a finite number"
    ):
        _whole((play, ReplaySegment(0.0, np.zeros(40), {})), np.zeros(2, dtype=np.int64))


def test_files_where_the_user_stands_are_not_taken_for_modules(monkeypatch, tmp_path):
    (tmp_path / "numpy.py").write_text("raise SystemExit('not numpy')")
    monkeypatch.chdir(tmp_path)
    stretch = ReplaySegment(0.0, np.zeros(5), {})
    assert (
        len(
            replay_records(
                Replay(Fmu(obtain("plant", law="coulomb")), 1e-3, (stretch,), ("theta",), {})
            ).outputs[0]
        )
        == 5
    )
