"""Refit: it climbs to the best there is, minds its bounds, shrugs off a bad segment; effects start
near the truth.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from bristle.diagnosis.estimation.fitted_model import relative_error, under_own_noise
from bristle.diagnosis.estimation.initial_states import initialise_load, refine_initial_states
from bristle.diagnosis.estimation.likelihood import (
    FitPoint,
    InitialStateElimination,
    evaluate,
    initial_state_price,
    rescored,
    squares,
)
from bristle.diagnosis.estimation.optimiser import (
    pressed_bounds,
    refit,
    refit_initial_states,
    refit_load,
    refit_nonsmooth,
    resume,
)
from bristle.diagnosis.estimation.uncertainty import covariance
from bristle.diagnosis.free_parameter import Free, free_parameters
from bristle.diagnosis.localisation.residual_response import ResidualResponse
from bristle.diagnosis.selection.start_values import SearchContext
from bristle.diagnosis.selection.stepwise import NATS_PER_PARAMETER, evaluate_candidates

TRUE = {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12}
HIDDEN = {  # effect: (parameters it was simulated with, largest error relative to them)
    "cogging": ({"amplitude": 0.08, "periods": 7.0}, 0.02),
    "input_delay": ({"delay": 0.01}, 0.02),
    "dead_zone": ({"width": 0.08}, 0.02),
    "gain_asymmetry": ({"share": 0.2}, 0.02),
    "saturation": ({"limit": 0.3}, 0.02),
    "friction_drift": ({"rate": 0.05}, 0.05),
    "compliance": ({"stiffness": 40.0, "share": 0.5}, 0.05),
    "quadratic_drag": ({"coefficient": 0.002}, 0.05),
    "encoder_play": ({"play": 0.02}, 0.02),
    "asymmetric_viscous": ({"coefficient": 0.01}, 0.05),
}


def joined(case, name):
    """An effect refitted from its own starts, on top of a model that lacks it, under the noise it
    leaves.
    """
    [found] = evaluate_candidates(SearchContext(case.dataset, case.base), [name]).trials
    return found


def test_a_phase_has_no_bound():
    """Where it leaves its interval, it loses whole turns; what is no phase ends there."""
    start = {"amplitude": 0.1, "periods": 3.0, "phase": 9.9}
    free = {f.name: f for f in free_parameters("cogging", start, {})}
    phase, amplitude = free["cogging.phase"], free["cogging.amplitude"]
    assert phase.clip(9.9) == 9.9
    assert phase.clip(phase.high + 0.1) == pytest.approx(phase.high + 0.1 - 4 * np.pi)
    assert not phase.at_bound(phase.high)
    assert not phase.leaves(phase.high, 1.0)
    assert amplitude.clip(2 * amplitude.high) == amplitude.high
    assert amplitude.at_bound(amplitude.high)


@pytest.mark.slow
@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", list(HIDDEN))
def test_starts_from_data_lead_to_the_truth(case, name):
    """Of the effect and of the model, from nominal values that are 20 % off, on records of a
    simulation ten times finer.
    """
    found = joined(case(name), name)
    assert found.fit is not None
    assert found.fit.total > case(name).base.fit.total + 100
    known, limit = HIDDEN[name]
    for key, value in known.items():
        assert found.fit.values[f"{name}.{key}"] == pytest.approx(value, rel=limit), key
    for key, value in TRUE.items():
        assert found.fit.values[key] == pytest.approx(value, rel=0.03), key


@pytest.mark.sampled(4)
def test_a_step_with_a_large_predicted_gain_is_shortened_until_it_achieves_some(case):
    """From the starts of this one every full step fails; ended there, the share of the load would
    stay where it began.
    """
    given = {"share": 0.4, "stiffness": 60.0, "damping": 0.02}
    found = joined(case("compliance", **given), "compliance").fit
    for key, value in given.items():
        assert found.values[f"compliance.{key}"] == pytest.approx(value, rel=0.08), key


def test_without_anything_hidden_the_model_is_found_within_its_intervals(case):
    plain = case(None)
    values = {f.name: plain.base.fit.values[f.name] for f in plain.base.fit.free}
    spread = dict(zip(values, np.sqrt(np.diag(covariance(plain.base.fit))), strict=True))
    for key, value in TRUE.items():
        assert values[key] == pytest.approx(value, rel=0.01)
        assert abs(values[key] - value) < 4 * spread[key]
        assert spread[key] < 0.02 * value


def test_the_likelihood_is_highest_where_the_refit_ends(case):
    """Along every parameter, start states following."""
    plain = case(None)
    problem, best = plain.base.problem, plain.base.fit
    best = refit(problem, best)
    slack = []
    for f in best.free:
        size = 1 / np.sqrt(best.information[best.free.index(f), best.free.index(f)])
        for sign in (1, -1):
            moved = (
                best.values[f.name] * np.exp(sign * size)
                if f.factor
                else best.values[f.name] + sign * size
            )
            away = evaluate(problem, best.at({**best.values, f.name: f.clip(moved)}))
            slack.append(best.total - away.total)
    assert min(slack) > -0.1


def test_a_refit_from_far_off_reaches_the_optimum(case):
    plain = case(None)
    best = plain.base.fit
    away = {**best.values, "J": 0.02, "a2": 0.06, "coulomb.Fc": 0.05}
    found = refit(plain.base.problem, best.at(away, plain.dataset.segments.initial), 30)
    for key in TRUE:
        assert found.values[key] == pytest.approx(best.values[key], rel=2e-3)


@pytest.mark.sampled(4)
def test_no_step_makes_it_worse(case):
    plain = case(None)
    best, gains = plain.base.fit, []
    for inertia, level in ((0.004, 0.3), (0.04, 0.02), (0.02, 0.4), (0.005, 0.01)):
        away = {**best.values, "J": inertia, "coulomb.Fc": level}
        totals = [
            refit(plain.base.problem, best.at(away, plain.dataset.segments.initial), count).total
            for count in range(5)
        ]
        assert totals == sorted(totals)
        gains.append(totals[-1] - totals[0])
    assert max(gains) > 100


def test_start_states_are_eliminated(case):
    """Where they stand does not matter to the likelihood, to first order: it is that of the best
    ones.
    """
    plain = case(None)
    problem, best = plain.base.problem, plain.base.fit
    rng = np.random.default_rng(4)
    moved = best.initial + 0.04 * problem.initial_sd * rng.standard_normal(best.initial.shape)
    away = evaluate(problem, best.at(initial=moved))
    bare = -0.5 * np.sum(
        (np.square(away.white).sum(axis=1) - np.square(best.white).sum(axis=1))[problem.counted]
    )
    assert bare < -50
    assert abs(away.total - best.total) < 0.02 * abs(bare)


def test_one_bad_segment_does_not_decide(case):
    plain = case(None)
    problem, best = plain.base.problem, plain.base.fit
    seen = problem.measured.copy()
    bad = int(np.flatnonzero(problem.counted)[3])
    seen[bad] += 0.5 * np.sin(np.linspace(0, 6, seen.shape[1]))
    found = refit(replace(problem, measured=seen), best)
    for key in TRUE:
        assert found.values[key] == pytest.approx(best.values[key], rel=0.005)
    assert found.weight[bad] < 0.02 * np.median(found.weight[found.weight > 0])


def test_bounds_hold_and_the_others_go_on(case):
    plain = case(None)
    best = plain.base.fit
    low = replace(best.free[0], high=0.008, nominal=None)
    assert low.name == "J"
    start = {**best.values, "J": 0.0075, "a2": 0.05}
    found = refit(
        plain.base.problem, FitPoint(best.simulator, (low, *best.free[1:]), start, best.initial), 40
    )
    assert found.values["J"] == 0.008
    held = refit(
        plain.base.problem,
        FitPoint(best.simulator, best.free[1:], {**start, "J": 0.008}, best.initial),
        40,
    )
    assert found.total == pytest.approx(held.total, abs=0.2)
    assert low.at_bound(found.values["J"])
    assert not found.free[1].at_bound(found.values["a2"])
    assert found.total < best.total - 10
    assert found.values["coulomb.Fc"] != best.values["coulomb.Fc"]


@pytest.mark.parametrize(
    ("free", "value", "stuck"),
    [
        (Free("x", 0.0, 1.0), 0.0, True),
        (Free("x", 0.0, 1.0), 1.0, True),
        (Free("x", 0.0, 1.0), 1e-3, False),
        (Free("x", 0.0, 1e6), 1e-3, False),
        (Free("x", -1.0, 1.0), -1.0, True),
        (Free("x", 2.0, 8.0, True), 2.0, True),
    ],
)
def test_a_parameter_at_its_bound_is_known_as_stuck(free, value, stuck):
    assert free.at_bound(value) is stuck
    assert free.clip(value) == value
    assert free.low <= free.clip(1e9) <= free.high


def test_what_is_known_beforehand_pulls(case):
    """A tight doubt holds a parameter at its nominal value, whatever the records say; none lets it
    go.
    """
    plain = case(None)
    best = plain.base.fit
    tight = replace(best.free[0], nominal=0.012, prior_sd=1e-6)
    found = refit(
        plain.base.problem,
        FitPoint(best.simulator, (tight, *best.free[1:]), best.values, best.initial),
    )
    assert found.values["J"] == pytest.approx(0.012, abs=1e-5)
    assert found.prior < -0.5 or found.total < best.total


def test_segments_that_are_not_judged_do_not_count(case):
    plain = case(None)
    problem, best = plain.base.problem, plain.base.fit
    mask = problem.counted & (plain.dataset.segments.block % 2 == 0)
    seen = np.where(mask[:, None], problem.measured, 7.0)
    one, two = (
        evaluate(replace(problem, counted=mask, measured=s), best) for s in (problem.measured, seen)
    )
    assert one.total == two.total
    np.testing.assert_array_equal(one.information, two.information)
    assert np.all(one.weight[~mask] == 0)


def test_a_torque_in_the_residual_is_read_through_the_lens(case):
    """The linear answer comes near the truth already; what the model's own parameters can do counts
    for nothing.
    """
    hidden = case("cogging")
    response, m = ResidualResponse(hidden.base, hidden.dataset), hidden.dataset.motion
    coefficients, gain = response.regress(
        np.column_stack([np.sin(7 * m.theta), np.cos(7 * m.theta)])
    )
    # the model adds this torque to the motor's
    assert coefficients[0] == pytest.approx(0.08, rel=0.25)
    assert abs(coefficients[1]) < 0.02
    assert gain > 50
    assert (
        gain > 5 * response.regress(np.column_stack([np.sin(5 * m.theta), np.cos(5 * m.theta)]))[1]
    )
    own = response.free_of_model(response.model)
    assert np.max(np.abs(own)) < 1e-6 * np.max(np.abs(response.model))


def test_start_states_alone_are_refitted_where_they_were_disturbed(case):
    """Parameters stay; the likelihood of the disturbed segments comes back to what it was."""
    plain = case(None)
    problem = plain.base.problem.only(plain.dataset.held_out)
    best = refit_initial_states(problem, plain.base.fit)
    off = best.initial + np.where(plain.dataset.held_out[:, None], 30 * problem.initial_sd, 0.0)
    again = refit_initial_states(problem, replace(best, initial=off))
    assert again.values == best.values
    held = plain.dataset.held_out
    assert again.score_at_initial[held].sum() == pytest.approx(
        best.score_at_initial[held].sum(), abs=1.0
    )
    still = evaluate(problem, FitPoint(best.simulator, (), best.values, off))
    assert still.score_at_initial[held].sum() < best.score_at_initial[held].sum() - 100


@pytest.mark.sampled(4)
def test_what_switches_is_found_from_a_value_that_is_off(case):
    """Steps along derivatives end at a small maximum near where they begin; trials around it go
    on.
    """
    hidden = case("dead_zone")
    free = (*hidden.base.fit.free, *free_parameters("dead_zone", {"width": 0.06}, {}))
    simulator = hidden.base.servo.simulator(hidden.base.fit.simulator.segments, ("dead_zone",))
    values = {**hidden.base.fit.values, "dead_zone.width": 0.04}
    first = evaluate(
        hidden.base.problem, FitPoint(simulator, free, values, hidden.base.fit.initial)
    )
    problem = hidden.base.problem
    tried = refit_nonsmooth(first, lambda fit: problem, ("dead_zone",))
    assert tried.total > resume(problem, first).total - 1.0
    assert tried.total > first.total + 50
    assert refit_nonsmooth(first, lambda fit: problem, ("gravity",)).values == first.values


@pytest.fixture(scope="module")
def free_play(case):
    """A servo with backlash from a play and a stiffness that are far off, and what the records show
    of it.
    """
    backlash = case("backlash")
    free = (
        *backlash.base.fit.free,
        *free_parameters("backlash", {"share": 0.5, "play": 0.03, "stiffness": 50.0}, {}),
    )
    simulator = backlash.base.servo.simulator(backlash.base.fit.simulator.segments, ("backlash",))
    off = {
        "backlash.share": 0.35,
        "backlash.play": 0.04,
        "backlash.stiffness": 25.0,
        "backlash.dissipation": 1.0,
    }
    values = {**backlash.base.fit.values, **off}
    return backlash, evaluate(
        backlash.base.problem, FitPoint(simulator, free, values, backlash.base.fit.initial)
    )


@pytest.mark.slow
def test_a_load_with_free_play_is_found_from_a_wrong_play_and_stiffness(free_play):
    """Steps along derivatives leave the load at its side of the play; chosen again in each segment,
    it leads to the true values.
    """
    backlash, first = free_play
    steps = resume(under_own_noise(backlash.dataset, first), first)
    found = refit_load(steps, partial(under_own_noise, backlash.dataset))
    assert found.total > rescored(under_own_noise(backlash.dataset, found), steps).total + 100
    assert found.values["backlash.play"] == pytest.approx(0.03, rel=0.05)
    plain = backlash.base.fit
    # nothing is loose there
    assert refit_load(plain, partial(under_own_noise, backlash.dataset)) is plain


@pytest.mark.sampled(4)
def test_a_load_at_the_wrong_end_of_its_play_is_placed_at_the_right_one(free_play):
    """No segment is the worse for it, and the likelihood comes near what it was."""
    backlash, first = free_play
    problem = backlash.base.problem
    right = initialise_load(problem, first, 3)
    wrong = right.initial.copy()
    wrong[:, 2] *= -1
    moved = evaluate(problem, right.at(initial=wrong))
    again = initialise_load(problem, moved, 3)
    assert (
        moved.score_at_initial[problem.counted].sum()
        < right.score_at_initial[problem.counted].sum() - 100
    )
    assert np.all(again.score_at_initial >= moved.score_at_initial)
    assert (
        again.score_at_initial[problem.counted].sum()
        > right.score_at_initial[problem.counted].sum() - 20
    )
    assert again.values == right.values


def test_steps_of_start_states_make_no_segment_worse(free_play):
    backlash, first = free_play
    problem = backlash.base.problem
    after = refine_initial_states(problem, first, 3)
    assert np.all(after.score_at_initial >= first.score_at_initial)
    assert (
        after.score_at_initial[problem.counted].sum()
        > first.score_at_initial[problem.counted].sum() + 10
    )
    assert refine_initial_states(problem, first, 0) is first


def test_start_states_that_no_sensor_shows_are_paid_for():
    """The logarithm of by how much the records narrow what was known of them; nothing where they
    say nothing.

    In closed form for one direction: half of log(1 + information over precision).
    """
    shape = np.linspace(0.3, 1.0, 50)
    columns = np.zeros((1, 50, 4))
    columns[0, :, 2] = shape
    precision = np.array([[1.0, 1.0, 0.25, 4.0]])
    found = InitialStateElimination.of(columns, np.zeros((1, 50)), precision, np.zeros((1, 4)))
    expected = 0.5 * np.log(1 + shape @ shape / 0.25)
    np.testing.assert_allclose(initial_state_price(found, precision), [expected], rtol=1e-9)
    sure = InitialStateElimination.of(
        columns[:, :, :2], np.zeros((1, 50)), precision[:, :2], np.zeros((1, 2))
    )
    assert initial_state_price(sure, precision[:, :2]) == 0.0


@pytest.mark.parametrize("size", [1.0, 1e6, 1e12])
def test_start_states_that_do_the_same_are_moved_by_what_is_known_of_them(size):
    """A simulation that runs away follows both alike, by far more than rounding leaves of what is
    known of them.
    """
    by_initial = size * np.outer(np.linspace(0.3, 1.0, 50), [1.0, 3.0])[None]
    found = InitialStateElimination.of(
        by_initial, np.ones((1, 50)), np.full((1, 2), 1e-8), np.zeros((1, 2))
    )
    move = found.step(found.gradient)
    assert np.isfinite(found.inverse).all()
    left = np.ones((1, 50)) - (by_initial @ move[:, :, None])[:, :, 0]
    shape = by_initial[0, :, 0]
    best = np.ones(50) - shape * (shape.sum() / (shape @ shape))
    np.testing.assert_allclose(left[0], best, atol=1e-3)


@pytest.mark.parametrize(
    ("ends", "stuck", "free", "wider"),
    [
        ((-0.02, -0.002), (-0.02, -0.002), (-0.01,), (-0.1, -0.0004)),
        ((-0.02, 0.02), (-0.02, 0.02), (0.0, 0.01), (-0.1, 0.1)),
        ((0.0, 2.0), (0.0, 2.0), (1.0,), (0.0, 10.0)),
        ((1.0, np.inf), (1.0,), (2.0, 1e300), (0.2, np.inf)),
        ((-np.inf, 3.0), (3.0,), (-1e300, 0.0), (-np.inf, 15.0)),
    ],
)
def test_ends_of_an_interval_of_either_sign(ends, stuck, free, wider):
    f = Free("b", *ends)
    assert all(f.at_bound(value) for value in stuck)
    assert not any(f.at_bound(value) for value in free)
    assert (f.widened(5.0).low, f.widened(5.0).high) == pytest.approx(wider)


def test_a_segment_whose_simulation_failed_is_no_perfect_one(case):
    dataset, fit = case(None).dataset, case(None).base.fit
    one = int(np.flatnonzero(dataset.held_out)[0])
    lost = fit.good.copy()
    lost[one] = False
    kept = fit.output_by_initial * lost[:, None, None]
    failed = replace(
        fit, good=lost, residual=np.where(lost[:, None], fit.residual, 0.0), output_by_initial=kept
    )
    before, after = squares(fit, dataset.held_out), squares(failed, dataset.held_out)
    assert after[0] == pytest.approx(float(np.var(dataset.segments.measured[one])))
    assert after[0] > 10 * before[0]
    np.testing.assert_array_equal(after[1:], before[1:])


@pytest.mark.slow
def test_parameters_collinear_with_an_effect_are_found(case):
    """Back EMF is viscous friction by another name; gravity is nothing else."""
    for name, others in (("back_emf", ("a2",)), ("gravity", ())):
        fit = joined(case(None), name).fit
        assert fit is not None
        place = [f.name for f in fit.free].index(
            f"{name}.constant" if name == "back_emf" else f"{name}.amplitude"
        )
        assert fit.collinear_with(place) == others
        # derivatives of a load that hits the ends of its play come to such values
        for known in (0.0, -1e9, np.nan):
            rounded = fit.information.copy()
            rounded[0, 0] = known
            assert replace(fit, information=rounded).collinear_with(place) == ()


def test_a_record_without_motion_has_a_relative_error_above_one(case):
    dataset, fit = case(None).dataset, case(None).base.fit
    pieces = tuple(replace(piece, measured=0 * piece.measured) for piece in dataset.segments.pieces)
    still = replace(dataset, segments=replace(dataset.segments, pieces=pieces))
    assert relative_error(still, fit) > 1.0


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("low", "high", "pressed"), [(0.02, 0.05, True), (0.02, 0.3, False), (0.0797, 0.3, False)]
)
def test_a_bound_that_the_records_push_against_is_pressed(case, low, high, pressed):
    """An amplitude of 0.08 N.m that may be 0.05 at most; one whose interval ends where the estimate
    is gains nothing beyond it.
    """
    found = joined(case("cogging"), "cogging").fit
    free = tuple(
        replace(f, low=low, high=high) if f.name == "cogging.amplitude" else f for f in found.free
    )
    values = found.values | {
        "cogging.amplitude": min(max(found.values["cogging.amplitude"], low), high)
    }
    problem = case("cogging").base.problem
    fit = refit(problem, FitPoint(found.simulator, free, values, found.initial))
    gains = pressed_bounds(fit, "cogging.")
    assert bool({key for key, gain in gains.items() if gain > NATS_PER_PARAMETER}) is pressed
    assert pressed_bounds(fit, "gravity.") == {}
