"""Segments: cut as measured, simulated as the plain servo is, with derivatives that are those of
the simulation.
"""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from bristle.diagnosis.estimation.dataset import (
    Grid,
    Segments,
    cut,
)
from bristle.diagnosis.estimation.simulator import (
    OWN_BRISTLES,
    Servo,
    Simulator,
    fixed_values,
)
from bristle.diagnosis.sliding.stretches import smooth
from bristle.model.native import Native
from bristle.plant.servo import servo_program

H, WIDTH, BINS = 1e-3, 8, 50
GRID = Grid(H, WIDTH, BINS, False)
BASE = ("J", "a2", "coulomb.Fc")
VALUES = {"J": 0.01, "a2": 0.02, "b": 1.0, "coulomb.Fc": 0.12}
SOFT_BRISTLES = {
    f"{OWN_BRISTLES}.stiffness": 1200.0,
    f"{OWN_BRISTLES}.damping": 2.0,
}  # a deflection of a quarter of a step of 16384 counts
WITH = {  # an effect, away from the ends of its intervals
    "gravity": {"amplitude": 0.2, "phase": 0.4},
    "cogging": {
        "amplitude": 0.05,
        "phase": 0.3,
        "periods": 6.9,
        "amplitude2": 0.01,
        "phase2": -0.4,
    },
    "backlash": {"stiffness": 30.0, "share": 0.4, "play": 0.02},
    "compliance": {"stiffness": 30.0, "share": 0.4},
    "dead_zone": {"width": 0.06},
    "input_delay": {"delay": 0.0063},
    "presliding": {"stiffness": 9.0},
    "encoder_play": {"play": 0.03},
}


def swing(seconds=3.2, seed=5):
    """A torque of several tones that reverses the servo now and then."""
    t = H * np.arange(round(seconds / H))
    rng = np.random.default_rng(seed)
    return t, sum(
        0.16 * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.3)) for f in (0.7, 1.3, 2.9, 4.3)
    )


@pytest.fixture(scope="module")
def segments():
    t, u = swing()
    native = Native(servo_program("coulomb", encoder=False), VALUES | {"u_max": 1e6})
    y = native.run(H, {"u": u}, ["theta"])[0][:-1, 0]
    return Segments(H, WIDTH, BINS, False, (cut("run", t[0], u, y, GRID, 4e-4),))


def simulator(segments, effects, rigid):
    return Servo("coulomb", (), BASE, (), fixed_values(H), rigid).simulator(segments, effects)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", [None, *WITH])
def test_derivatives_are_those_of_the_simulation(segments, name):
    """By every parameter and all start states, over reversals, of a servo whose friction bends a
    little.

    The far side of a coupling is set along with each start, without what it owes to parameters
    before: there the first segment alone is exact. A contact begins within a step, which a
    simulation by steps sees a little earlier or later.
    """
    least = 0.03 if name == "backlash" else 1e-5
    values = (
        VALUES
        | SOFT_BRISTLES
        | {f"{name}.{key}": value for key, value in WITH.get(name, {}).items()}
    )
    work = simulator(segments, (name,) if name else (), True)
    starts = segments.initial + np.array([0.0, 0.01])  # none at rest: steps have a kink there
    # in contact at either side and in between, faster and slower than the motor
    if name == "backlash":
        starts = np.column_stack(
            [starts, np.resize([1.03, 0.2, -1.02], 8), np.resize([0.3, -0.5], 8)]
        )
    seen, exact, good, _ = work.run(values, starts, jacobian=True)
    assert exact is not None
    assert good.all()
    moved = [
        key
        for key in work.names
        if key in values and (name != "presliding" or not key.startswith(OWN_BRISTLES))
    ]
    assert {*BASE, *(f"{name}.{key}" for key in WITH.get(name, {}))} <= set(moved)
    for key in moved:
        delta = 1e-6 * values[key]
        up, down = (
            work.run(values | {key: values[key] + sign * delta}, starts)[0] for sign in (1, -1)
        )
        known = slice(0, 1) if name == "compliance" else slice(None)
        check(exact[known, :, work.names.index(key)], (up - down)[known] / (2 * delta), key, least)
    for k in range(len(starts)):
        for column, delta in enumerate((1e-7, 1e-6, 1e-6, 1e-6)[: work.width]):
            offset = np.zeros_like(starts)
            offset[k, column] = delta
            up, down = (work.run(values, starts + sign * offset)[0][k] for sign in (1, -1))
            check(
                exact[k, :, len(work.names) + column],
                (up - down) / (2 * delta),
                f"start {column} of {k}",
                least,
            )
    assert np.array_equal(work.run(values, starts)[0], seen)


