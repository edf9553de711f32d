"""Effects as candidates: each refitted by simulation together with the model, and the null
distribution of their gains.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bristle.common.deadline import within
from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.diagnosis.answer import Assessment, CandidateEffect, Finding, Reason, finding
from bristle.diagnosis.estimation.initial_states import (
    REFINEMENT_STEPS,
    initialise_load,
    refine_initial_states,
)
from bristle.diagnosis.estimation.likelihood import Fit, FitPoint, evaluate, rescored
from bristle.diagnosis.estimation.optimiser import (
    FIT_ITERATIONS,
    ROUGH_STOP_GAIN,
    refit_nonsmooth,
    refit_rescored,
    value_under_noise,
)
from bristle.diagnosis.estimation.simulator import Simulator
from bristle.diagnosis.free_parameter import free_parameters
from bristle.diagnosis.localisation.residual_response import directions
from bristle.diagnosis.selection.null_distribution import Null, largest_gain
from bristle.diagnosis.selection.start_values import SearchContext, bristle_starts
from bristle.diagnosis.sliding.screen import Start
from bristle.plant.controller import CONTROLLER
from bristle.plant.effects import effect as find_effect

Trial = tuple[float, Fit]  # predicted log-likelihood [nats] and the fit at a start value
# most repetitions of the steps of a candidate that is still below the model without it, but rising
CLIMB_REPEATS = 4
OUT_OF_TIME = finding(Reason.OUT_OF_TIME)  # why an effect was not tried, or not to the end
# nats: predicted gain of an effect that has no influence at its start values
INERT_GAIN = (-20.0, 2.0)
# nats: a contact that is predicted to stay this far below the model without it is not refitted
CONTACT_DEFICIT = 1000.0
# start values of a searched frequency that are refitted where the model fits poorly
WAVE_STARTS = 8
# start values of a contact whose load is initialised before they are compared
LOAD_STARTS_TRIED = 8
# of the null's level: least predicted gain of a candidate that is refitted to the end
HOPEFUL_LEVELS = 0.2
MOST_REFITTED = 6  # most candidates that are refitted to the end
FOLLOWED_SHARE = 0.1  # of the best predicted gain: least of one that is refitted to the end


@dataclass(frozen=True)
class Effort:
    """How far candidates are refitted before the best are chosen."""

    starts: int  # start values that are refitted
    steps: int  # steps of such a refit
    exhaustive: bool  # refit all of these start values, also where no gain is predicted


QUICK = Effort(2, 2, False)
EXHAUSTIVE = Effort(14, 25, True)


@dataclass(frozen=True)
class EffectFit:
    """An effect fitted to the records together with the model."""

    name: str
    fit: Fit | None  # None if the effect could not be tried; `reason` says why
    # (segments, bins, k): directions of the residual that each start value can explain
    directions: tuple[Array, ...] = ()
    predicted: float = -np.inf  # log-likelihood that the next step predicts [nats]
    other_starts: tuple[Fit, ...] = ()  # further start values
    reason: Finding | None = None
    # of a candidate that was compared with others above the null's level
    assessment: Assessment | None = None

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.fit.free) if self.fit else 0

    @property
    def penalised_likelihood(self) -> float:
        """Log-likelihood less half the Bayesian information criterion's penalty [nats]."""
        return -np.inf if self.fit is None else self.fit.penalised

    def reported(self, null: Null, base: float) -> CandidateEffect:
        """Return what is reported of it; `base` is the log-likelihood without it [nats]."""
        gain = self.fit.total - base if self.fit else math.nan
        level = null.level(self.name)
        return CandidateEffect(self.name, gain, level, self.reason, self.assessment)

    def gain_over(self, fit: Fit) -> float:
        """Return by how much it is likelier than another fit under the same noise [nats]."""
        return self.fit.total - fit.total if self.fit else -np.inf

    def inside_limits(self, limits: Mapping[str, tuple[float, float]]) -> bool:
        """False where a parameter ends at a limit of the records: it is a stand-in then."""
        assert self.fit is not None
        free = {f.name for f in self.fit.free} & set(limits)
        ends = [
            (self.fit.values[name], end)
            for name in free
            for end in limits[name]
            if np.isfinite(end)
        ]
        return not any(abs(value - end) <= 1e-6 * (1 + abs(end)) for value, end in ends)

    def credible(self, ranges: Mapping[str, tuple[float, float]]) -> bool:
        """True if its own parameters lie in the intervals of those that have one."""
        assert self.fit is not None
        own = {name: ends for name, ends in ranges.items() if name.startswith(f"{self.name}.")}
        return all(low <= self.fit.values[name] <= high for name, (low, high) in own.items())


