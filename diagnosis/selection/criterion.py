"""The criterion by which effects, further ones and other shapes of them are accepted, the order of
candidates, and ties.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.answer import Assessment, Finding, Round
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import TIE_NATS, refit_with_noise
from bristle.diagnosis.estimation.likelihood import Fit, Problem, squares
from bristle.diagnosis.estimation.optimiser import ROUGH_STOP_GAIN, refit, refit_nonsmooth, resume
from bristle.diagnosis.selection.candidates import EffectFit
from bristle.diagnosis.selection.effect_size import fall, gain_error, predictive_density
from bristle.diagnosis.selection.null_distribution import Null
from bristle.diagnosis.selection.start_values import SearchContext
from bristle.plant.effects import effect as find_effect

# of the best gain: least gain of a candidate that is refitted under the best one's noise
CONTENDER_SHARE = 0.2
NOISE_ROUNDS = 3  # most refits of all contenders, each under the noise of the best one so far
# standard errors of the difference to the best one, within which a candidate is tied with it where
# motion is uniform
RIVAL_ERRORS = 4.0
# standard errors: a simpler candidate that is less far behind takes the place of the best one
SIMPLER_ERRORS = 1.0


@dataclass(frozen=True)
class TrialRound:
    """A round of the search: what is said of it, and the fits behind that."""

    said: Round
    trials: tuple[EffectFit, ...]
    null: Null  # of the largest gain of its candidates
    base: float  # log-likelihood without any of them, under the noise of the best one [nats]
    best: EffectFit | None = None  # None if no candidate is above the null's level

    @classmethod
    def of(
        cls,
        trials: Sequence[EffectFit],
        null: Null,
        base: float,
        best: EffectFit | None = None,
        gain: float = 0.0,
    ) -> TrialRound:
        """Return a round that is not decided yet; `gain` of the best candidate, or of the one that
        comes nearest [nats].
        """
        candidates = [trial.reported(null, base) for trial in trials]
        candidates.sort(key=lambda c: math.inf if math.isnan(c.gain) else -c.gain)
        name = best.name if best else None
        top = name or (candidates[0].name if candidates else "")
        said = Round(tuple(candidates), null.level(top), null.p(top, gain), "none", "", name, gain)
        return cls(said, tuple(trials), null, base, best)

    def with_said(self, **changes: Any) -> TrialRound:
        """Return the round with other things said of it."""
        return replace(self, said=replace(self.said, **changes))

    @property
    def assessment(self) -> Assessment:
        """What its best candidate is worth."""
        return (self.best and self.best.assessment) or Assessment()

    @property
    def level(self) -> float:
        """Gain of its best candidate that chance reaches [nats]."""
        return self.null.level(self.best.name if self.best else "")

    def rejected(self, decision: Finding, *, keep_ties: bool = False) -> TrialRound:
        """Return the round with its best candidate rejected."""
        ties = self.said.ties if keep_ties else ()
        return self.with_said(decision=decision, outcome="rejected", ties=ties)

    def limited(self, decision: Finding) -> TrialRound:
        """Return the round with a best candidate that stands in for something else."""
        return self.with_said(decision=decision, outcome="limit", ties=())


def accept_or_reject(
    context: SearchContext, tried: Sequence[EffectFit], above_level: Sequence[EffectFit], null: Null
) -> TrialRound:
    """Return the comparison of candidates above the level, under the best one's noise."""
    problem, contenders = _refitted_contenders(context, _inside_limits(context, above_level))
    contenders = _inside_limits(context, contenders)
    plain = _refitted_plain(problem, context.fit, _likeliest(contenders))
    # what each is worth, and the best of those that are worth enough
    reference = ReferenceModel.of(context.dataset, problem, plain)
    contenders = [
        replace(c, assessment=reference.assess(c.fit, null.level(c.name)))
        for c in contenders
        if c.fit
    ]
    accepted = [c for c in contenders if c.assessment and c.assessment.accepted]
    best = simplest(accepted) if accepted else _likeliest(contenders)
    uniform = context.dataset.uniform is not None
    ties = tuple(c.name for c in accepted if c.name != best.name and is_tied(best, c, uniform))
    # how far each is behind the best one
    contenders = [_with_deficit(best, c) for c in contenders]
    [best] = [c for c in contenders if c.name == best.name]
    assert best.fit is not None
    candidates = {c.name: c for c in (*tried, *contenders)}
    compared = TrialRound.of(
        tuple(candidates.values()), null, plain.total, best, best.gain_over(plain)
    )
    return compared.with_said(ties=ties)


def _with_deficit(best: EffectFit, other: EffectFit) -> EffectFit:
    """Return a candidate that was assessed with how far it is behind the best one."""
    assert other.assessment is not None
    deficit = likelihood_difference(best, other)
    return replace(other, assessment=replace(other.assessment, deficit=deficit))


# -- fits under the same noise ---------------------------------------------------------------------
def _likeliest(candidates: Sequence[EffectFit]) -> EffectFit:
    return max(candidates, key=lambda c: c.penalised_likelihood)