def check(exact, difference, key, least):
    size = np.max(np.abs(difference))
    assert size > 0, key
    assert np.max(np.abs(exact - difference)) <= least * size, (
        key,
        np.max(np.abs(exact - difference)) / size,
    )


def test_a_segment_is_a_run_of_the_servo_from_its_start(segments):
    """Without hidden states each segment is what the plain simulation gives from the same position
    and velocity.
    """
    starts = segments.initial + np.array([0.01, -0.2])
    seen, _, good, _ = simulator(segments, (), False).run(VALUES, starts)
    assert good.all()
    u = segments.pieces[0].u.reshape(-1, WIDTH * BINS)
    for k in (0, 3, 7):
        begin = {"theta_start": starts[k, 0], "v_start": starts[k, 1], "u_max": 1e6}
        native = Native(servo_program("coulomb", encoder=False), VALUES | fixed_values(H) | begin)
        theta = native.run(H, {"u": u[k]}, ["theta"])[0][:-1, 0]
        np.testing.assert_allclose(
            seen[k], theta.reshape(BINS, WIDTH).mean(axis=1), rtol=0, atol=1e-13
        )


@pytest.mark.sampled(4)
def test_hidden_states_carry_over_from_segment_to_segment(segments):
    """The delay line of one segment reaches into the next: what came before its start is not
    forgotten.
    """
    values = VALUES | {"input_delay.delay": 0.02}
    seen = simulator(segments, ("input_delay",), False).run(values, segments.initial)[0]
    parts = enumerate(segments.pieces[0].u.reshape(-1, WIDTH * BINS))
    pieces = tuple(cut("part", 0.4 * k, u, np.zeros_like(u), GRID, 4e-4) for k, u in parts)
    cold = Segments(H, WIDTH, BINS, False, pieces)
    alone = simulator(cold, ("input_delay",), False).run(values, segments.initial)[0]
    np.testing.assert_array_equal(seen[0], alone[0])
    # it rests at the start of some
    assert np.sum(np.max(np.abs(seen - alone)[1:], axis=1) > 1e-3) >= 4


