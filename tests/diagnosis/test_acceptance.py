"""Rules by which the search accepts effects: size and significance, changes of form, detectable
size, width of intervals.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bristle.diagnosis.answer import Assessment, Estimate, Named
from bristle.diagnosis.checks.input_hold import InputShare
from bristle.diagnosis.checks.preparation import base_servo_of
from bristle.diagnosis.estimation import uncertainty as intervals
from bristle.diagnosis.estimation.dataset import (
    HELD_OUT_EVERY,
    Motion,
)
from bristle.diagnosis.estimation.likelihood import FitPoint, rescored
from bristle.diagnosis.estimation.optimiser import maximise, perturbed, refit_initial_states, resume
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.localisation.residual_localisation import SIGN_DRAWS, line_p, spectrum
from bristle.diagnosis.localisation.views import clocks
from bristle.diagnosis.report.text.said import said
from bristle.diagnosis.selection import stepwise
from bristle.diagnosis.selection.candidates import EXHAUSTIVE, QUICK, EffectFit, fit_candidates
from bristle.diagnosis.selection.criterion import ReferenceModel, is_tied, simplest
from bristle.diagnosis.selection.effect_size import (
    fall,
    fall_in_all,
    gain_error,
    left_out_loss,
    predictive_density,
)
from bristle.diagnosis.selection.refinement import add_effect
from bristle.diagnosis.selection.start_values import (
    SearchContext,
    SearchOptions,
    bristle_starts,
    joint_starts_of,
)
from bristle.diagnosis.selection.stepwise import (
    CERTAIN_LEVELS,
    decide,
    evaluate_candidates,
    needs_exhaustive_search,
    propose_effect,
    required_gain,
    retry_with_shape,
    search,
)
from bristle.diagnosis.stages import bounds
from bristle.plant.effect import Evidence
from bristle.plant.effects import effect


def test_what_diverges_by_chance_does_not_hide_a_fall_of_the_error():
    rng = np.random.default_rng(1)
    after = rng.chisquare(40, 75) / 40
    before = 1.5 * after
    before[50] = after[50] = 400.0
    assert float(before.sum() / after.sum()) < 1.1
    assert fall_in_all(before, after) == pytest.approx(1.5, rel=0.1)
    assert fall(before, after, np.ones(75)) == pytest.approx(1.5, rel=0.01)


def test_the_fall_of_the_error_is_that_where_an_effect_acts():
    """In one segment of 75 as in all of them; and one that is simulated to the last bit does not
    make up for the others.
    """
    before, after = np.full(75, 2.0), np.full(75, 2.0)
    after[7] = 1.0
    acts = np.zeros(75)
    acts[7] = 40.0
    assert fall(before, after, acts) == pytest.approx(2.0)
    assert fall(before, after, np.ones(75)) == pytest.approx(76 / 75)
    after[7] = 0.0
    acts[:] = 1.0
    assert fall(before, after, acts) == pytest.approx(84 / 75)
    assert fall(after, before, acts) == pytest.approx(74.1 / 75)
    assert fall(before, after, np.zeros(75)) == 1.0  # nothing changes


def test_a_gain_of_chance_alone_is_within_its_error():
    """Of random gains of either sign the sum is within four errors in all but few of many draws; a
    gain that one segment gives alone has no error.
    """
    rng = np.random.default_rng(1)
    draws = rng.standard_t(4, (4000, 100))
    ratios = np.array([draw.sum() / gain_error(draw) for draw in draws])
    assert np.std(ratios) == pytest.approx(1.0, abs=0.15)
    assert np.mean(ratios > 4.0) < 0.005
    assert gain_error(np.array([0.0, 644.0, 0.0])) == 0.0


@pytest.mark.parametrize(
    ("falls", "predicted", "error", "objection"),
    [
        (1.3, 30, 7, ""),
        (1.3, 19, 0, "likelier that its parameters"),
        (1.1, 3000, 0, "squared error too little"),
        (3.0, -1, 0, "likelier that its parameters"),
        (3.0, 300, 80, "may be chance"),
    ],
)
def test_an_effect_lowers_the_error_and_predicts_more_than_chance_gives(
    falls, predicted, error, objection
):
    """However much of the one, it does not take the place of another."""
    assessment = Assessment(20.0, falls, predicted, error)
    assert assessment.accepted is (objection == "")
    assert objection in said(assessment.objection or "")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bias", "hard_stop"])
def test_the_criterion_asks_segments_that_no_parameter_was_fitted_to(case, name):
    """They speak against an effect if they measured what the model without it simulates; a stop is
    met in few segments only.
    """
    made = case(name)
    found = evaluate_candidates(SearchContext(made.dataset, made.base), [name])
    problem, plain = made.base.problem, made.base.fit
    fit, train = rescored(problem, found.best.fit), made.dataset.train
    comparison = ReferenceModel.of(made.dataset, problem, plain)
    mine = comparison.assess(fit, found.level)
    assert mine.accepted
    measured = problem.measured - np.where(train[:, None], 0.0, plain.residual)
    spoilt = ReferenceModel.of(made.dataset, replace(problem, measured=measured), plain).assess(
        fit, found.level
    )
    assert spoilt.predictive_gain < mine.predictive_gain - 2
    assert spoilt.gain_error > mine.gain_error
    assert not comparison.assess(plain, 0.0).accepted  # nothing added


@pytest.mark.sampled(4)
def test_a_segment_is_predicted_as_if_the_fit_had_been_made_without_it(case):
    """Of the segments that move the fit most, it costs about as much as a refit without each does,
    and what is not known then.
    """
    made = case("bias")
    problem, fit = made.base.problem, maximise(made.base.problem, made.base.fit, stop_gain=1e-4)
    quick = fit.score - predictive_density(problem.only(made.dataset.held_out), fit)
    segments = np.arange(len(problem.counted))
    costs = []
    for k in np.argsort(np.linalg.norm(fit.slopes * fit.weight[:, None], axis=1))[-6:]:
        without = resume(problem.only(problem.counted & (segments != k)), fit, stop_gain=1e-4)
        predicted = refit_initial_states(problem.only(segments == k), without).score[k]
        costs.append((quick[k], fit.score[k] - predicted))
    assert np.all(np.array(costs) > 0)
    assert np.sum(costs, axis=0)[0] == pytest.approx(np.sum(costs, axis=0)[1], rel=0.4)


@pytest.mark.parametrize("beside", [0.0, 0.3])
@pytest.mark.parametrize("lone", [False, True])
def test_what_a_segment_loses_without_being_fitted_is_that_of_linear_regression(lone, beside):
    """The density of each block of y given the others, from the maximum and from beside it; also of
    what one block alone shows.
    """
    rng = np.random.default_rng(3)
    x, sd = rng.standard_normal((7, 5, 3)), np.array([2.0, 0.5, 1.0])
    if lone:
        x[np.arange(7) != 4, :, 2] = 0.0
        x[4, :, 2] *= 100.0
    y = x @ (sd * rng.standard_normal(3)) + rng.standard_normal((7, 5))
    own, prior = np.matmul(x.transpose(0, 2, 1), x), np.diag(sd**-2)
    information = own.sum(axis=0) + prior
    point = np.linalg.solve(information, np.einsum("sbp,sb->p", x, y)) + beside * sd

    def density(blocks):
        flat, wide = y[blocks].ravel(), x[blocks].reshape(-1, 3)
        return multivariate_normal(
            np.zeros(len(flat)), np.eye(len(flat)) + wide @ np.diag(sd**2) @ wide.T
        ).logpdf(flat)

    expected = [density(np.arange(7)) - density(np.arange(7) != k) for k in range(7)]
    rest = y - x @ point
    at_point = -0.5 * (rest**2).sum(axis=1) - 2.5 * np.log(2 * np.pi)
    pull = np.einsum("sbp,sb->sp", x, rest)
    lost = left_out_loss(own, pull, pull.sum(axis=0) - point / sd**2, information)
    np.testing.assert_allclose(at_point - lost, expected, rtol=1e-8)


@pytest.mark.parametrize(
    ("outcomes", "prepared_again", "vain"),
    [
        (["none"], False, True),
        (["rejected"], False, True),
        (["tie"], False, False),
        (["added", "none"], False, False),
        ([], True, False),  # records of an input that was not held, seen before the first round
        (["added"], True, False),
    ],
)
def test_a_search_was_in_vain_if_its_only_round_found_nothing(outcomes, prepared_again, vain):
    rounds = tuple(SimpleNamespace(said=SimpleNamespace(outcome=each)) for each in outcomes)
    share = InputShare(0.4, 100.0) if prepared_again else None
    assert stepwise.SearchOutcome(SimpleNamespace(), rounds, share).in_vain is vain


def test_the_search_sees_the_ends_of_the_range(case):
    """A segment that would be kept from it, but for the largest position, the lowest or an extreme
    of the input.
    """
    dataset = case(None).dataset
    length = len(dataset.motion.theta) // len(dataset.segments.counted)
    kept = int(np.flatnonzero(dataset.held_out)[1])
    assert dataset.segments.block[kept] % HELD_OUT_EVERY == HELD_OUT_EVERY - 1
    for name, value in (("theta", 1e3), ("theta", -1e3), ("u", 1e3), ("u", -1e3)):
        x = getattr(dataset.motion, name).copy()
        x[kept * length + 7] = value
        other = replace(dataset, motion=replace(dataset.motion, **{name: x}))
        assert not other.held_out[kept]
        assert other.train[kept]
        assert not (other.held_out & other.train).any()
    assert np.array_equal(dataset.held_out | dataset.train, dataset.segments.counted)


def spectrum_p(seed: int, tone: float) -> float:
    """The p of a tone in 60 segments of a noise that is slow within each."""
    rng = np.random.default_rng(seed)
    time = 0.4 * np.arange(60)[:, None] + 0.008 * np.arange(50)
    slow = np.cumsum(rng.standard_normal((60, 50)), axis=1)
    slow -= slow.mean(axis=1, keepdims=True)
    signs = np.concatenate([np.ones((1, 60)), rng.choice([-1.0, 1.0], (SIGN_DRAWS // 5, 60))])
    return line_p(
        time, np.zeros(60, dtype=int), slow + tone * np.sin(2 * np.pi * 3.1 * time), signs
    )


def test_a_tone_is_one_among_the_highest_lines_that_chance_finds():
    assert spectrum_p(0, 4.0) < 0.01
    chance = [spectrum_p(seed, 0.0) for seed in range(1, 21)]
    assert sum(p < 0.1 for p in chance) <= 5  # 2 of 20 by chance
    assert np.mean(chance) == pytest.approx(0.5, abs=0.2)


def moved(*begins: float) -> Motion:
    """A motion of records of 20 s that begin at such times."""
    time = np.concatenate([begin + 0.008 * np.arange(2500) for begin in begins])
    still = np.zeros(len(time))
    return Motion(
        still, still, still, still, time, still > 0, np.repeat(np.arange(len(begins)), 2500)
    )


@pytest.mark.parametrize(
    ("begins", "count"),
    [((0, 25), 1), ((0, 0), 2), ((0, 3600), 2), ((500, 25, 525), 3), ((30, 0), 1), ((7,), 1)],
)
def test_records_share_a_clock_if_they_lie_one_after_the_other(begins, count):
    assert len(np.unique(clocks(moved(*begins)))) == count


@pytest.mark.parametrize("shown", [0, 1])
def test_a_tone_of_one_record_is_seen_whichever_record_begins_at_the_same_time(shown):
    m = moved(0, 0)
    time, clock = m.time.reshape(100, 50), clocks(m).reshape(100, 50)[:, 0]
    rough = np.sin(2 * np.pi * 3.1 * time) * (clock == shown)[:, None] + np.random.default_rng(
        5
    ).standard_normal(time.shape)
    frequency, amplitudes = spectrum(time, clock, rough)
    assert frequency[np.argmax(amplitudes(np.ones(100)))] == pytest.approx(3.1, abs=0.02)
    signs = np.concatenate(
        [np.ones((1, 100)), np.random.default_rng(6).choice([-1.0, 1.0], (SIGN_DRAWS // 5, 100))]
    )
    assert line_p(time, clock, rough, signs) < 0.01


def test_a_step_is_looked_for_where_there_are_records():
    time = np.concatenate([np.arange(0.0, 20.0, 0.1), np.arange(3600.0, 3620.0, 0.1)])

    def regress(torques):
        gain = 1.0 / (1.0 + abs(float(time[np.argmax(torques[:, 0] > 0)]) - 7.0))
        return np.array([1.0]), gain

    e = SimpleNamespace(time=time, best=Evidence.best, regress=regress)
    e.best = lambda *given: Evidence.best(e, *given)
    assert effect("disturbance_step").starts(e)[0]["onset"] == pytest.approx(7.0, abs=1.0)


def test_something_is_kept_from_the_search_of_the_shortest_record(case):
    """Five segments of which the only one to keep holds an end of the range, and two, of which none
    is the fourth.
    """
    dataset = case(None).dataset
    length = len(dataset.motion.theta) // len(dataset.segments.counted)
    for count in (5, 2):
        piece = dataset.segments.pieces[0]
        piece = replace(
            piece,
            u=piece.u[: count * length],
            **{k: getattr(piece, k)[:count] for k in ("measured", "initial", "initial_sd")},
        )
        theta, u = np.zeros(count * length), np.zeros(count * length)
        theta[min(3, count - 1) * length] = 1.0
        short = replace(
            dataset,
            segments=replace(dataset.segments, pieces=(piece,)),
            motion=replace(dataset.motion, theta=theta, u=u),
        )
        assert short.held_out.tolist() == [k == min(3, count - 1) for k in range(count)]


@pytest.mark.parametrize(
    ("uneven", "curve", "low", "high"),
    [(0.0, 400.0, 0.19, 0.2), (20.0, 400.0, 0.3, 0.7), (0.0, 0.1, 1.0, 1.0)],
)
def test_an_uneven_likelihood_makes_a_wide_interval(monkeypatch, uneven, curve, low, high):
    """Half the width is where a parabola has fallen by the usual and by twice the unevenness, a
    second at most.
    """
    rng, name = np.random.default_rng(4), "disturbance_step.onset"

    def likelihood(problem, point):
        off = point.values[name] - 5.0
        return SimpleNamespace(total=-0.5 * curve * off**2 + uneven * rng.standard_normal())

    monkeypatch.setattr(intervals, "evaluate", likelihood)
    fit = FitPoint(None, (), {name: 5.0}, None)
    [half] = intervals.parabola_half_widths(None, fit, [Free(name, 0.0, 10.0)]).values()
    assert low <= half <= high


def test_no_interval_leaves_what_a_parameter_may_be(monkeypatch, fabricated):
    free = (
        Free("hard_stop.stiffness", 0.0, 1e9),
        Free("hard_stop.upper", -1e6, 1e6),
        Free("J", 1e-9, 1e9, factor=True),
    )
    fit = SimpleNamespace(
        free=free, values={"hard_stop.stiffness": 0.2, "hard_stop.upper": 0.2, "J": 0.01}
    )
    monkeypatch.setattr(intervals, "covariance", lambda fit: np.eye(3))
    found = {name: each.ci95 for name, each in intervals.estimates(fabricated.model(), fit).items()}
    assert found["hard_stop.stiffness"][0] == 0.0  # a stop does not pull
    assert found["hard_stop.upper"][0] < -1.0
    assert 0.0 < found["J"][0] < 0.001
    assert found["hard_stop.stiffness"][1] > 1.0


@pytest.mark.parametrize(("friction", "lines"), [(0.1, ["J"]), (0.6, ["J", "coulomb.Fc"])])
def test_only_bounds_that_the_records_leave_are_proposed_to_be_widened(fabricated, friction, lines):
    """What ended at a bound only to make up for another one stays inside when that gives way."""
    tight = {f.name: f for f in (Free("J", 0.003, 0.006), Free("coulomb.Fc", 0.01, 0.5))}
    line = bounds.widening(fabricated.model(), tight, {"J": 0.01, "coulomb.Fc": friction})
    assert [name for name in tight if f"{name} near" in said(line)] == lines


def test_nothing_is_proposed_where_the_records_leave_no_bound(fabricated):
    tight = {"J": Free("J", 0.003, 0.006)}
    assert bounds.widening(fabricated.model(), tight, {"J": 0.006}) is None


def test_a_moment_moves_by_seconds_and_a_play_by_factors():
    assert perturbed("disturbance_step.onset", 5.0, 0.1) == pytest.approx(5.1)
    assert perturbed("backlash.play", 0.02, 0.1) == pytest.approx(0.02 * np.exp(0.1))


def test_bristles_as_stiff_as_those_of_every_model_are_no_effect(case):
    servo = case(None).base.servo
    [own] = [f.nominal_value for f in servo.free if f.name == "bristle_damping.stiffness"]
    for name, factor, outdone in (
        ("presliding", 1.01, True),
        ("bristle_damping", 1.01, True),
        ("presliding", 0.5, False),
    ):
        assert servo.adds_nothing(name, {f"{name}.stiffness": factor * own}) is outdone
    assert not servo.adds_nothing("compliance", {"compliance.stiffness": 10 * own})
    with_bristles = replace(
        servo, rigid=False, free=tuple(replace(f, nominal=None) for f in servo.free)
    )  # with such an effect already
    assert not with_bristles.adds_nothing("presliding", {"presliding.stiffness": 10 * own})


def test_bristles_also_begin_as_those_of_the_model(case):
    base = case(None).base
    [start] = bristle_starts(base, "bristle_damping")
    assert start == {
        key: base.fit.values[f"bristle_damping.{key}"] for key in ("stiffness", "damping")
    }
    assert list(bristle_starts(base, "presliding")[0]) == ["stiffness"]
    assert bristle_starts(base, "cogging") == []
    assert (
        bristle_starts(replace(base, servo=replace(base.servo, rigid=False)), "bristle_damping")
        == []
    )


@pytest.mark.parametrize("diverged", [True, False])
def test_where_a_model_diverges_start_values_with_less_dry_friction_are_added(diverged, case):
    made = case("cogging")
    starts = joint_starts_of(SearchContext(made.dataset, made.base), diverged)("cogging")
    half = 0.5 * made.base.fit.values["coulomb.Fc"]
    found = [
        s
        for whole, s in starts
        if whole.get("coulomb.Fc") == half and whole["cogging.periods"] == s["periods"]
    ]
    assert bool(found) is diverged
    assert len(starts) > len(found)  # and as before


@pytest.mark.slow
def test_a_dead_zone_that_holds_most_of_the_input_back_must_be_beyond_doubt(case):
    made = case("dead_zone")
    credible = made.base.servo.credible
    assert credible["dead_zone.width"][1] == pytest.approx(np.median(np.abs(made.dataset.motion.u)))
    found = evaluate_candidates(SearchContext(made.dataset, made.base), ["dead_zone"])
    assert found.best.name == "dead_zone"
    assert required_gain(found.best, credible, found.null) == found.level
    assert (
        required_gain(found.best, {"dead_zone.width": (0.0, 0.01)}, found.null)
        == CERTAIN_LEVELS * found.level
    )


def fitted(name, size, each, n=100):
    """Return a candidate of so many parameters that gains so many nats in each of its segments,
    more or less.
    """
    score = each + 0.5 * np.resize([1.0, -1.0], n)
    total = float(score.sum())
    return EffectFit(
        name,
        SimpleNamespace(
            score=score,
            weight=np.ones(n),
            free=[None] * size,
            total=total,
            penalised=total - 2.3 * size,
        ),
    )


@pytest.mark.parametrize(
    ("ahead", "uneven", "simple"),
    # nats a segment of 100, and their spread
    [(0.03, 0.1, True), (0.08, 0.7, True), (0.08, 0.1, False), (0.30, 0.4, False)],
)
def test_of_two_effects_within_a_standard_error_the_one_with_fewer_parameters_is_named(
    ahead, uneven, simple
):
    """A step soon after the start is nearly a constant torque, and can be moved to where it gains a
    few nats more.
    """
    plain, rich = fitted("bias", 5, 1.0), fitted("disturbance_step", 6, 1.0 + ahead)
    rich.fit.score[:50] += uneven  # where the step is not yet: what the difference is uncertain by
    rich.fit.score[50:] -= uneven
    assert simplest([plain, rich]) is (plain if simple else rich)


@pytest.mark.parametrize(
    ("size", "behind", "uneven", "uniform", "tied"),
    [
        (5, 0.05, 0.0, False, True),
        (5, 0.07, 0.0, False, False),
        (6, 0.03, 0.0, False, False),
        (5, 0.3, 1.0, False, False),
        (5, 0.3, 1.0, True, True),
        (5, 0.3, 0.5, True, False),
    ],
)
def test_what_is_hardly_less_likely_and_no_richer_is_tied(size, behind, uneven, uniform, tied):
    """In uniform motion all that is not behind for certain: here 30 nats, 10 or 5 to within one
    standard error.
    """
    best, other = fitted("bias", 5, 1.0), fitted("gravity", size, 1.0 - behind)
    other.fit.score[:50] += uneven
    other.fit.score[50:] -= uneven
    assert is_tied(best, other, uniform) is tied


@pytest.mark.parametrize(
    ("name", "uneven", "tied"),
    [("gravity", 2.0, True), ("gravity", 0.2, False), ("cogging", 2.0, False)],
)
def test_what_is_in_one_class_is_tied_within_a_standard_error(name, uneven, tied):
    """8 nats behind in 100 segments, of which one half is for the one and the other half for the
    other.
    """
    best, other = fitted("return_spring", 6, 1.0), fitted(name, 6, 0.92)
    other.fit.score[:50] += uneven
    other.fit.score[50:] -= uneven
    assert is_tied(best, other, uniform=False) is tied


SHIPPED = tomllib.loads((Path(__file__).parents[1] / "shipped.toml").read_text(encoding="utf-8"))[
    "effects"
]
LEVEL = 20.0  # nats: what chance gives in a search among all effects, about
FORMS = {
    "compliance": {"hardening": 3000.0},
    "backlash": {"exponent": 1.5},
    "cogging": {"sine3": 0.5, "cosine3": 0.3, "sine4": -0.3, "cosine4": 0.2},
    "load_friction": {"coefficient": 0.1, "falling": 0.3, "speed": 0.3},
    "stribeck": {"exponent": 1.0},
    "hard_stop": {"exponent": 2.0},
    "friction_drift": {"rate": 0.2, "settling": 0.5},
    "gravity": {"sine2": 0.2, "cosine2": -0.2},
    "position_friction": {"sine2": 0.3, "cosine2": 0.2},
    "eccentric_encoder": {"amplitude": 0.03, "sine2": 0.2, "cosine2": 0.15},
}


@pytest.mark.parametrize("name", list(FORMS))
@pytest.mark.long
def test_the_form_of_an_effect_is_fitted_once_it_is_named(case, name):
    """And only where the records call for it; what is left then is what the right form leaves."""
    bending = effect(name).shape_parameters
    usual = {short: value for short, value in FORMS[name].items() if short not in bending}
    ends = []
    for given in (usual, FORMS[name]):
        made = case(name, **given)
        context = SearchContext(made.dataset, made.base)
        found = evaluate_candidates(context, [name])
        ends.append(add_effect(context, found.trials[0], max(LEVEL, found.level)).fit)
    assert not {f"{name}.{short}" for short in bending} & {f.name for f in ends[0].free}
    for short in bending:
        assert ends[1].values[f"{name}.{short}"] == pytest.approx(FORMS[name][short], rel=0.25)


def test_every_form_is_tried():
    assert set(FORMS) == {name for name in SHIPPED if effect(name).shape_starts}


@pytest.mark.long
def test_an_exhaustive_search_finds_what_a_quick_one_does_not(case):
    """A shaft that two start values and few steps miss by thousands of nats; the poor fit is
    noticed.
    """
    made = case("compliance", share=0.25, stiffness=3.0, damping=0.004)
    context = SearchContext(made.dataset, made.base)
    assert propose_effect(context, ["compliance"], QUICK).said.outcome != "added"
    assert needs_exhaustive_search(made.dataset, made.base)
    found = propose_effect(context, ["compliance"], EXHAUSTIVE)
    assert found.said.outcome == "added"
    assert found.said.gain > 1000
    assert search(made.dataset, made.base, SearchOptions()).final.servo.effects == ("compliance",)


@pytest.mark.slow
def test_an_effect_may_be_given_start_values_and_all_effort(case):
    """As a benchmark does that knows the answer: the exhaustive search is made in the first
    pass.
    """
    made = case("compliance", share=0.25, stiffness=3.0, damping=0.004)
    truth = {"share": 0.25, "stiffness": 3.0, "damping": 0.004}
    context = SearchContext(
        made.dataset,
        made.base,
        SearchOptions(start_values={"compliance": [truth]}, exhaustive=("compliance",)),
    )
    assert context.start_values("compliance", context.evidence)[0] is truth
    assert len(context.start_values("bias", context.evidence)) == len(
        effect("bias").starts(context.evidence)
    )
    assert propose_effect(context, ["compliance"], QUICK).said.outcome == "added"


@pytest.mark.long
@pytest.mark.parametrize(
    "truth",
    [
        {"share": 0.3, "play": 0.04, "stiffness": 350.0, "dissipation": 2.3},
        {"share": 0.5, "play": 0.01, "stiffness": 60.0, "friction_share": 0.8},
        {"share": 0.3, "play": 0.01, "stiffness": 60.0, "friction_share": 0.44},
    ],
    ids=["far off", "most friction behind", "light and rubbing"],
)
def test_a_contact_is_found_because_its_load_is_initialised(case, truth):
    """From start values that are far off, in few steps, nearly as well as from the truth: unless
    the load is placed, 15 % worse; and wherever the friction is.
    """
    made = case("backlash", **truth)
    known = SearchContext(
        made.dataset, made.base, SearchOptions(start_values={"backlash": [truth]})
    )
    best = propose_effect(known, ["backlash"], QUICK)
    found = propose_effect(SearchContext(made.dataset, made.base), ["backlash"], QUICK)
    assert found.said.outcome == "added"
    assert found.said.gain > 800
    # contacts amplify rounding: 0.0378 after the few steps of a quick search with another version
    # of the linear algebra
    assert found.best.fit.values["backlash.play"] == pytest.approx(truth["play"], rel=0.1)
    assert found.said.gain > 0.9 * best.said.gain


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eccentric_encoder", "torque_ripple", "dead_zone"])
def test_a_candidate_is_no_less_likely_than_the_model_in_it(case, name):
    """Beside gravity that is missing; from start values that the residual suggests alone, 5 to 80
    nats less.
    """
    made = case("gravity")
    context = SearchContext(made.dataset, made.base)
    [tried], _ = fit_candidates(context, [name], QUICK)
    assert tried.gain_over(context.fit) > -2


def test_a_model_that_lacks_nothing_fits_well(case):
    made = case(None)
    assert not needs_exhaustive_search(made.dataset, made.base)


@pytest.mark.slow
def test_an_effect_is_rejected_only_after_another_shape_was_tried(case):
    """A disc with a second harmonic: with the usual shape made too small by hand, the other one is
    added.
    """
    made = case("eccentric_encoder", **FORMS["eccentric_encoder"])
    context = SearchContext(made.dataset, made.base)
    found = evaluate_candidates(context, ["eccentric_encoder"])
    assert "eccentric_encoder.sine2" not in [f.name for f in found.best.fit.free]
    small = replace(
        found,
        best=replace(found.best, assessment=replace(found.best.assessment, error_reduction=1.1)),
    )
    decided = decide(context, small)
    assert decided.said.outcome == "added"
    assert decided.best.fit.values["eccentric_encoder.sine2"] == pytest.approx(0.2, rel=0.25)


@pytest.mark.sampled(4)
def test_an_effect_that_is_too_small_in_any_shape_is_rejected(case):
    made = case("bias")
    context = SearchContext(made.dataset, made.base)
    found = evaluate_candidates(context, ["bias"])
    assert decide(context, found).said.outcome == "added"
    small = replace(
        found,
        best=replace(found.best, assessment=replace(found.best.assessment, error_reduction=1.1)),
    )
    assert retry_with_shape(context, small) is small
    rejected = decide(context, small)
    assert (rejected.said.outcome, rejected.said.ties) == ("rejected", ())
    assert "significant, but lowers the squared error too little" in said(rejected.said.decision)


@pytest.mark.parametrize(("exponent", "moves"), [(1.0, False), (1.5, True)])
def test_a_coupling_that_the_model_has_keeps_its_usual_form(case, exponent, moves):
    made = case("backlash")
    given = {p.name.removeprefix("backlash."): p.default for p in effect("backlash").parameters} | {
        "exponent": exponent
    }
    servo, _ = base_servo_of(replace(made.model, effects={"backlash": given}), made.dataset)
    assert ("backlash.exponent" in [f.name for f in servo.free]) is moves
    assert "backlash.play" in [f.name for f in servo.free]


@pytest.mark.slow
def test_a_further_effect_is_added_only_where_its_strength_is_known(
    case, monkeypatch, search_among
):
    """The first one is, too, where it is not, but not nothing: that is said in the headline."""
    made = case("gravity")
    search_among("gravity", "bias")
    context = SearchContext(made.dataset, made.base, SearchOptions())
    outcomes = {}
    for reach in (0.3, 0.7, 1.5):  # of the interval, over the strength
        monkeypatch.setattr(
            stepwise, "strength_is_known", lambda *_, share, reach=reach: reach < share
        )
        for further in (True, False):
            outcomes[reach, further] = propose_effect(
                context, ["gravity", "bias"], QUICK, further
            ).said.outcome
    assert [
        reach for (reach, further), outcome in outcomes.items() if further and outcome == "added"
    ] == [0.3]
    assert [
        reach
        for (reach, further), outcome in outcomes.items()
        if not further and outcome == "added"
    ] == [0.3, 0.7]
    assert {key: outcome for key, outcome in outcomes.items() if outcome != "added"} == {
        (0.7, True): "rejected",
        (1.5, True): "rejected",
        (1.5, False): "limit",
    }


@pytest.mark.parametrize(
    ("value", "ends", "bound", "known"),
    [
        (2.0, (1.1, 3.9), False, True),
        (2.0, (1.9, 4.1), False, False),
        (2.0, (0.9, 2.1), False, False),
        (5.0, (4.9, 5.1), True, False),
    ],
)
def test_a_strength_is_known_where_both_ends_of_its_interval_are_near(
    monkeypatch, value, ends, bound, known
):
    free = (Free("J", 0.0, 1.0), Free("gravity.amplitude", 0.0, 5.0))
    fit = SimpleNamespace(free=free, values={"J": 0.5, "gravity.amplitude": value})
    monkeypatch.setattr(intervals, "intervals", lambda *_: [(0.0, 9.0), ends])
    assert free[1].at_bound(value) is bound
    assert intervals.strength_is_known(fit, None, "gravity", 0.5) is known
    assert intervals.strength_is_known(
        SimpleNamespace(free=free[:1], values={"J": 0.5}), None, "gravity", 0.5
    )


@pytest.mark.parametrize(("size", "known"), [(0.1, True), (0.001, False)])
def test_losses_that_may_each_be_nothing_are_known_where_both_are_not(monkeypatch, size, known):
    """Their errors are opposed: only their sum is known."""
    free = (Free("J", 0.0, 1.0), Free("gear_loss.driving", 0, 1), Free("gear_loss.driven", 0, 1))
    fit = SimpleNamespace(free=free, values={f.name: size for f in free})
    spread = np.array([[1.0, 0.0, 0.0], [0.0, 0.04, -0.0399], [0.0, -0.0399, 0.04]])
    monkeypatch.setattr(intervals, "covariance", lambda _: spread)
    assert intervals.strength_is_known(fit, None, "gear_loss", 1.0) is known
    unsure, sure = Estimate(0.1, "1", (0.0, 0.3)), Estimate(0.1, "1", (0.08, 0.12))
    losses = [
        Named("gear_loss", "", {"driving": unsure, "driven": x}, 9.0, 0.1) for x in (unsure, sure)
    ]
    assert [each.known_within(1.0) for each in losses] == [False, True]


@pytest.mark.parametrize(("ends", "known"), [((0.0, 0.04), False), ((0.019, 0.021), True)])
def test_a_backlash_is_known_by_its_play(monkeypatch, ends, known):
    """With none it is a shaft, however well the inertia behind it is known."""
    free = (Free("backlash.share", 0.02, 0.9), Free("backlash.play", 0.0, 5.0))
    fit = SimpleNamespace(free=free, values={"backlash.share": 0.5, "backlash.play": 0.02})
    monkeypatch.setattr(intervals, "intervals", lambda *_: [(0.49, 0.51), ends])
    assert intervals.strength_is_known(fit, None, "backlash", 0.5) is known
