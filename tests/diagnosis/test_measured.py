"""The four measured data sets go through intake and plausibility; each test is skipped where its
data are absent.
"""

import importlib.util
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.diagnosis import Model, diagnose, records_from_arrays
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.checks.plausibility import check
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.estimation.fitted_model import fit_with_noise
from bristle.diagnosis.estimation.uncertainty import estimates, refitted_estimates
from bristle.diagnosis.free_parameter import free_parameters
from bristle.diagnosis.report.text.said import said
from bristle.diagnosis.validation.long_simulation import (
    Records,
    general_horizon,
    open_loop,
    open_loop_servo,
    refit_growing,
)

_PATH = Path(__file__).parents[2] / "benchmarks" / "measured" / "measured_data.py"
_spec = importlib.util.spec_from_file_location("measured", _PATH)
assert _spec is not None
assert _spec.loader is not None
measured = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(measured)


@pytest.fixture
def data():
    if not measured.MEASURED_FOLDER.is_dir():
        pytest.skip(f"no measured data: {measured.MEASURED_FOLDER} is not there (set BRISTLE_DATA)")
    return measured


def declared(kind, parameters, output="rad", **more):
    unit = {"torque": "N.m", "voltage": "V", "current": "A"}[kind]
    return Model.from_dict(
        {
            "friction": "coulomb",
            "parameters": parameters,
            "time": {"column": "t", "unit": "s"},
            "input": {"column": "u", "kind": kind, "unit": unit},
            "output": {"column": "y", "kind": "position", "unit": output},
            **more,
        }
    )


def taken(model, entries, sign=1.0):
    return records_from_arrays(model, [(name, t, sign * u, y) for name, t, u, y, _ in entries])


def worn_axis():
    return declared("voltage", {"J": 100.0, "a2": 150.0, "Fc": 30.0, "b": 35.1507}, "m")


def judged(model, entries, sign=1.0):
    records = taken(model, entries, sign)
    assert len({r.h for r in records}) == 1
    found = check(model, records)
    words = {"proposals": found.corrections, "findings": found.notes}
    texts = {key: tuple(map(said, value)) for key, value in words.items()}
    return records, SimpleNamespace(**texts, fit=found.fit)


def test_xl330(data):
    """Half a kilogram at 0.1 m: J is that of the mass and the rotor; the voltage moves it the right
    way.
    """
    entries = data.xl330()
    assert {e[4]["kp"] for e in entries} == {100, 200, 400, 800}
    assert max(float(np.max(np.abs(e[2]))) for e in entries) < 9.5
    model = declared("voltage", {"J": 0.0065, "a2": 0.03, "Fc": 0.04, "b": 0.08})
    records, found = judged(model, entries)
    assert found.proposals == ()
    assert found.fit["explained"] > 0.9
    assert all(
        r.resampled and r.resolution == pytest.approx(2 * np.pi / 4096, rel=1e-6) for r in records
    )
    assert any("scatter by" in line for line in records[0].findings)
    [line] = judged(model, entries, -1.0)[1].proposals
    assert "flipped" in line


def test_go1(data):
    """The torque demand is ahead of a gear of about 6: inertia comes out at a sixth of what mass
    and arm say.
    """
    for mass in (1.0, 2.0, 3.0):
        inertia = mass * 0.15**2 + 0.003
        entries = data.go1(mass)
        assert len(entries) == 3
        records, found = judged(
            declared("torque", {"J": inertia / 6, "a2": 0.01, "Fc": 0.02}), entries
        )
        assert found.proposals == ()
        assert all(r.findings == () for r in records if "7m50" not in r.name)
        tight = {"J": [0.6 * inertia, 1.6 * inertia], "a2": [0.0, 1.0], "Fc": [0.0, 1.0]}
        _, found = judged(
            declared("torque", {"J": inertia, "a2": 0.05, "Fc": 0.02}, bounds=tight), entries
        )
        assert any(line.startswith("J comes out near") for line in found.findings)