@pytest.mark.sampled(4)
def test_a_load_with_free_play_continues_from_the_last_segment_unless_placed(segments):
    """The start of the load is returned, over half the play, and the same again when given; one
    moved leaves the others.
    """
    values = VALUES | {
        f"backlash.{key}": value for key, value in (WITH["backlash"] | {"stiffness": 200.0}).items()
    }
    work = simulator(segments, ("backlash",), False)
    seen, _, _, starts = work.run(values, segments.initial)
    assert starts.shape == (8, 4)
    assert np.all(starts[0, 2:] == 0.0)
    assert np.any(np.abs(starts[1:, 2]) > 0.5)
    np.testing.assert_array_equal(starts[:, :2], segments.initial)
    again, _, _, returned = work.run(values, starts)
    np.testing.assert_allclose(again, seen, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(returned, starts)
    other = starts.copy()
    other[3, 2] = -starts[3, 2] - 0.5
    moved = work.run(values, other)[0]
    assert np.max(np.abs(moved[3] - again[3])) > 1e-4
    np.testing.assert_array_equal(np.delete(moved, 3, axis=0), np.delete(again, 3, axis=0))
    wider = work.run(values | {"backlash.play": 0.04}, starts)[3]
    np.testing.assert_array_equal(wider[:, 2], starts[:, 2])
    assert simulator(segments, (), False).run(VALUES, starts)[3].shape == (8, 2)


def test_a_velocity_is_simulated_where_a_velocity_was_measured():
    t, u = swing()
    native = Native(servo_program("coulomb", encoder=False), VALUES | {"u_max": 1e6})
    v = native.run(H, {"u": u}, ["v"])[0][:-1, 0]
    segments = Segments(
        H, WIDTH, BINS, True, (cut("run", t[0], u, v, Grid(H, WIDTH, BINS, True), 1e-3),)
    )
    starts = np.column_stack([np.zeros(8), v[:: WIDTH * BINS][:8]])
    seen, sens, _, _ = Simulator("coulomb", (), segments, BASE, fixed_values(H)).run(
        VALUES, starts, jacobian=True
    )
    assert sens is not None
    assert np.max(np.abs(seen - segments.measured)) < 1e-4 * np.ptp(v)
    assert np.all(sens[:, :, -2] == 0.0)  # where it is does not matter
    assert np.sum(sens[:, 0, -1] > 0.9) >= 4  # it rests at the start of some


def test_what_cannot_be_simulated_is_marked_and_spoils_nothing_else(segments):
    starts = segments.initial.copy()
    starts[2, 1] = np.nan
    work = simulator(segments, (), False)
    seen, _, good, _ = work.run(VALUES, starts)
    assert good.tolist() == [k != 2 for k in range(8)]
    np.testing.assert_array_equal(seen[good], work.run(VALUES, segments.initial)[0][good])


def test_records_are_cut_into_averages_and_the_rest_is_dropped():
    y = np.arange(1000.0) ** 2
    piece = cut("run", 7.0, np.arange(1000.0), y, Grid(1e-3, 8, 50, False), 1.0)
    assert (piece.time, piece.measured.shape, piece.u.shape) == (7.0, (2, 50), (800,))
    np.testing.assert_array_equal(piece.measured[1, 3], y[424:432].mean())
    parts = Segments(1e-3, 8, 50, False, (piece, piece))
    assert parts.counted.tolist() == [False, True, False, True]
    assert parts.block.tolist() == [0, 1, 0, 1]
    assert parts.measured.shape == (4, 50)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_parabola_passes_the_smoothing(order):
    """Also at the ends: a torque known from an acceleration would jump there."""
    t = 1e-3 * np.arange(400)
    y = [0.3 - 2 * t + 5 * t**2, -2 + 10 * t, np.full(400, 10.0)]
    found = smooth(y[0], 1e-3, 0.02, order)
    np.testing.assert_allclose(found, y[order], rtol=0, atol=1e-9)
    assert len(found) == 400


def test_start_states_are_as_uncertain_as_the_sensor_is_coarse():
    """The true states lie within the stated standard deviations, which are not far too wide."""
    _, u = swing(16.0)
    native = Native(servo_program("coulomb", encoder=False), VALUES | {"u_max": 1e6})
    true = native.run(H, {"u": u}, ["theta", "v"])[0][:-1]
    step = 2 * np.pi / 16384
    piece = cut("run", 0.0, u, np.floor(true[:, 0] / step + 0.5) * step, GRID, step)
    z = (piece.initial - true[:: WIDTH * BINS][: len(piece.initial)]) / piece.initial_sd
    assert np.all(np.abs(z) < 3)
    assert np.all(np.sqrt(np.mean(z[1:] ** 2, axis=0)) > 0.01)


@pytest.mark.sampled(4)
def test_no_reversal_amplifies_a_start():
    """Dry friction takes energy: what a start velocity moves by the end of a segment is at most
    time times velocity.

    A servo that creeps to rest reverses in the last instants of steps, and what is left of a step
    is divided by.
    """
    rng = np.random.default_rng(3)
    u = np.repeat(rng.normal(0.0, 0.12, 100), 200)
    native = Native(servo_program("coulomb", encoder=False), VALUES | {"u_max": 1e6})
    y = native.run(H, {"u": u}, ["theta"])[0][:-1, 0]
    rough = Segments(H, WIDTH, BINS, False, (cut("run", 0.0, u, y, GRID, 4e-4),))
    work = simulator(rough, (), True)
    for damping in np.geomspace(0.01, 10.0, 60):
        damped = {f"{OWN_BRISTLES}.stiffness": 5000.0, f"{OWN_BRISTLES}.damping": damping}
        _, exact, good, _ = work.run(VALUES | damped, rough.initial, jacobian=True)
        assert exact is not None
        assert good.all()
        assert np.abs(exact[:, :, -1]).max() <= 1.01 * H * WIDTH * BINS
        assert np.abs(exact[:, :, -2]).max() <= 1.5


def test_two_threads_simulate_the_same_program_without_disturbing_each_other(segments):
    """Each in its own instance: two diagnoses may run side by side."""
    values = [VALUES | SOFT_BRISTLES | {"coulomb.Fc": level} for level in (0.1, 0.14)]
    pair = [simulator(segments, (), True) for _ in values]
    alone = [work.run(v, segments.initial)[0] for work, v in zip(pair, values, strict=True)]

    def again(i):
        return all(
            np.array_equal(pair[i].run(values[i], segments.initial)[0], alone[i]) for _ in range(50)
        )

    with ThreadPoolExecutor(2) as pool:
        assert all(pool.map(again, (0, 1)))


@pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="this system does not fork"
)
# of a process with threads: what is tested
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_does_not_wait_for_threads_it_has_not(segments):
    twice = Segments(H, WIDTH, BINS, False, (*segments.pieces, *segments.pieces))
    work = simulator(twice, (), False)
    here = work.run(VALUES, twice.initial)[0]  # the threads are at work from here on
    context = multiprocessing.get_context("fork")
    answers = context.SimpleQueue()
    child = context.Process(target=lambda: answers.put(work.run(VALUES, twice.initial)[0]))
    child.start()
    child.join(30)
    hangs = child.is_alive()
    child.kill()
    assert not hangs
    np.testing.assert_array_equal(answers.get(), here)


