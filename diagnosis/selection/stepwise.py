"""The stepwise search: candidates, the null of the largest gain, addition and removal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.checks.input_hold import must_be_held
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import (
    FittedModel,
    balanced_model,
    fits_poorly,
    has_diverged,
    has_outliers_or_disturbance,
    reduced_friction_start,
    under_own_noise,
)
from bristle.diagnosis.estimation.likelihood import Fit, Point, Problem, evaluate, rescored
from bristle.diagnosis.estimation.simulator import has_free_play
from bristle.diagnosis.localisation.residual_localisation import SENSOR_VIEWS, views_of
from bristle.diagnosis.localisation.residual_response import ResidualResponse, response_of
from bristle.diagnosis.selection.candidates import EXHAUSTIVE, QUICK, Candidate, Effort, advance_candidate, refit_to_end
from bristle.diagnosis.selection.criterion import AGREED_NATS, CERTAIN_LEVELS, CLEAR_LEVELS, SearchRound, accept_or_reject, group
from bristle.diagnosis.selection.discretisation import numerical
from bristle.diagnosis.selection.null_distribution import Null, largest_gain
from bristle.diagnosis.selection.refinement import (
    STRONG_FALL,
    STRONG_SHARE,
    SURE_LEVELS,
    add_effect,
    backward_elimination,
    mends_form,
    refit_shape,
    with_candidate,
)
from bristle.diagnosis.selection.start_values import Start, evaluate_starts, evidence, joint_starts, start_values
from bristle.plant.effect import Evidence
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects

Array = NDArray[np.float64]
Tell = Callable[[str, float], None]
MOST_EFFECTS = 4  # effects that are added
STRUCTURE_P = 0.05  # p of a view that calls for another round
HOPEFUL_LEVELS = 0.6  # of the null's level: a candidate that promises less after one step is not followed
MOST_REFITTED = 6  # candidates that are refitted to the end: those that promise most after the first steps,
FOLLOWED_SHARE = 0.1  # and this share of what the best one promises
FURTHER_FALL = (
    1.6  # a further effect lowers the error so, and shows anything on segments kept from the search or is local (of effects
)
SURE_SHARE = 0.25  # FIXME or gains so many times the level and this share, and `AGREED_NATS` on segments kept from the search,
HELD_OUT_FALL, HELD_OUT_NATS = 1.5, 15.0  # or so, or gains this share, and gains so many nats on segments kept from the search
ALIKE = "several effects explain it alike"
STRENGTH_FACTORS = (1.0, 1.6)  # what a linear response says of a strength is too little where the model runs away from the records


def evaluate_candidates(
    dataset: Dataset, fitted: FittedModel, names: Sequence[str], tell: Tell, effort: Effort = QUICK
) -> SearchRound:
    """Try the named effects on top of a fitted servo."""
    fit = fitted.fit
    tried, null = _tried(dataset, fitted, names, tell, effort)
    reached = [c for c in tried if c.fit is not None and not fitted.servo.outdone(c.name, c.fit.values)]
    if not reached:
        return SearchRound(tuple(tried), null, fit.total, None, 0.0, 1.0, (), "no effect can join this model")
    best = max(reached, key=lambda c: c.merit)
    times = {c.name: 1.0 if c.within(fitted.servo.credible) else CERTAIN_LEVELS for c in reached}
    beyond = [c for c in reached if c.gain_over(fit) > times[c.name] * null.level(c.name)]
    if not beyond or best.merit <= Candidate("", fit).merit:
        return SearchRound(tuple(tried), null, fit.total, None, best.gain_over(fit), 1.0, (), "no gain above what chance gives")
    return accept_or_reject(dataset, fitted, tried, beyond, null)


def _tried(dataset: Dataset, fitted: FittedModel, names: Sequence[str], tell: Tell, effort: Effort) -> tuple[list[Candidate], Null]:
    """Return the named effects refitted as far as they are promising, and the null of the largest gain."""
    fit, response, far = fitted.fit, response_of(fitted, dataset), fits_poorly(dataset, fitted.fit)
    e = evidence(dataset.motion, response, fit, dataset.resolution, dataset.turn)
    together = _together(dataset, fitted, e) if far else lambda name: ()

    def quiet(left: Fit) -> Problem:
        return under_own_noise(dataset, left) if far and left.weight.any() else fitted.problem

    def followed(name: str, effort: Effort) -> Candidate:
        if name in dataset.excluded:
            return Candidate(name, None, refused=dataset.excluded[name])
        begun = evaluate_starts(fitted.problem, fitted.servo, name, fit, response, e, quiet, together(name), far, effort)
        return advance_candidate(begun, quiet, fit.total, effort) if begun.fit else begun

    tried = []
    for i, name in enumerate(names):
        tell(name, i / max(len(names), 1))
        tried.append(followed(name, effort))
    if not any(c.fit for c in tried):
        return tried, Null(np.zeros(1), {})
    if effort is QUICK and has_free_play(max(tried, key=lambda c: c.promised).name):  # what rattles may be a shaft that hardens
        tried = [
            followed(c.name, EXHAUSTIVE) if c.fit and find_effect(c.name).coupling and not has_free_play(c.name) else c
            for c in tried
        ]
    null = _null(fitted.problem, response, fit, tried)
    hopeful = [c for c in tried if c.fit and c.promised - fit.total > HOPEFUL_LEVELS * null.level(c.name)]
    if not hopeful:
        return tried, null
    hopeful = sorted(hopeful, key=lambda c: -c.promised)[:MOST_REFITTED]
    chosen = {c.name for c in hopeful if c.promised - fit.total > FOLLOWED_SHARE * (hopeful[0].promised - fit.total)}
    tried = [refit_to_end(c, quiet, partial(under_own_noise, dataset)) if c.name in chosen else c for c in tried]
    return tried, _null(fitted.problem, response, fit, tried)


def _together(dataset: Dataset, fitted: FittedModel, e: Evidence) -> Callable[[str], Sequence[Start]]:
    """Return what gives the starts of an effect together with the model, where the model's own fit is far off.

    They balance the torques along the measured motion or, where the law has a memory, start from the nominal model: one
    that was fitted without what is missing has bent its parameters to make up for it. Where it runs away, they start from
    less dry friction too, where `e`, what the fitted model leaves, says.
    """
    balanced = balanced_model(dataset, fitted)
    given = partial(joint_starts, dataset, balanced) if balanced.models else _from_nominal(dataset, fitted)
    less = reduced_friction_start(fitted)
    if not (less and has_diverged(dataset, fitted.fit)):
        return given
    return lambda name: [*given(name), *_jointly(less, name, start_values(name, e))]


def _from_nominal(dataset: Dataset, fitted: FittedModel) -> Callable[[str], Sequence[Start]]:
    """Return what gives the starts of an effect together with the nominal model."""
    nominal = {f.name: f.nominal_value for f in fitted.servo.free if f.nominal is not None}
    values = {**fitted.fit.values, **nominal}
    plain = evaluate(fitted.problem, Point(fitted.fit.simulator, (), values, fitted.problem.initial))  # none to make up for it
    e = evidence(dataset.motion, response_of(replace(fitted, fit=plain), dataset), plain, dataset.resolution, dataset.turn)

    def begun(name: str) -> list[Start]:
        first = find_effect(name).parameters[0].name.removeprefix(f"{name}.")
        several = [s | {first: factor * s[first]} for s in start_values(name, e) for factor in STRENGTH_FACTORS if first in s]
        return _jointly(nominal, name, several)

    return begun


def _jointly(values: Mapping[str, float], name: str, several: Sequence[Mapping[str, float]]) -> list[Start]:
    """Return starts of an effect, each together with values of the model."""
    return [({**values, **{f"{name}.{k}": v for k, v in s.items()}}, s) for s in several]


def _null(problem: Problem, response: ResidualResponse, fit: Fit, tried: Sequence[Candidate]) -> Null:
    """Return the null of the largest gain; what the best candidate explains does not count as noise."""
    reached = [c for c in tried if c.fit is not None]
    leader = max(reached, key=lambda c: c.merit)
    assert leader.fit is not None
    rest = response.freed(rescored(problem, leader.fit).white[:, :, None])[:, :, 0]
    return largest_gain({c.name: c.banks for c in reached}, rest, fit.weight)


def residual_has_structure(fitted: FittedModel, dataset: Dataset, verdict: SearchRound, taken: set[str]) -> bool:
    """True if a view shows something in the residual, or the directions of an effect that was tried before."""
    if any(share.p <= STRUCTURE_P and share.view not in SENSOR_VIEWS for share in views_of(fitted, dataset)):
        return True
    response, classes = response_of(fitted, dataset), {group(name) for name in taken}
    for c in verdict.candidates:
        for bank in c.banks if group(c.name) not in classes else ():
            score = np.einsum("s,snk,sn->k", response.weight, bank, response.rest, optimize=True)
            if 0.5 * float(score @ score) > HOPEFUL_LEVELS * verdict.null.level(c.name):
                return True
    return False


def worth_adding(verdict: SearchRound, first: float) -> bool:
    """True if a further effect is more than a mend of the form of what was added; `first` is the gain of the first [nats].

    Another effect lowers much of what is left, on segments kept from the search too; what mends a form does so in places.
    """
    assert verdict.best is not None
    level = verdict.null.level(verdict.best.name)
    if (
        verdict.size >= FURTHER_FALL
        and verdict.gain > CLEAR_LEVELS * level
        and (verdict.kept > 0 or find_effect(verdict.best.name).sparse)
    ):
        return True
    if verdict.gain >= max(SURE_LEVELS * level, SURE_SHARE * first) and verdict.kept >= AGREED_NATS:
        return True
    strong, holds = verdict.gain >= STRONG_SHARE * first, verdict.kept >= HELD_OUT_NATS
    return (strong and (holds or (verdict.size >= STRONG_FALL and verdict.kept > 0))) or (holds and verdict.size >= HELD_OUT_FALL)


def poor_fit(dataset: Dataset, fitted: FittedModel) -> bool:
    """True if a servo is far off, and not because a contact rattles: that is worth patience, if the motion tells effects apart."""
    return (
        has_outliers_or_disturbance(dataset, fitted.fit)
        and not dataset.poor_excitation
        and not any(has_free_play(name) for name in fitted.servo.effects)
    )


def propose_effect(
    dataset: Dataset, fitted: FittedModel, names: Sequence[str], first: float | None, tell: Tell, effort: Effort
) -> tuple[SearchRound, str]:
    """Look for a further effect, and return what was found and why it is not added, if it is not.

    `first` is the gain of the first effect [nats], None where this would be the first.
    """
    verdict = evaluate_candidates(dataset, fitted, names, tell, effort)
    best = verdict.best
    if best is None or verdict.decision:
        return verdict, verdict.decision
    if not (verdict.large and verdict.proven):
        verdict = retry_with_shape(dataset, fitted, verdict)
        best = verdict.best or best
    if not (verdict.large and verdict.proven):
        return replace(verdict, ties=()), f"'{best.name}' {_short(verdict, best)}"
    if first is not None and (mends_form(dataset, fitted, best) or not worth_adding(verdict, first)):
        return replace(verdict, ties=()), f"'{best.name}' may only mend the form of what was added"
    if any(group(name) != group(best.name) for name in verdict.ties):
        return verdict, ALIKE
    if verdict.finer is not None and numerical(verdict.gain, verdict.finer, verdict.null.level(best.name)):
        return verdict, f"'{best.name}' is numerical: its gain vanishes with finer steps of the simulation"
    return verdict, ""


def _short(verdict: SearchRound, best: Candidate) -> str:
    """Return what an effect lacks that is not large or not proven."""
    if verdict.gain <= verdict.null.level(best.name):
        return "gains no more than chance gives, under the noise that it leaves"
    return "is of no help on segments kept from the search" if verdict.large else "is certain but small"


def retry_with_shape(dataset: Dataset, fitted: FittedModel, verdict: SearchRound) -> SearchRound:
    """Return what is found if the best candidate may take another form than its usual one; the same if that gains too little.

    A form that is not quite right does good here and harm there.
    """
    best = verdict.best
    assert best is not None
    level = verdict.null.level(best.name)
    begun = with_candidate(fitted, dataset, best)
    end = refit_shape(begun, dataset, best.name, level)
    if end is begun:
        return verdict
    tried = [replace(c, fit=end.fit) if c.name == best.name else c for c in verdict.candidates]
    return accept_or_reject(dataset, fitted, tried, [c for c in tried if c.test is not None], verdict.null)


def search(dataset: Dataset, base: FittedModel, tell: Tell) -> tuple[FittedModel, list[SearchRound]]:
    """Add effects one after the other as long as one is found that is certain and large enough.

    Raises `NotHeldError` where the input that was not held would have to be explained by effects.
    """
    fitted = base
    rounds: list[SearchRound] = []
    taken = set(base.servo.effects)
    while True:
        must_be_held(dataset, fitted)
        classes = {group(name) for name in taken}
        names = [name for name in all_effects() if group(name) not in classes]
        first = rounds[0].gain if rounds else None
        verdict, why = propose_effect(dataset, fitted, names, first, tell, QUICK)
        if why and why != ALIKE and verdict.candidates and poor_fit(dataset, fitted):
            verdict, why = propose_effect(dataset, fitted, names, first, tell, EXHAUSTIVE)
        best = verdict.best
        if why or best is None:
            rounds.append(replace(verdict, decision=why))
            break
        level = verdict.null.level(best.name)
        fitted = add_effect(fitted, dataset, best, level)
        taken.add(best.name)
        fitted, spared = backward_elimination(fitted, dataset, base, verdict.gain, level)
        dropped = f"; {', '.join(spared)} dropped: not needed any more" if spared else ""
        rounds.append(replace(verdict, decision=f"'{best.name}' added{dropped}", named=True))
        if len(taken) - len(base.servo.effects) >= MOST_EFFECTS or dataset.poor_excitation:
            break
        if not residual_has_structure(fitted, dataset, rounds[-1], taken):
            rounds[-1] = replace(rounds[-1], decision=f"{rounds[-1].decision}; no view and no effect shows anything beside")
            break
    return fitted, rounds