def _inside_limits(context: SearchContext, candidates: Sequence[EffectFit]) -> list[EffectFit]:
    """Return the candidates that end within the limits of the records; all of them if none does."""
    return [c for c in candidates if c.inside_limits(context.fitted.servo.limits)] or list(
        candidates
    )


def _refitted_contenders(
    context: SearchContext, candidates: Sequence[EffectFit]
) -> tuple[Problem, list[EffectFit]]:
    """Return those near the best one, refitted under its noise until it stays the best."""
    plain, least = context.fit, CONTENDER_SHARE * _likeliest(candidates).gain_over(context.fit)
    near = [c for c in candidates if c.gain_over(plain) > least]
    contenders = context.options.map(
        lambda c: replace(c, fit=c.fit and refit_with_noise(context.dataset, c.fit)), near
    )
    best, problem = _likeliest(contenders), context.fitted.problem
    for _ in range(NOISE_ROUNDS):
        assert best.fit is not None
        problem = context.own_noise(best.fit)
        contenders = context.options.map(partial(_resumed, problem), contenders)
        before, best = best, _likeliest(contenders)
        if best.name == before.name:
            break
    return problem, contenders


def _resumed(problem: Problem, candidate: EffectFit) -> EffectFit:
    """Return a candidate refitted under a problem."""
    return replace(
        candidate, fit=candidate.fit and resume(problem, candidate.fit, stop_gain=ROUGH_STOP_GAIN)
    )


def _refitted_plain(problem: Problem, fit: Fit, best: EffectFit) -> Fit:
    """Return the model without any candidate, refitted from its own parameters and from those
    beside the best candidate.

    Stick-slip makes many small maxima of the likelihood: a candidate must not gain by leaving one
    of them. A load with free play makes so many that it is initialised anew as well.
    """
    assert best.fit is not None
    values = {name: best.fit.values.get(name, value) for name, value in fit.values.items()}
    other = refit(problem, fit.at(values, best.fit.initial), stop_gain=ROUGH_STOP_GAIN)
    better = max(
        (resume(problem, fit, stop_gain=ROUGH_STOP_GAIN), other), key=lambda each: each.total
    )
    return refit_nonsmooth(better, lambda fit: problem, fit.simulator.effects)


# -- assessment ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ReferenceModel:
    """What a model with a further effect, or another shape of one, is compared with."""

    density: Array  # (segments,): log predictive density of the model without it [nats]
    held_out: Problem
    squares: Array  # (training segments,): mean squared errors of the model without it
    train: NDArray[np.bool_]

    @classmethod
    def of(cls, dataset: Dataset, problem: Problem, plain: Fit) -> ReferenceModel:
        """Return it for a model without the effect, fitted under the problem of the training
        segments.
        """
        held_out = problem.only(dataset.held_out)
        return cls(
            predictive_density(held_out, plain),
            held_out,
            squares(plain, dataset.train),
            dataset.train,
        )

    def assess(self, fit: Fit, level: float) -> Assessment:
        """Return what a model with the effect is worth, at the `level` of chance [nats]."""
        gains = predictive_density(self.held_out, fit) - self.density
        falls = fall(self.squares, squares(fit, self.train), np.abs(gains[self.train]))
        return Assessment(level, falls, float(gains.sum()), gain_error(gains))


# -- the best one, and ties ------------------------------------------------------------------------
def simplest(candidates: Sequence[EffectFit]) -> EffectFit:
    """Return the likeliest candidate, or one with fewer parameters that is less than a standard
    error behind.

    A step soon after the beginning is nearly a constant torque, and its moment can always be chosen
    to gain a few nats.

    Source: breiman1984 (rule of one standard error).
    """
    best = _likeliest(candidates)
    close = [c for c in candidates if c.size < best.size and _is_close(best, c)]
    return min((best, *close), key=lambda c: (c.size, -c.penalised_likelihood))


def likelihood_difference(best: EffectFit, other: EffectFit) -> tuple[float, float]:
    """Return by how much the best candidate is likelier than another [nats] and the standard error
    of that.

    Source: vuong1989 (test of non-nested models).
    """
    assert best.fit is not None
    assert other.fit is not None
    difference = (best.fit.score - other.fit.score)[best.fit.weight > 0]
    deficit = best.penalised_likelihood - other.penalised_likelihood
    return deficit, float(np.std(difference) * np.sqrt(len(difference)))


def _is_close(best: EffectFit, other: EffectFit) -> bool:
    deficit, error = likelihood_difference(best, other)
    return deficit < SIMPLER_ERRORS * error


def is_tied(best: EffectFit, other: EffectFit, uniform: bool) -> bool:
    """True if the records do not distinguish two candidates; in `uniform` motion their likelihoods
    must be far apart.

    Within a class, where a tie costs no name, the likelihoods are told apart only beyond their
    standard error.
    """
    deficit, error = likelihood_difference(best, other)
    if uniform and deficit < RIVAL_ERRORS * error:
        return True
    same = group(other.name) == group(best.name)
    return other.size <= best.size and deficit < max(
        TIE_NATS, SIMPLER_ERRORS * error if same else 0.0
    )


def group(name: str) -> str:
    """Return the class of an effect."""
    return find_effect(name).group