def _beside(effects: Sequence[str]) -> str:
    """Return what progress says of the effects that a model has."""
    present = ", ".join(name for name in effects if name != CONTROLLER.name)
    return f" beside {present}" if present else ""


def fit_candidates(
    context: SearchContext, names: Sequence[str], effort: Effort, done: Sequence[EffectFit] = ()
) -> tuple[list[EffectFit], Null]:
    """Return the named effects, the most promising refitted to the end, and the null; those that
    are `done` as they are.
    """
    context.prepare()
    begun: list[str] = []
    known = {c.name: c for c in done}
    beside = _beside(context.fitted.servo.effects)

    def screened(name: str) -> EffectFit:
        if name in known:
            return known[name]
        if context.options.late:
            return EffectFit(name, None, reason=OUT_OF_TIME)
        begun.append(name)
        share = (len(begun) - 1) / max(len(names), 1)
        context.options.progress(f"{name}{beside}", share)
        return in_time(lambda: _screened(context, name, effort), EffectFit(name, None))

    def in_time(candidate: Callable[[], EffectFit], otherwise: EffectFit) -> EffectFit:
        return within(context.options.deadline, candidate) or replace(otherwise, reason=OUT_OF_TIME)

    # all effects are fitted roughly
    cheap_first = sorted(names, key=lambda name: bool(find_effect(name).coupling))
    by_name = dict(zip(cheap_first, context.options.map(screened, cheap_first), strict=True))
    tried = [by_name[name] for name in names]
    if not any(c.fit for c in tried):
        return tried, Null(np.zeros(1), {})
    if effort is QUICK and find_effect(max(tried, key=lambda c: c.predicted).name).free_play:
        # a shaft that hardens resembles free play, but needs more steps to be found
        stiff = {
            c.name
            for c in tried
            if c.fit and find_effect(c.name).coupling and not find_effect(c.name).free_play
        }
        tried = context.options.map(
            lambda c: (
                in_time(lambda: _screened(context, c.name, EXHAUSTIVE), c) if c.name in stiff else c
            ),
            tried,
        )
    # the most promising ones are refitted to the end
    null = _null(context, tried)
    chosen = _most_promising(context, tried, null)
    if not chosen:
        return tried, null
    tried = context.options.map(
        lambda c: in_time(lambda: refit_to_end(context, c), c) if c.name in chosen else c, tried
    )
    return tried, _null(context, tried)


def _screened(context: SearchContext, name: str, effort: Effort) -> EffectFit:
    """Return an effect after a few steps from its best start values."""
    if name in context.dataset.excluded:
        return EffectFit(name, None, reason=context.dataset.excluded[name])
    effort = EXHAUSTIVE if name in context.options.exhaustive else effort
    candidate = evaluate_starts(context, name, effort)
    if not candidate.fit:
        return candidate
    return _from_nothing(context, advance_candidate(context, candidate, effort), effort)


