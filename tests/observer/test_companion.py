"""What estimates are worth: the least squares beside a method, and whether what it calls valid is
right.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.signal import lfilter

from bristle.fmus.interface import Interface
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.variables import State
from bristle.observer import methods, observer_program, rls, step1
from bristle.observer.companion import Companion, Row
from bristle.observer.method import LARGEST_SD, Method, Update, observer

SX = ca.SX
STEP = 1e-3
STEP1 = ("alpha2", "b", "Fc")
GRADIENT = ("luders_narendra", "luders_narendra_position", "marino", "bastin_gevers")
JUDGED = ("rls", "kreisselmeier", "kreisselmeier_position", *GRADIENT)

_FILE = Path(__file__).parents[2] / "benchmarks" / "conditions" / "condition_records.py"
_spec = importlib.util.spec_from_file_location("condition_records", _FILE)
conditions = importlib.util.module_from_spec(_spec)
sys.modules["condition_records"] = conditions  # its data classes look themselves up there
_spec.loader.exec_module(conditions)


# -- the fit alone, on numbers of the test ---------------------------------------------------------


def fitted(names, extra, alike=1.0, others=()):
    """Return a method whose sample is z = y_v, h = [u, 1] or [u, 1, u'], judged by a companion;
    estimates are its own.
    """
    companion = Companion(names, extra)

    def equations(context, s):
        p = context.p
        h = ca.vertcat(s.u, 1, *(other(s) for other in others))
        count = companion.count
        row = Row(s.y1, h[:count], h[count:], SX(1), SX(1), SX(alike))
        estimates = companion.narrow(p)
        sd = companion.deviations(p, estimates)
        limits = {name: SX(0.1) for name in estimates}
        return Update(
            companion.advance(p, row, SX(1), s.period),
            estimates,
            **companion.judge(p, sd, limits, SX(1)),
        )

    method = Method("fitted", "of a test", "none", "y_v", (), companion.states, equations)
    return Program("fitted", [observer(method)])


def fit(program, u, y, names=("alpha2", "b")):
    columns = [f"{name}_{what}" for what in ("hat", "sd", "valid") for name in names]
    out = Native(program, {"sample_time": STEP}).run(
        STEP, {"u": u, "y_v": y, "y_theta": np.zeros(len(u))}, columns
    )[0]
    return out[-1].reshape(3, len(names))


def test_the_fit_is_the_least_squares_and_white_noise_has_its_textbook_deviation():
    n, random = 20000, np.random.default_rng(1)
    u = random.standard_normal(n)
    y = np.r_[0.0, 2.0 * u[:-1] + 0.5] + random.standard_normal(n)
    hat, sd, valid = fit(fitted(("alpha2", "b"), 0), u, y)
    rows = np.column_stack([u[:-1], np.ones(n - 1)])
    best, left = np.linalg.lstsq(rows, y[1:], rcond=None)[:2]
    np.testing.assert_allclose(hat, best, rtol=1e-6)
    textbook = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)) * left[0] / (n - 3))
    assert np.all(sd > 0.5 * textbook)
    assert np.all(sd < 2.0 * textbook)
    assert np.all(valid == 1)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("pole", "least"), [(0.0, 0.9), (0.98, 0.85)], ids=["white", "coloured"])
def test_two_deviations_cover_the_truth(pole, least):
    """Also where errors are alike over 50 samples and nobody says so."""
    program, inside, n = fitted(("alpha2", "b"), 0), [], 30000
    for seed in range(40):
        random = np.random.default_rng(seed)
        u = lfilter([1.0], [1.0, -0.9], random.standard_normal(n))
        noise = lfilter([1.0], [1.0, -pole], random.standard_normal(n))
        hat, sd, _ = fit(program, u, np.r_[0.0, 2.0 * u[:-1] + 0.5] + noise)
        inside += list(np.abs(hat - (2.0, 0.5)) < 2 * sd)
    assert least <= np.mean(inside)
    assert np.mean(inside) < 1.0 or pole > 0


def test_what_a_method_does_not_model_is_in_its_deviation():
    """y = 2 u + 0.5 + 0.3 s with s like u: the narrow fit gives the 0.3 to u, and its deviation
    says so.
    """
    n, random = 20000, np.random.default_rng(3)
    u = random.standard_normal(n)
    y = np.r_[0.0, 2.0 * u[:-1] + 0.5 + 0.3 * np.abs(u[:-1])] + 0.1 * random.standard_normal(n)
    hat, sd, _ = fit(fitted(("alpha2", "b"), 1, others=(lambda s: ca.fabs(s.u),)), u, y)
    assert abs(hat[1] - 0.5) > 0.2
    assert abs(hat[1] - 0.5) < 2 * sd[1]
    _, blind, _ = fit(fitted(("alpha2", "b"), 0), u, y)
    assert blind[1] < 0.05


def test_equal_columns_are_not_known_however_good_the_data():
    n = 5000
    u = np.random.default_rng(4).standard_normal(n)
    hat, sd, valid = fit(
        fitted(("alpha2", "b", "Fc"), 0, others=(lambda s: s.u,)),
        u,
        np.r_[0.0, 2.0 * u[:-1] + 0.5],
        (*STEP1,),
    )
    assert sd[0] == sd[2] == pytest.approx(LARGEST_SD)
    assert hat[0] == pytest.approx(1.0, rel=1e-3)  # shared out, not blown up
    assert list(valid) == [0, 1, 0]


@pytest.mark.parametrize(
    ("cutoff", "period"), [(150.0, 1e-3), (60.0, 5e-3), (900.0, 1e-3), (20.0, 5e-4)]
)
def test_the_noise_of_rounding_is_that_of_rounded_positions(cutoff, period):
    step, random = 1e-3, np.random.default_rng(5)
    errors = random.uniform(-step / 2, step / 2, 400_000)
    gain = 1 - math.exp(-cutoff * period)
    section = [gain], [1, gain - 1]
    seen = lfilter(*section, lfilter(*section, np.diff(errors, 2) / period**2))[1000:]
    assert float(ca.evalf(rls.rounding_noise(SX(step), SX(cutoff), SX(period)))) == pytest.approx(
        np.var(seen), rel=0.02
    )


# -- the methods of step 1 under conditions of the study -------------------------------------------


@cache
def judged(method, name, plant="S", seconds=30.0):
    """Return (final estimates, sd, valid, adapted, truth) of a method under a condition; all it
    publishes must be finite.
    """
    condition = replace(conditions.CONDITIONS[name], seconds=seconds)
    data = conditions.record(condition, plant, 1)
    program = observer_program(method)
    values = {"sample_time": condition.period}
    if f"{method}.resolution" in program.index:
        values[f"{method}.resolution"] = 2 * math.pi / condition.counts
    outputs = [x.name for x in Interface(program).of("output")]
    out = Native(program, values).run(
        condition.period, {"u": data.u, "y_theta": data.y_theta, "y_v": data.y_v}, outputs
    )[0]
    assert np.all(np.isfinite(out))
    last, names = dict(zip(outputs, out[-1], strict=True)), (*STEP1, "load", "delay")
    hat, sd, valid = (
        {name: last[f"{name}_{what}"] for name in names} for what in ("hat", "sd", "valid")
    )
    return hat, sd, valid, last["adapted"], data.true


def off(found, names=STEP1):
    """Return the errors in % of what is valid."""
    hat, _, valid, _, true = found
    return {name: 100 * abs(hat[name] / true[name] - 1) for name in names if valid[name]}


CASES = [
    ("standard", "S"),
    ("standard", "R"),
    ("4096 counts", "S"),
    ("20 deg/s rms", "S"),
    ("5 deg/s rms", "R"),
    ("one direction", "S"),
    ("delay 1 samples", "R"),
    ("constant torque 50 %", "S"),
    ("coloured torque 5 %", "R"),
    ("load doubled", "S"),
    ("friction x20", "R"),
    ("LuGre v0 60 deg/s", "LuGre"),
    ("LuGre v0 120 deg/s", "LuGre"),
    ("J x0.1", "R"),
    ("b x-1", "S"),
]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", JUDGED)
def test_what_is_valid_is_right(method):
    wrong = {}
    for name, plant in CASES:
        wrong |= {
            (name, each): error
            for each, error in off(judged(method, name, plant)).items()
            if error > 10
        }
    assert len(wrong) <= 1, wrong  # of some 35 that are valid


@pytest.mark.parametrize("method", ["rls", "kreisselmeier", "kreisselmeier_position"])
@pytest.mark.parametrize(
    "name",
    [
        "standard",
        "noise 10 rad/s",
        "2 ms",
        "constant torque 25 %",
        "delay 1 samples",
        "1e+06 counts",
    ],
)
def test_good_records_make_everything_valid(method, name):
    found = judged(method, name)
    errors = off(found)
    assert set(errors) == set(STEP1)
    assert max(errors.values()) < 1.0


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", JUDGED)
def test_load_and_delay_are_found(method):
    for name in ("constant torque 10 %", "constant torque 50 %"):
        hat, _, valid, _, true = judged(method, name)
        assert valid["load"]
        assert abs(hat["load"] - true["load"]) < 0.01 * true["Fc"]
    assert judged(method, "delay 1 samples")[0]["delay"] == pytest.approx(1.0, abs=0.2)
    assert abs(judged(method, "standard")[0]["delay"]) < 0.2


@pytest.mark.parametrize("method", GRADIENT)
def test_a_law_that_lags_behind_has_its_lag_in_its_deviation(method):
    hat, sd, valid, _, true = judged(method, "noise 2 rad/s")
    assert abs(hat["Fc"] / true["Fc"] - 1) > 0.1
    assert abs(hat["Fc"] - true["Fc"]) < 2 * sd["Fc"]
    assert not valid["Fc"]


@pytest.mark.parametrize("method", JUDGED)
def test_one_direction_does_not_tell_friction_from_load(method):
    _, _, valid, adapted, _ = judged(method, "one direction")
    assert adapted
    assert not valid["Fc"]
    assert not valid["load"]


@pytest.mark.parametrize("method", JUDGED)
def test_a_gate_that_never_opened_has_adapted_nothing(method):
    condition = replace(conditions.CONDITIONS["standard"], seconds=20.0)
    data = conditions.record(condition, "S", 1)
    names = [*(f"{name}_{what}" for name in STEP1 for what in ("hat", "valid")), "adapted"]
    inputs = {"u": data.u, "y_theta": data.y_theta, "y_v": data.y_v}
    closed = Native(observer_program(method), {f"{method}.vc": 900.0}).run(STEP, inputs, names)[0]
    assert not closed.any()


@pytest.mark.parametrize("method", ["rls", "kreisselmeier"])
def test_friction_that_is_negative_for_sure_refutes_the_model(method):
    """A drive that adds 1 V s/rad of the speed to what the observer is told: the viscous friction
    then looks like -4.5 1/s.
    """
    condition = replace(conditions.CONDITIONS["standard"], seconds=30.0)
    data = conditions.record(condition, "S", 1)
    inputs = {"u": data.u - data.y_v, "y_theta": data.y_theta, "y_v": data.y_v}
    names = ["alpha2_hat", *(f"{name}_valid" for name in STEP1), "adapted"]
    out = Native(observer_program(method)).run(STEP, inputs, names)[0]
    assert out[-1, 0] < -3.0
    assert list(out[-1, 1:]) == [0, 0, 0, 1]


def test_the_gate_follows_the_motion():
    """In units a thousand times smaller, least squares finds the same; with the gate in given units
    it never adapts.
    """
    data = conditions.record(replace(conditions.CONDITIONS["standard"], seconds=20.0), "S", 1)
    inputs = {"u": data.u, "y_theta": 1e-3 * data.y_theta, "y_v": 1e-3 * data.y_v}
    names = ["alpha2_hat", "alpha2_valid", "adapted"]
    own = Native(observer_program("rls"), {"rls.resolution": 2e-3 * math.pi / 40000}).run(
        STEP, inputs, names
    )[0][-1]
    assert own[0] == pytest.approx(2.0, rel=0.02)
    assert list(own[1:]) == [1, 1]
    assert list(
        Native(observer_program("rls"), {"rls.vc": 1.5}).run(STEP, inputs, names)[0][-1]
    ) == [0, 0, 0]


def test_what_came_from_a_lower_gate_is_forgotten_as_the_gate_rises():
    """Ten seconds at 20 deg/s, where the Stribeck effect is strong, and then as usual."""
    slow = conditions.record(replace(conditions.CONDITIONS["20 deg/s rms"], seconds=10.0), "S", 1)
    fast = conditions.record(replace(conditions.CONDITIONS["standard"], seconds=30.0), "S", 1)
    joined = {
        "u": np.r_[slow.u, fast.u],
        "y_theta": np.r_[slow.y_theta - slow.y_theta[-1], fast.y_theta],
    }
    out = Native(observer_program("rls")).run(STEP, joined, ["Fc_hat", "rls.gate_reached"])[0]
    assert out[-1, 1] > 2.5 * out[9000, 1]
    assert out[-1, 0] == pytest.approx(4.0, rel=0.02)


# -- nothing but numbers comes out -----------------------------------------------------------------


def extremes():
    """Yield inputs that are no servo's, by name."""
    n = 3000
    k, random = np.arange(n), np.random.default_rng(6)
    everything = ("u", "y_theta", "y_v")
    yield {name: 1e300 * random.standard_normal(n) for name in everything}
    yield {name: np.where(k % 2, 1e300, -1e300) for name in everything}
    yield {name: np.full(n, 1e300) for name in everything}
    yield {name: 1e-300 * random.standard_normal(n) for name in everything}
    yield {
        "u": np.sin(0.01 * k),
        "y_theta": np.where(k > n // 2, 1e300, 1e-3 * k),
        "y_v": np.where(k == n // 2, -1e300, 1.0),
    }


@pytest.mark.sampled(11)
@pytest.mark.parametrize("method", sorted(methods()))
def test_no_output_is_ever_anything_but_a_number(method):
    program = observer_program(method)
    instance, outputs = Native(program), [x.name for x in Interface(program).of("output")]
    for inputs in extremes():
        instance.reset()
        assert np.all(np.isfinite(instance.run(STEP, inputs, outputs)[0]))


def test_two_companions_in_one_method_do_not_touch_each_other():
    first, second = Companion(("a",)), Companion(("a",), prefix="other_")
    assert not {state.name for state in first.states} & {state.name for state in second.states}
    assert len(step1.COMPANION.states) == len({state.name for state in step1.COMPANION.states})
    assert all(isinstance(state, State) for state in first.states)