def test_emps(data):
    """The published least squares: M 95.1 kg, Fv 203.5 N.s/m, Fc 20.4 N."""
    model = worn_axis()
    [record], found = judged(model, data.emps())
    assert record.findings == ()
    assert record.resolution == pytest.approx(5e-8, rel=1e-6)
    assert found.proposals == ()
    for name, published in (("J", 95.1089), ("a2", 203.5034), ("Fc", 20.3935)):
        assert found.fit[name]["value"] == pytest.approx(published, rel=0.08)
    seen = excitation(model, [record]).numbers
    assert seen["duration"]["value"] == pytest.approx(24.84, rel=1e-3)
    assert seen["range_travelled"]["unit"] == "m"


@pytest.mark.parametrize("compensated", [False, True])
def test_odrive(compensated, data):
    """Slow turns in one direction at nearly one speed: the caveats say so."""
    entries = data.odrive(compensated)
    assert len(entries) == 3
    model = declared("current", {"J": 2.5e-4, "a2": 1e-5, "Fc": 0.005, "b": 0.0075})
    records, found = judged(model, entries)
    assert found.proposals == ()
    assert all(np.ptp(r.y) == pytest.approx(2 * np.pi * 0.95, rel=0.02) for r in records)
    caveats = excitation(model, records).caveats
    assert any("one direction" in said(line) for line in caveats)


def found(model, entries):
    """Classes of the effects that a diagnosis names or suspects."""
    return {effect.group for effect in diagnose(model, taken(model, entries)).found}


@pytest.mark.long
@pytest.mark.parametrize(
    ("compensated", "groups"),
    [
        pytest.param(
            False,
            [{"cogging"}],
            marks=pytest.mark.xfail(
                strict=True, reason="not identifiable, as benchmarks/results/measured.md says"
            ),
        ),
        (True, [set(), {"cogging"}]),
    ],
)
def test_the_cogging_of_a_motor_is_found_as_long_as_nothing_makes_up_for_it(
    compensated, groups, data
):
    """A light motor turned slowly: the model without cogging stops where the motor goes on."""
    model = declared("current", {"J": 2.5e-4, "a2": 1e-3, "Fc": 5e-3, "b": 7.5e-3})
    assert found(model, data.odrive(compensated)) in groups


@pytest.mark.long
def test_friction_by_direction_of_a_worn_axis_is_named_and_holds_over_the_whole_record(data):
    """An offset is the next best: with it twice the error is left on held-out segments, and the
    residual still follows velocity. What is left here is a slow tone. A refit to the whole
    record leaves 2.7 mm of it, but more of either half than the sliding motion of the other does.
    """
    found = diagnose(worn_axis(), taken(worn_axis(), data.emps()))
    assert {effect.group for effect in found.effects} == {"asymmetric_viscous"}
    assert found.gap.after < 0.5 * 1.52e-4**2
    assert found.remains.view in (None, "tone")
    [whole] = found.whole.records
    assert whole.rms_after < 4.2e-3


@pytest.mark.slow
def test_emps_over_the_whole_record(data):
    """With an offset as the only effect: what its authors and others found over the whole record,
    by halves too.
    """
    [entry] = data.emps()
    model = worn_axis()
    [record] = taken(model, [entry])
    dataset = dataset_of(model, [record])
    servo, values = base_servo_of(model, dataset)
    start = {"torque": 1.0}
    servo = replace(
        servo, effects=("bias",), free=(*servo.free, *free_parameters("bias", start, servo.limits))
    )
    fitted = fit_with_noise(dataset, servo, values | {"bias.torque": 1.0})
    own, plain, segment = (
        Records.of(dataset, [record], dataset.segments.times),
        open_loop_servo(servo),
        dataset.segments.seconds,
    )
    segments = open_loop(plain, fitted.fit.values, own, own.seconds).error
    assert general_horizon(plain, fitted.fit.values, own, segment) == math.inf
    grown = refit_growing(plain, fitted.fit.values, own, segment)
    assert grown.whole
    assert open_loop(plain, grown.fit.values, own, own.seconds).error < 2.7e-3 < 0.3 * segments
    assert 180.0 < grown.fit.values["a2"] < 205.0  # 235 over segments
    low, high = refitted_estimates(model, grown.fit, estimates(model, fitted.fit))[
        "bias.torque"
    ].ci95
    assert low < 3.38 < high
    for one, other in (own.halves(), own.halves()[::-1]):
        half = refit_growing(plain, fitted.fit.values, one, segment)
        assert open_loop(plain, half.fit.values, other, other.seconds).error < 4.5e-3