def _from_nothing(context: SearchContext, candidate: EffectFit, effort: Effort) -> EffectFit:
    """Return a candidate that is less likely than the model without it from where it does nothing,
    if that leads further: a model is never less likely than one that it contains.
    """
    fit, effect = candidate.fit, find_effect(candidate.name)
    assert fit is not None
    if context.fit.total - fit.total < ROUGH_STOP_GAIN:
        return candidate
    off = effect.by_full_name(effect.off) or {effect.strength.name: 0.0}
    values = {**fit.values, **context.fit.values, **off}
    values |= {f.name: f.clip(values[f.name]) for f in fit.free}
    begun = evaluate(context.fitted.problem, fit.at(values, context.fit.initial))
    predicted, near = _advanced(context, begun, effort.steps, 1)
    return (
        replace(candidate, fit=near, predicted=predicted) if near.total > fit.total else candidate
    )


def _most_promising(context: SearchContext, tried: Sequence[EffectFit], null: Null) -> set[str]:
    """Return the names of the candidates that are refitted to the end."""
    least = context.fit.total
    hopeful = [
        c for c in tried if c.fit and c.predicted - least > HOPEFUL_LEVELS * null.level(c.name)
    ]
    hopeful = sorted(hopeful, key=lambda c: -c.predicted)[:MOST_REFITTED]
    return {
        c.name
        for c in hopeful
        if c.predicted - least > FOLLOWED_SHARE * (hopeful[0].predicted - least)
    }


def _null(context: SearchContext, tried: Sequence[EffectFit]) -> Null:
    """Return the null of the largest gain; what the best candidate explains is not noise."""
    fitted = [c for c in tried if c.fit is not None]
    best = max(fitted, key=lambda c: c.penalised_likelihood)
    assert best.fit is not None
    white = rescored(context.fitted.problem, best.fit).white
    residual = context.response.freed(white[:, :, None])[:, :, 0]
    return largest_gain(
        {c.name: c.directions for c in fitted}, residual, context.fit.weight
    ).after_refits()


# -- start values ----------------------------------------------------------------------------------
def evaluate_starts(context: SearchContext, name: str, effort: Effort) -> EffectFit:
    """Return an effect at the start value with the largest predicted gain, and the next best."""
    fit = context.fit
    trials, explained = [], []
    for times in context.clocks(name):
        try:
            simulator = context.fitted.servo.simulator(fit.simulator.segments.timed(times), (name,))
        except BristleError as error:
            return EffectFit(name, None, reason=finding(Reason.REFUSED, why=str(error)))
        for start in (
            *context.start_values(name, context.evidence_at(times)),
            *bristle_starts(context.fitted, name),
        ):
            values = {f"{name}.{k}": v for k, v in start.items()}
            first = fit_at(context, simulator, name, start, (values, fit.initial))
            explained.append(
                _explained(
                    context, first, len(first.free) - len(context.fitted.servo.free_beside(name))
                )
            )
            trials.append(value_under_noise(first, context.screening_noise))
    for joint in (
        context.joint_starts(name)
        if simulator.segments.times == context.dataset.segments.times
        else ()
    ):
        alone = {key: value for key, value in joint.values.items() if key.startswith(f"{name}.")}
        # with the parameters of the sliding motion, and with those of the simulated model: either
        # may be closer
        for place in ((joint.values, context.fitted.problem.initial), (alone, fit.initial)):
            trials.append(
                value_under_noise(
                    fit_at(context, simulator, name, joint.own, place), context.screening_noise
                )
            )
    trials = _with_load_initialised(context, name, sorted(trials, key=lambda trial: -trial[0]))
    wave = context.fits_poorly and bool(find_effect(name).periods)
    (predicted, best), *rest = trials[: max(effort.starts, WAVE_STARTS if wave else 0)]
    return EffectFit(name, best, tuple(explained), predicted, tuple(fit for _, fit in rest))


def fit_at(
    context: SearchContext,
    simulator: Simulator,
    name: str,
    start: Start,
    place: tuple[Mapping[str, float], Array],
) -> Fit:
    """Return the model with an effect at some parameter values and initial states (`place`), before
    any step.

    The initial states of a load with free play are refined, since they were fitted without the
    effect.
    """
    problem, fit, servo = context.fitted.problem, context.fit, context.fitted.servo
    values, states = place
    free = (*servo.free_beside(name), *free_parameters(name, start, servo.limits))
    defaults = {p.name: p.default for p in find_effect(name).parameters} | find_effect(
        name
    ).inactive_values
    whole = {**defaults, **fit.values, **values}
    inside = {f.name: f.clip(whole[f.name]) for f in free}
    steps = REFINEMENT_STEPS if fit.simulator.play else 0
    return refine_initial_states(
        problem, evaluate(problem, FitPoint(simulator, free, whole | inside, states)), steps
    )


