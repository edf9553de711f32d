"""Whole records in open loop: how they are cut, how far a model is from them, and a refit that only
helps where it is due.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from bristle.common.metrics import fit_percent, mse_percent, rms
from bristle.diagnosis import Model, Record, diagnose
from bristle.diagnosis.answer import Estimate
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.estimation.simulator import (
    Servo,
    fixed_values,
)
from bristle.diagnosis.estimation.uncertainty import refitted_estimates
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.validation.long_simulation import (
    GROWTH,
    Grown,
    Records,
    general_horizon,
    open_loop,
    open_loop_servo,
    refit_growing,
    stays,
    with_fitted_starts,
)
from bristle.diagnosis.validation.whole_records import _is_contradicted, _Long, _whole_records
from bristle.model.native import Native
from bristle.plant.servo import servo_program

H, SEGMENT = 1e-3, 0.4
TRUE = {"J": 0.01, "a2": 0.02, "b": 1.0, "coulomb.Fc": 0.12, "bias.torque": 0.01}
FREE = (
    Free("J", 0.002, 0.05),
    Free("a2", 0.0, 0.2),
    Free("coulomb.Fc", 0.0, 0.6),
    Free("bias.torque", -1.0, 1.0),
)
SERVO = Servo("coulomb", ("bias",), ("J", "a2", "coulomb.Fc"), FREE, fixed_values(H), True)


def record(
    seed: int, seconds: float = 8.0, drag: float = 0.0, load: float = 0.0, start: float = 0.3
) -> Record:
    """A servo with a bias that swings to and fro; `drag` [N.m.s2/rad2] is missing in `SERVO`,
    `load` [N.m] is a random torque.
    """
    t = 5.0 + H * np.arange(round(seconds / H))
    rng = np.random.default_rng(seed)
    u = sum(0.16 * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.3)) for f in (0.7, 1.3, 2.9, 4.3))
    program = servo_program("coulomb", encoder=False, effects=("bias", "quadratic_drag"))
    native = Native(
        program, TRUE | {"u_max": 1e6, "theta_start": start, "quadratic_drag.coefficient": drag}
    )
    noise = lfilter([1.0], [1.0, -0.94], rng.standard_normal(len(t)))
    out, _ = native.run(H, {"u": u, "tau_load": load * noise / np.std(noise)}, ["theta"])
    return Record(f"run {seed}", t, H, u, out[:-1, 0])


def records(*given: Record) -> Records:
    return Records(given, False, 1e-6, 1e-9)


def described() -> Model:
    return Model.from_dict(
        {
            "friction": "coulomb",
            "parameters": {"J": 0.01, "a2": 0.02, "Fc": 0.12},
            "time": {"column": "t", "unit": "s"},
            "input": {"column": "u", "kind": "torque", "unit": "N.m"},
            "output": {"column": "y", "kind": "position", "unit": "rad"},
        }
    )


# -- metrics ---------------------------------------------------------------------------------------
def test_metrics_of_a_sine_with_a_known_error():
    t = np.linspace(0, 2 * math.pi, 100_001)[:-1]
    measured, predicted = 3.0 * np.sin(t), 3.0 * np.sin(t) + 0.3 * np.cos(t) + 0.4
    # error 0.3 cos t plus 0.4: mean square 0.045 + 0.16, of which the variance sees 0.045; that of
    # the signal is 4.5
    assert rms(measured - predicted) == pytest.approx(math.sqrt(0.205))
    assert fit_percent(measured, predicted) == pytest.approx(100 * (1 - math.sqrt(0.205 / 4.5)))
    assert mse_percent(measured, predicted) == pytest.approx(1.0)
    assert fit_percent(measured, measured) == 100.0
    assert mse_percent(measured, measured) == 0.0
    assert mse_percent(measured, 0 * measured) == pytest.approx(100.0)


def test_metrics_that_cannot_be_given_are_not_numbers():
    still, failed = np.full(5, 2.0), np.array([1.0, math.nan, 2.0, 3.0, 4.0])
    assert math.isnan(fit_percent(still, still))
    assert math.isnan(fit_percent(np.arange(5.0), failed))
    assert math.isnan(rms(failed))
    assert math.isnan(rms(np.empty(0)))


# -- stretches -------------------------------------------------------------------------------------
def test_a_short_record_ends_where_it_ends_in_a_stretch_of_the_longest():
    s = records(record(1), record(2).part(slice(5003))).stretches(100.0)
    assert [piece.measured.shape[0] for piece in s.pieces] == [1, 1]
    assert s.seconds == pytest.approx(8.0)
    known = np.isfinite(s.pieces[1].measured[0])
    assert known.sum() == 5003 // s.width
    assert not known[known.sum() :].any()


def test_horizons_grow_to_the_longest_record():
    found = records(record(1)).horizons(SEGMENT)
    assert found == pytest.approx([GROWTH * SEGMENT, 8.0])


# -- open loop -------------------------------------------------------------------------------------
def test_the_right_model_stays_on_the_record_wherever_it_begins():
    loop = open_loop(
        open_loop_servo(SERVO), TRUE, records(record(1), record(2, 5.0, start=-2.0)), 100.0
    )
    assert [len(y) for y in loop.measured] == [8000, 5000]
    # the second record begins with a torque: its velocity there is known roughly
    assert loop.error < 1e-3


@pytest.mark.sampled(4)
def test_a_wrong_bias_drifts_and_more_so_over_longer_horizons():
    wrong, own = TRUE | {"bias.torque": 0.015}, records(record(1))
    errors = [
        open_loop(open_loop_servo(SERVO), wrong, own, seconds).error for seconds in (0.4, 1.6, 8.0)
    ]
    assert errors[2] > 3 * errors[1] > 9 * errors[0]


def test_the_start_of_a_drift_is_no_anchor():
    """The error of a constant offset is none: the position at the start of a record is fitted."""
    r = record(1)
    shifted = replace(r, y=r.y + np.where(np.arange(len(r)) < 40, 0.2, 0.0))
    loop = open_loop(open_loop_servo(SERVO), TRUE, records(shifted), 100.0)
    assert np.abs(loop.measured[0] - loop.simulated[0])[100:].mean() < 0.02


# -- refit -----------------------------------------------------------------------------------------
def test_a_refit_finds_what_makes_the_whole_record_drift():
    own, wrong = records(record(1)), TRUE | {"bias.torque": 0.013, "a2": 0.023, "coulomb.Fc": 0.11}
    grown = refit_growing(open_loop_servo(SERVO), wrong, own, SEGMENT)
    assert grown.whole
    assert stays(grown.fit)
    for f in grown.fit.free:
        assert grown.fit.values[f.name] == pytest.approx(TRUE[f.name], rel=0.01), f.name
    assert {f.name for f in grown.fit.free} == {f.name for f in FREE}


@pytest.mark.sampled(4)
def test_a_refit_ends_with_the_longest_horizon_that_held():
    """A pendulum that is driven over the top: how it goes on after that depends on every small
    push.
    """
    t = H * np.arange(40000)
    rng = np.random.default_rng(2)
    u = sum(0.3 * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.3)) for f in (0.7, 1.3, 2.9, 4.3))
    own = {"J": 0.01, "a2": 0.02, "b": 1.0, "coulomb.Fc": 0.02, "gravity.amplitude": 0.5}
    noise = lfilter([1.0], [1.0, -0.94], rng.standard_normal(len(t)))
    native = Native(
        servo_program("coulomb", encoder=False, effects=("gravity",)), own | {"u_max": 1e6}
    )
    out, _ = native.run(H, {"u": u, "tau_load": 0.05 * noise / np.std(noise)}, ["theta"])
    swung = records(Record("swung", t, H, u, out[:-1, 0]))
    servo = replace(
        SERVO, effects=("gravity",), free=(*FREE[:3], Free("gravity.amplitude", 0.0, 2.0))
    )
    grown = refit_growing(open_loop_servo(servo), own, swung, SEGMENT)
    assert GROWTH * SEGMENT <= grown.seconds <= GROWTH**3 * SEGMENT
    assert not grown.whole
    none = refit_growing(
        open_loop_servo(SERVO), TRUE | {"J": math.nan}, records(record(1)), SEGMENT
    )
    assert none.fit is None
    assert none.seconds == 0.0


def test_a_refit_is_kept_where_the_model_is_to_blame_for_the_drift_only():
    servo = open_loop_servo(SERVO)
    wrong = TRUE | {"a2": 0.024, "bias.torque": 0.012}
    assert general_horizon(servo, wrong, records(record(1), record(2)), SEGMENT) == math.inf
    # one record: one half predicts the other
    assert general_horizon(servo, wrong, records(record(1, 16.0)), SEGMENT) == math.inf
    noisy = records(record(1, load=0.01), record(2, load=0.01))
    assert general_horizon(servo, TRUE, noisy, SEGMENT) == 0.0


def test_intervals_hold_at_both_ends():
    model = described()
    own = records(record(1, load=0.003), record(2, load=0.003))
    fit = refit_growing(open_loop_servo(SERVO), TRUE, own, SEGMENT).fit
    first = {
        name: Estimate(2 * TRUE[name], "1", (1.9 * TRUE[name], 2.1 * TRUE[name]))
        for name in (f.name for f in FREE)
    }
    for name, e in refitted_estimates(model, fit, first).items():
        assert e.value == fit.values[name]
        low, high = e.ci95
        assert low < TRUE[name], name
        assert high == pytest.approx(2.1 * TRUE[name]), name


def test_starts_are_fitted_but_not_parameters():
    fit = with_fitted_starts(open_loop_servo(SERVO), TRUE, records(record(1)).stretches(8.0), 1e-9)
    assert fit.values == TRUE
    assert not fit.free


# -- the answer ------------------------------------------------------------------------------------
@pytest.mark.parametrize("refitted", [True, False])
def test_horizons_also_give_the_error_with_the_parameters_of_the_segments(refitted: bool) -> None:
    """Stand-ins for the models: errors of 3 before, 2 as the segments gave them, 1 refitted."""
    grown = SimpleNamespace(fit=object() if refitted else None, seconds=8.0, whole=True)

    def simulated(records: object, seconds: float, refitted: bool = True) -> SimpleNamespace:
        return SimpleNamespace(error=1.0 if refitted else 2.0, measured=(), simulated=())

    before = SimpleNamespace(simulated=lambda *_: SimpleNamespace(error=3.0, simulated=()))
    after = SimpleNamespace(grown=grown, simulated=simulated)
    records = SimpleNamespace(all=(), horizons=lambda segment: [2.0, 8.0])
    case = SimpleNamespace(
        dataset=SimpleNamespace(segments=SimpleNamespace(seconds=0.4)), records=()
    )
    found = _whole_records(case, records, before, after, {})
    usual = 2.0 if refitted else 1.0
    rows = [(h.seconds, h.before, h.segments, h.after) for h in found.horizons]
    assert rows == [(seconds, 3.0, usual, 1.0) for seconds in (0.4, 2.0, 8.0)]


@pytest.mark.long
def test_a_diagnosis_reports_whole_records(case):
    made = case("bias")
    found = diagnose(made.model, made.records)
    content = found.to_dict()
    assert [set(row) for row in content["open_loop"]] == [
        {"record", "unit", "rms_before", "rms_after", "fit_before", "fit_after"}
    ] * 2
    assert [row["record"] for row in content["open_loop"]] == ["run 1", "run 2"]
    for row in content["open_loop"]:
        assert row["unit"] == "rad"
        assert row["rms_after"] < 0.2 * row["rms_before"]
        assert row["fit_before"] < row["fit_after"] <= 100
    seconds = [each["seconds"] for each in content["whole_record"]["horizons"]]
    assert seconds == sorted(seconds)
    assert seconds[-1] == pytest.approx(8.0)
    last = content["whole_record"]["horizons"][-1]["after"]
    assert last == pytest.approx(
        math.sqrt(np.mean([row["rms_after"] ** 2 for row in content["open_loop"]]))
    )
    assert set(content["whole_record"]["segment_parameters"]) == {
        *content["parameters"],
        *(f"{e['name']}.{p}" for e in content["effects"] for p in e["parameters"]),
    }
    assert any("open loop" in line for line in found.statement)


@pytest.mark.parametrize(("inertia", "contradicted"), [(1.0, False), (1.3, True)])
def test_a_refit_that_the_motion_contradicts_is_not_kept(inertia: float, contradicted: bool):
    """Over whole records a disturbance may be followed by a wrong inertia."""
    model = replace(described(), effects={"bias": {"torque": 0.01}})
    dataset = dataset_of(model, [record(1, load=0.003), record(2, load=0.003)])
    servo, values = base_servo_of(model, dataset)
    case = SimpleNamespace(model=model, dataset=dataset, final=SimpleNamespace(servo=servo))
    refitted = SimpleNamespace(values={**values, "J": inertia * values["J"]})
    long = _Long(servo, values, Grown(1.6, False, refitted))
    assert _is_contradicted(case, long) == contradicted
