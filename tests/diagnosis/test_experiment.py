"""The input that tells rivals apart: within the limits of the records, and as far as it is expected
to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from bristle.diagnosis.answer import DesignedInput, Diagnosis
from bristle.diagnosis.estimation.dataset import cut
from bristle.diagnosis.estimation.likelihood import Problem, evaluate
from bristle.diagnosis.experiment.design import MARGIN, _Design, _headings
from bristle.diagnosis.experiment.discrimination import (
    Response,
    Rival,
    Setup,
    disturbance,
    lead,
)
from bristle.diagnosis.experiment.inputs import Axis, Input, Limits, inputs, move, varied
from bristle.diagnosis.experiment.references import references
from bristle.diagnosis.free_parameter import Free, free_parameters
from bristle.diagnosis.report.export import write
from bristle.diagnosis.report.text.designed import designed_line
from bristle.diagnosis.sliding.fit import SlidingFit, SlidingModel, fit_sliding
from bristle.diagnosis.sliding.loop import Loop, loop_of
from bristle.diagnosis.sliding.stretches import stretches_of

H = 1e-3
SAMPLES = 8000
LIMITS = Limits((-0.5, 0.5), (-2.0, 2.0), 0.3)
AXIS = Axis(0.01, 0.02, 0.12, 1.0)


def rival(case: Any, name: str, **own: float) -> Rival:
    """Return a rival with an effect of given parameters, all else as in the base fit of a case."""
    base = case.base
    values = base.fit.values | {f"{name}.{key}": x for key, x in own.items()}
    free = (*base.servo.free, *free_parameters(name, own, {}))
    point = replace(
        base.fit.at(values=values).fixed(),
        simulator=base.servo.simulator(case.dataset.segments, (name,)),
        free=free,
    )
    return Rival(name, evaluate(base.problem, point))


def responded(each: Rival, u: np.ndarray, setup: Setup) -> Response:
    """Return the response of a rival that can be simulated."""
    found = each.response(u, setup)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def setup(case: Callable[..., Any]) -> Setup:
    """Records as those of the case of a bias."""
    dataset = case("bias").dataset
    return Setup(dataset.segments, dataset.resolution, 0.0, 50.0)


def sines(size: float) -> np.ndarray:
    """An input that moves the servo to and fro."""
    t = H * np.arange(SAMPLES)
    return size * (np.sin(2 * np.pi * 0.7 * t) + 0.7 * np.sin(2 * np.pi * 4.3 * t))


def test_a_step_goes_where_it_is_to_go_within_speed_and_acceleration() -> None:
    path = move(-1.5, 3.0, 20.0, H)
    v = np.gradient(path, H)
    assert path[-1] == pytest.approx(-1.5)
    assert np.abs(v).max() <= 3.0 * 1.001
    assert np.abs(np.gradient(v, H)).max() <= 20.0 * 1.02
    assert len(move(-1.5, 300.0, 20.0, H)) < len(path)


def test_inputs_are_the_same_each_time_and_begin_each_step_where_the_last_one_ended() -> None:
    asked = []

    def follow(at: float, u: np.ndarray) -> float:
        asked.append(at)
        return at + 0.3  # a servo that drifts: steps must lead back

    first, again = (inputs(AXIS, LIMITS, [sines(0.2)], (SAMPLES, H), follow) for _ in range(2))
    assert all(
        np.array_equal(a, b)
        for x, y in zip(first, again, strict=True)
        for a, b in zip(x.scaled, y.scaled, strict=True)
    )
    assert all(len(u) == SAMPLES for each in first for u in each.scaled)
    assert 0.3 in asked


def test_a_varied_input_shows_many_tones_where_the_recorded_one_has_one() -> None:
    t = H * np.arange(2 * SAMPLES)
    u = 0.2 * np.sin(2 * np.pi * 1.5 * t)
    other = varied(np.random.default_rng(0), u, len(u), H)
    assert len(other) == len(u)
    assert np.abs(other).max() <= np.abs(u).max()
    shares = [
        np.sort(power)[::-1][:8].sum() / power.sum()
        for power in (np.abs(np.fft.rfft(each)) ** 2 for each in (u, other))
    ]
    assert shares[0] > 0.99
    assert shares[1] < 0.5


def test_limits_are_those_of_input_rms_and_position() -> None:
    assert LIMITS.allow_input(np.array([0.4, -0.1, 0.0, 0.0]))
    assert not LIMITS.allow_input(np.array([0.51, 0.0, 0.0, 0.0]))
    assert not LIMITS.allow_input(np.array([0.4, -0.4, 0.4, -0.4]))  # its rms
    assert LIMITS.allow_motion(np.array([-1.7, 1.7]), 0.05)
    assert not LIMITS.allow_motion(np.array([-1.7, 1.9]), 0.05)


@pytest.mark.sampled(4)
def test_a_model_does_not_lead_itself_and_a_lag_shows_in_fast_inputs(
    case: Callable[..., Any], setup: Setup
) -> None:
    bias, late = (
        rival(case("bias"), "bias", torque=0.05),
        rival(case("bias"), "input_delay", delay=0.01),
    )
    leads = {}
    for size in (0.0, 0.3):
        u = sines(size)
        of = {each.name: responded(each, u, setup) for each in (bias, late)}
        leads[size] = lead(of["bias"], bias, setup), lead(of["input_delay"], bias, setup)
    assert leads[0.3][0] < 3.0  # bristles begin each segment at rest
    assert leads[0.0][1] < 3.0 < 30.0 < leads[0.3][1]


def test_the_lead_is_about_what_a_record_then_gives(case: Callable[..., Any], setup: Setup) -> None:
    """Against the likelihoods of both models, the wrong one refitted to nothing, on a simulated
    record with its disturbance.
    """
    truth, other = (
        rival(case("bias"), "bias", torque=0.05),
        rival(case("bias"), "input_delay", delay=0.01),
    )
    u, fit = sines(0.25), truth.fit
    added = disturbance(len(u), fit.noise, 1.0, H, np.random.default_rng(3))
    y = responded(truth, u + added, setup).y
    clean = responded(truth, u, setup)

    def likelihood(each: Rival) -> float:
        g = setup.grid
        piece = cut("new", setup.time, u, y, g, setup.resolution)
        segments = type(case("bias").dataset.segments)(g.h, g.width, g.bins, g.velocity, (piece,))
        problem = Problem.of(segments, each.fit.noise, segments.counted)
        point = replace(
            each.fit.at(initial=piece.initial), simulator=each.fit.simulator.over(segments)
        )
        return float(evaluate(problem, point).score.sum())

    # parameters that may not move
    stiff = replace(other.fit, information=1e12 * np.eye(len(other.fit.free)))
    expected, found = (
        lead(clean, Rival(other.name, stiff), setup),
        likelihood(truth) - likelihood(other),
    )
    assert 0.5 * expected < found < 2.0 * expected


@pytest.mark.sampled(4)
def test_models_that_are_the_same_are_told_apart_by_no_input(
    case: Callable[..., Any], setup: Setup
) -> None:
    """A friction that differs by direction is Coulomb friction and a constant torque, at rest too;
    dead time is not.
    """
    friction = case("bias").base.fit.values["coulomb.Fc"]
    bias = rival(case("bias"), "bias", torque=-0.2 * friction)
    same, late = (
        rival(case("bias"), "asymmetric_coulomb", share=0.2),
        rival(case("bias"), "input_delay", delay=0.01),
    )
    u, wide = (
        np.repeat(np.random.default_rng(1).uniform(-0.4, 0.4, SAMPLES // 400), 400),
        Limits((-9.0, 9.0), (-1e3, 1e3), 9.0),
    )
    # where it rests, segments do not show how the bristles begin
    assert lead(responded(bias, u, setup), same, setup) > 20.0
    plans = [_Design((bias, other), wide, setup) for other in (same, late)]
    gains = [
        plan.beyond_own_lead(trial).gain
        for plan in plans
        if (trial := plan.tried(Input("steps", (u,))))
    ]
    assert gains[0] < 1.0 < 30.0 < gains[1]


def test_what_leaves_the_limits_with_a_rival_is_not_taken(
    case: Callable[..., Any], setup: Setup
) -> None:
    rivals = (
        rival(case("bias"), "bias", torque=0.05),
        rival(case("bias"), "input_delay", delay=0.01),
    )
    u = sines(0.2)
    y = responded(rivals[0], u, setup).y
    half = 1.6 * float(np.abs(y).max()) + 1.0
    wide = _Design(rivals, Limits((-0.5, 0.5), (-half, half), 0.5), setup)
    tight = replace(wide, limits=replace(wide.limits, theta=(y.min() + 2 * MARGIN, y.max())))
    assert wide.responses(u) is not None
    assert tight.responses(u) is None
    assert replace(wide, limits=replace(wide.limits, u=(-0.1, 0.5))).responses(u) is None


def test_pairs_of_one_class_count_only_among_themselves(
    case: Callable[..., Any], setup: Setup
) -> None:
    bias, late, pole = (
        Rival(name, case("bias").base.fit) for name in ("bias", "input_delay", "electrical_pole")
    )
    assert {(a.name, b.name) for a, b in _Design((late, pole), LIMITS, setup).pairs} == {
        ("input_delay", "electrical_pole"),
        ("electrical_pole", "input_delay"),
    }
    pairs = [{a.name, b.name} for a, b in _Design((bias, late, pole), LIMITS, setup).pairs]
    assert {"input_delay", "electrical_pole"} not in pairs
    assert len(pairs) == 4


# -- in a loop -------------------------------------------------------------------------------------
def in_loop(setup: Setup, frequency: float) -> Setup:
    """Return the same in a position loop."""
    return replace(setup, loop=Loop(frequency), input_ends=(-0.5, 0.5))


def path() -> np.ndarray:
    """A smooth step there and back, with rests."""
    to = np.concatenate([np.zeros(500), move(1.0, 2.0, 20.0, H)])
    whole = np.concatenate([to, np.full(500, 1.0), to[::-1]])
    return np.concatenate([whole, np.zeros(SAMPLES - len(whole))])


def test_a_loop_keeps_to_its_reference_and_its_ends(case: Callable[..., Any], setup: Setup) -> None:
    """A loop of 5 Hz gives way by friction over its stiffness, J (2 pi 5)^2, and lags little."""
    one, reference = rival(case("bias"), "bias", torque=0.0), path()
    values = one.fit.values
    seen = responded(one, reference, in_loop(setup, 5.0))
    give = (values["coulomb.Fc"] + 0.02) / (values["J"] * (10 * np.pi) ** 2)
    assert np.abs(seen.y - reference).max() < 2.0 * give
    assert np.abs(seen.u).max() <= 0.5
    # at rest dry friction bears what the loop asks for
    assert abs(seen.u[-1]) <= values["coulomb.Fc"]


def test_a_loop_with_a_given_input_is_the_servo_in_open_loop(
    case: Callable[..., Any], setup: Setup
) -> None:
    """What the loop drove with, played back, gives the same motion."""
    one = rival(case("bias"), "bias", torque=0.05)
    seen = responded(one, path(), in_loop(setup, 5.0))
    again = responded(one, seen.u, setup)
    assert np.abs(again.y - seen.y).max() < 1e-3


def test_disturbances_move_a_servo_far_less_in_a_loop(
    case: Callable[..., Any], setup: Setup
) -> None:
    one, reference = rival(case("bias"), "bias", torque=0.0), path()
    held = one.disturbed(reference, in_loop(setup, 5.0), 2)
    plain = responded(one, reference, in_loop(setup, 5.0))
    free = one.disturbed(plain.u, setup, 2)
    assert held is not None
    assert free is not None
    in_the_loop, alone = (
        max(float(np.abs(each.y - plain.y).max()) for each in some) for some in (held, free)
    )
    assert in_the_loop < 0.3 * alone


def test_references_stay_within_range_and_speed_and_are_the_same_each_time() -> None:
    theta = 0.5 * np.sin(2 * np.pi * 0.5 * H * np.arange(SAMPLES))
    first, again = (references(LIMITS, [theta], (3.0, 40.0), (SAMPLES, H)) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        for a, b in zip(one.scaled, other.scaled, strict=True):
            assert np.array_equal(a, b)
            assert len(a) == SAMPLES
            assert LIMITS.allow_motion(a, 0.0)
            assert np.abs(np.diff(a)).max() < 2 * 3.0 * H * np.ptp(theta) + 3.0 * H


@pytest.mark.parametrize("frequency", [3.0, 12.0])
def test_a_loop_is_seen_in_its_records_and_open_loop_is_not(frequency: float) -> None:
    """Two records of one servo, simulated here: in a loop, and with the same input played back
    under another disturbance.
    """
    looped, played = records_of_a_loop(frequency)
    found = loop_of(slides(looped))
    assert found is not None
    assert frequency / 1.6 < found.frequency < 1.6 * frequency
    assert loop_of(slides(played)) is None


def test_a_servo_that_coasts_shows_no_loop() -> None:
    """No input at all while it slides."""
    [(time, u, y)] = records_of_a_loop(3.0)[0]
    coasting = slides([(time, u, y)])
    none = replace(coasting.model.over, u=np.zeros_like(u))
    assert loop_of(replace(coasting, model=replace(coasting.model, over=none))) is None


def records_of_a_loop(frequency: float) -> tuple[list[Any], list[Any]]:
    """Return (time, input, output) of a servo with dry friction: in a loop, and played back."""
    rng, n, fine = np.random.default_rng(5), 20000, 4
    time, omega = H * np.arange(n), 2 * np.pi * frequency
    reference = 1.2 * np.sin(2 * np.pi * 0.4 * time) + 0.5 * np.sin(2 * np.pi * 0.93 * time)
    rate = np.gradient(reference, H)
    played = list[float]()

    def run(u_of: Callable[[int, float, float], float]) -> list[Any]:
        x = v = seen = before = slope = 0.0
        x = reference[0]
        before, u_all, y_all = round(x / 1e-3) * 1e-3, [], []
        noise = lfilter([1.0], [1.0, -0.94], 0.003 * rng.standard_normal(n))
        for k in range(n):
            seen = round(x / 1e-3) * 1e-3
            slope += 0.3 * ((seen - before) / H - slope)
            before, u = seen, u_of(k, seen, slope)
            u_all.append(u)
            y_all.append(seen)
            for _ in range(fine):
                force = u + noise[k] - 0.02 * v - 0.12 * np.tanh(v / 1e-3)
                v += H / fine * force / 0.01
                x += H / fine * v
        return [(time, np.array(u_all), np.array(y_all))]

    def loop(k: int, seen: float, slope: float) -> float:
        u = 0.01 * omega**2 * (reference[k] - seen) + 0.018 * omega * (rate[k] - slope)
        return float(np.clip(u, -1.0, 1.0))

    looped = run(loop)
    played += looped[0][1].tolist()
    return looped, run(lambda k, _, __: played[k])


def slides(records: list[Any]) -> SlidingFit:
    """Return the fit of the sliding motion of Coulomb friction."""
    free = tuple(Free(name, 1e-4, 1.0) for name in ("J", "a2", "coulomb.Fc"))
    over = stretches_of(records, H, False, 1e-3)
    model = SlidingModel("coulomb", (), free, over, 1e-3)
    values = {"J": 0.012, "a2": 0.03, "coulomb.Fc": 0.1, "b": 1.0, "u_max": 1e9}
    fit = fit_sliding(model, values)
    assert fit is not None
    return fit


# -- what is written and said ----------------------------------------------------------------------
def made(**other: Any) -> DesignedInput:
    """Return a designed input."""
    u = 0.1 * np.sin(np.arange(50))
    found = DesignedInput(
        ("bias", "gravity"),
        42.0,
        6.0,
        "steps",
        "N.m",
        -0.1,
        0.1,
        0.07,
        0.5,
        (0.1, 0.9),
        ("t [s]", "u [N.m]"),
        H * np.arange(50),
        u,
    )
    return replace(found, **other)


@pytest.mark.sampled(4)
def test_the_file_holds_time_and_input_and_goes_with_the_next_answer(
    answer: Callable[[str], Diagnosis], tmp_path: Path
) -> None:
    found = replace(answer("tie"), designed=made())
    assert tmp_path / "experiment.csv" in write(found, tmp_path)
    table = np.loadtxt(tmp_path / "experiment.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(
        table, np.column_stack([found.designed.time, found.designed.u]), atol=1e-9
    )
    assert found.to_dict()["experiment_input"]["file"] == "experiment.csv"
    write(answer("tie"), tmp_path)
    assert not (tmp_path / "experiment.csv").exists()


@pytest.mark.parametrize(("time", "given"), [("t", "u"), ("t [s]", "u [Nm]"), ("t (ms)", "u[mV]")])
def test_the_columns_of_the_file_have_one_unit_each(
    answer: Callable[[str], Diagnosis], time: str, given: str
) -> None:
    model = answer("tie").model
    columns = {
        "time": model.time.model_copy(update={"column": time}),
        "input": model.input.model_copy(update={"column": given}),
    }
    named = replace(model, **columns)
    assert _headings(named) == ("t [s]", "u [N.m]")


def test_the_sentence_says_file_rivals_gain_and_open_loop_or_that_there_is_none(
    answer: Callable[[str], Diagnosis],
) -> None:
    model = answer("tie").model
    text = designed_line(made(), model)
    assert all(
        word in text
        for word in ("experiment.csv", "open loop", "bias", "gravity", "42 nats", "0.07 N.m rms")
    )
    looped = designed_line(made(loop=4.6), model)
    assert all(word in looped for word in ("reference", "loop as it is", "4.6 Hz", "42 nats"))
    assert "open loop" not in looped
    none = made(time=np.empty(0), u=np.empty(0), gain=2.5)
    assert "No input was found" in designed_line(none, model)
    assert replace(answer("tie"), designed=none).to_dict()["experiment_input"] == {
        "file": None,
        "rivals": ["bias", "gravity"],
        "gain": 2.5,
        "level": 6.0,
    }
    assert designed_line(None, model) == ""
    alone = designed_line(replace(made(), rivals=("", "bias", "gravity")), model)
    assert "and no further effect by 42 nats" in alone