def _explained(context: SearchContext, fit: Fit, count: int) -> Array:
    """Return the directions of the residual that an effect's `count` parameters and its mere
    presence can explain.
    """
    response, plain = context.response, context.fit
    present = (fit.white - plain.white)[:, :, None]
    columns = np.concatenate([fit.by_parameter[:, :, -count:], present], axis=2)
    usable = np.isfinite(columns).all(axis=(1, 2), keepdims=True)
    return directions(
        response.free_of_model(response.freed(np.where(usable, columns, 0.0))), plain.weight
    )


def _with_load_initialised(context: SearchContext, name: str, trials: list[Trial]) -> list[Trial]:
    """Return the trials of a contact once more with its load placed where each segment is
    likeliest; others as they are.
    """
    least = context.fit.total - CONTACT_DEFICIT
    if not (find_effect(name).free_play and trials[0][0] > least):
        return trials
    problem = context.fitted.problem
    near = [fit for predicted, fit in trials[:LOAD_STARTS_TRIED] if predicted > least]
    placed = [
        value_under_noise(initialise_load(problem, fit), context.screening_noise) for fit in near
    ]
    return sorted(placed, key=lambda trial: -trial[0])


# -- refits ----------------------------------------------------------------------------------------
def advance_candidate(context: SearchContext, candidate: EffectFit, effort: Effort) -> EffectFit:
    """Take steps from the best start values and keep the better result; from one only where no gain
    is predicted.

    An effect without influence at its start values is not moved, unless it switches.
    """
    assert candidate.fit is not None
    contact, gain = find_effect(candidate.name).free_play, candidate.predicted - context.fit.total
    inert = (
        INERT_GAIN[0] < gain < INERT_GAIN[1]
        and not contact
        and not find_effect(candidate.name).nonsmooth
    )
    if (inert and not effort.exhaustive) or (contact and gain < -CONTACT_DEFICIT):
        return replace(candidate, other_starts=())
    several = (
        candidate.other_starts
        if effort.exhaustive or gain > 0 or candidate.fit.simulator.play
        else ()
    )
    ends = [
        _advanced(context, fit, effort.steps, 1 if contact else CLIMB_REPEATS)
        for fit in (candidate.fit, *several)
    ]
    predicted, fit = max(ends, key=lambda end: end[0])
    return replace(candidate, fit=fit, predicted=predicted, other_starts=())


def _advanced(context: SearchContext, fit: Fit, steps: int, repeats: int) -> Trial:
    """Return a fit after steps, repeated while they gain half of what is lacking to the model
    without the effect.
    """
    for _ in range(repeats):
        before, fit = fit.total, refit_rescored(fit, context.screening_noise, steps)
        if not 0 < context.fit.total - fit.total < 2 * (fit.total - before):
            break
    if not fit.simulator.play:
        return value_under_noise(fit, context.screening_noise)
    # a load with free play is initialised anew; predictions of further steps do not hold for it
    fit = initialise_load(context.screening_noise(fit), fit, REFINEMENT_STEPS)
    fit = rescored(context.screening_noise(fit), fit)
    return fit.total, fit


def refit_to_end(context: SearchContext, candidate: EffectFit) -> EffectFit:
    """Refit a candidate; an effect that switches under the noise of its own residual."""
    if candidate.fit is None:
        return candidate
    fit = refit_rescored(candidate.fit, context.screening_noise, FIT_ITERATIONS)
    fit = refit_nonsmooth(fit, context.own_noise, (candidate.name,))
    return replace(candidate, fit=rescored(context.screening_noise(fit), fit))