def two_records(times):
    t, u = swing(1.6)
    return Segments(
        H,
        WIDTH,
        BINS,
        False,
        tuple(
            cut(name, time, u, 0 * t, GRID, 4e-4) for name, time in zip("abc", times, strict=False)
        ),
    )


def test_records_with_clocks_of_their_own_are_put_one_after_the_other():
    """An event with each record as the last one; a course anew in each record, or on through all of
    them.
    """
    own, session = two_records([2.0, 2.0, 2.0]), two_records([2.0, 4.0, 6.0])
    assert own.own_clocks
    assert not session.own_clocks
    assert own.clocks("event") == [(2.0, 3.6, 5.2), (2.0, 5.2, 3.6), (5.2, 2.0, 3.6)]
    assert own.clocks("course") == [(2.0, 2.0, 2.0), (2.0, 3.6, 5.2)]
    assert own.clocks("") == [own.times]
    assert session.clocks("event") == session.clocks("course") == [(2.0, 4.0, 6.0)]
    assert own.timed((1.0, 2.0, 3.0)).times == (1.0, 2.0, 3.0)


def test_an_event_acts_in_the_record_that_comes_last():
    """Of two alike under alike inputs: only the output of the last one changes, from the moment
    that its time says.
    """
    segments = two_records([0.0, 0.0])
    plain = simulator(segments, (), False).run(VALUES, segments.initial)[0].reshape(2, -1)
    step = {"disturbance_step.torque": 0.3, "disturbance_step.onset": 1.6 + 0.8}
    for last, times in ((1, (0.0, 1.6)), (0, (1.6, 0.0))):
        seen = (
            simulator(segments.timed(times), ("disturbance_step",), False)
            .run(VALUES | step, segments.initial)[0]
            .reshape(2, -1)
        )
        np.testing.assert_allclose(seen[1 - last], plain[1 - last], atol=1e-12)
        np.testing.assert_allclose(seen[last, :100], plain[last, :100], atol=1e-12)
        assert np.max(np.abs(seen[last, 100:] - plain[last, 100:])) > 1e-2
