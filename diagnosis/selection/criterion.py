"""Which candidate above the null's level is accepted: size of its gain, confirmation on held-out segments, ties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.estimation.fitted_model import TIE_NATS, refit_with_noise
from bristle.diagnosis.estimation.likelihood import Fit, Problem, squares
from bristle.diagnosis.estimation.optimiser import ROUGH_STOP_GAIN, refit, refit_initial_states, refit_nonsmooth, resume
from bristle.diagnosis.selection.candidates import OUT_OF_TIME, Assessment, Candidate
from bristle.diagnosis.selection.discretisation import finer_gain
from bristle.diagnosis.selection.effect_size import acting_fall, fall, typical_fall
from bristle.diagnosis.selection.null_distribution import Null
from bristle.diagnosis.selection.start_values import SearchContext
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects

Outcome = Literal["none", "rejected", "limit", "tie", "added", "withdrawn"]
CONTENDER_SHARE = 0.2  # of the best gain: least gain of a candidate that is refitted under the best one's noise
NOISE_ROUNDS = 3  # most refits of all contenders, each under the noise of the best one so far
LEAST_FALL = 1.2  # factor by which the mean squared error must fall
RIVAL_SHARE = 0.6  # of the best gain: least gain of a rival, where the best one is too small or the motion is uniform
DOUBTLESS_LEVELS = 10.0  # times the null's level: a gain beyond doubt, if held-out segments agree
AGREED_NATS = 6.0  # nats: gain on held-out segments with which they agree
CERTAIN_LEVELS = 30.0  # times the null's level: a gain beyond doubt, whatever held-out segments show
CLEAR_LEVELS = 3.0  # times the null's level: gain from which a sparse effect's size is judged where it acts
CLOSE_ERRORS = 2.0  # standard errors: most by which a candidate with a clear gain may be behind a best one that is rejected
CLOSER_ERRORS = 1.0  # standard errors: the same for other candidates and for simpler ones
NEARLY_EQUAL_FALL = 0.95  # of the fall in error by another candidate: in practice the same
NATS_PER_PARAMETER = 3.3  # nats: least gain of a further parameter (1 % level of a likelihood ratio)
SEGMENT_NATS = 3.0  # nats: largest gain that counts for one held-out segment where they are to agree
WIDE_SEGMENT_NATS = 8.0  # nats: the same where they are to confirm a candidate
EXPECTED_SHARE = 0.25  # of the gain that the training segments predict: least on held-out segments
ALLOWED_LOSS = 10.0  # nats: by which the gain on held-out segments may be less
SUFFICIENT_NATS = 16.0  # nats: gain on held-out segments that is enough in any case
COUPLING_NATS = 4.0  # nats: the same for couplings, whose contacts differ from run to run
LEAST_HELD_OUT_FALL = 1.1  # factor by which the squared error of held-out segments must fall, but for sparse effects and couplings
CEDED_SHARE = 0.1  # of its gain: most that a sparse effect may lose on held-out segments, beside `ALLOWED_LOSS`


@dataclass(frozen=True)
class SearchRound:
    """One round of the search."""

    candidates: tuple[Candidate, ...]
    null: Null  # of the largest gain of its candidates
    base: float  # log-likelihood without any of them, under the noise of the best one [nats]
    best: Candidate | None = None  # None if no candidate is above the null's level
    gain: float = 0.0  # of the best one [nats]
    ties: tuple[str, ...] = ()  # other candidates that the records do not distinguish from it
    decision: str = ""  # what was decided and why, for the report; empty until it is
    # the same as a word: "limit" where a parameter of the best candidate presses against the end of its interval, so that it stands
    # in for something else; of a candidate that was "withdrawn", the effect was added and later removed
    outcome: Outcome = "none"
    finer_gain: float | None = None  # gain with finer steps of the simulation [nats]

    @property
    def named(self) -> bool:
        """True if its best candidate was added."""
        return self.outcome == "added"

    @property
    def untried(self) -> tuple[str, ...]:
        """Candidates for which the time budget did not suffice."""
        return tuple(c.name for c in self.candidates if c.reason == OUT_OF_TIME)

    @property
    def assessment(self) -> Assessment:
        """What its best candidate is worth."""
        return (self.best and self.best.assessment) or Assessment()

    @property
    def convincing(self) -> bool:
        """True if its best candidate is large enough and confirmed."""
        return self.assessment.large_enough and self.assessment.confirmed

    @property
    def level(self) -> float:
        """Gain of its best candidate that chance reaches [nats]."""
        return self.null.level(self.best.name if self.best else "")

    def rejected(self, decision: str, *, keep_ties: bool = False) -> SearchRound:
        """Return the round with its best candidate rejected."""
        return replace(self, decision=decision, outcome="rejected", ties=self.ties if keep_ties else ())


def accept_or_reject(
    context: SearchContext, tried: Sequence[Candidate], above_level: Sequence[Candidate], null: Null
) -> SearchRound:
    """Return the comparison of the candidates above the null's level, under the noise of the best one's residual."""
    problem, contenders = _refitted_contenders(context, _inside_limits(context, above_level))
    contenders = _inside_limits(context, contenders)
    plain = _refitted_plain(problem, context.fit, _likeliest(contenders))
    comparison = _Comparison.of(context, problem, plain)
    contenders = [replace(c, assessment=comparison.assess(c, null.level(c.name))) for c in contenders]
    best = _accepted(contenders, plain, null)
    confirmed = [c for c in contenders if _is_sound(c)]
    uniform = bool(context.dataset.poor_excitation)
    ties = tuple(c.name for c in confirmed if c.name != best.name and is_tied(best, c, plain, uniform))
    deficits = [(c, c.assessment, likelihood_difference(best, c)) for c in contenders]
    contenders = [replace(c, assessment=replace(a, deficit=deficit)) for c, a, deficit in deficits if a]
    [best] = [c for c in contenders if c.name == best.name]
    assert best.fit is not None
    candidates = {c.name: c for c in (*tried, *contenders)}
    return SearchRound(
        tuple(candidates.values()), null, plain.total, best, best.gain_over(plain), ties,
        finer_gain=finer_gain(problem, plain, best.fit),
    )  # fmt: skip


# -- fits under the same noise -------------------------------------------------------------------------------------------
def _likeliest(candidates: Sequence[Candidate]) -> Candidate:
    return max(candidates, key=lambda c: c.penalised_likelihood)


def _inside_limits(context: SearchContext, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that end within the limits of the records; all of them if none does."""
    return [c for c in candidates if c.inside_limits(context.fitted.servo.limits)] or list(candidates)


def _refitted_contenders(context: SearchContext, candidates: Sequence[Candidate]) -> tuple[Problem, list[Candidate]]:
    """Return those that come near the best one, refitted under its noise until the best one stays the best."""
    plain, least = context.fit, CONTENDER_SHARE * _likeliest(candidates).gain_over(context.fit)
    near = [c for c in candidates if c.gain_over(plain) > least]
    contenders = context.options.map(lambda c: replace(c, fit=c.fit and refit_with_noise(context.dataset, c.fit)), near)
    best, problem = _likeliest(contenders), context.fitted.problem
    for _ in range(NOISE_ROUNDS):
        assert best.fit is not None
        problem = context.own_noise(best.fit)
        contenders = context.options.map(partial(_resumed, problem), contenders)
        before, best = best, _likeliest(contenders)
        if best.name == before.name:
            break
    return problem, contenders


def _resumed(problem: Problem, candidate: Candidate) -> Candidate:
    """Return a candidate refitted under a problem."""
    return replace(candidate, fit=candidate.fit and resume(problem, candidate.fit, stop_gain=ROUGH_STOP_GAIN))


def _refitted_plain(problem: Problem, fit: Fit, best: Candidate) -> Fit:
    """Return the model without any candidate, refitted from its own parameters and from those beside the best candidate.

    Stick-slip makes many small maxima of the likelihood: a candidate must not gain by leaving one of them. A load with free
    play makes so many that it is initialised anew as well.
    """
    assert best.fit is not None
    values = {name: best.fit.values.get(name, value) for name, value in fit.values.items()}
    other = refit(problem, fit.at(values, best.fit.initial), stop_gain=ROUGH_STOP_GAIN)
    better = max((resume(problem, fit, stop_gain=ROUGH_STOP_GAIN), other), key=lambda each: each.total)
    return refit_nonsmooth(better, lambda fit: problem, fit.simulator.effects)


# -- assessment ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Comparison:
    """What candidates are compared with."""

    plain: Fit  # model without them, on the training segments
    held_out: Fit  # the same on the held-out segments
    problem: Problem  # of the held-out segments
    squares: Array  # (training segments,): mean squared errors of the model without them
    train: NDArray[np.bool_]

    @classmethod
    def of(cls, context: SearchContext, problem: Problem, plain: Fit) -> _Comparison:
        held, train = problem.only(context.dataset.held_out), context.dataset.train
        return cls(plain, refit_initial_states(held, plain), held, squares(plain, train), train)

    def assess(self, candidate: Candidate, level: float) -> Assessment:
        """Return what a candidate is worth; `level` is the gain that chance reaches [nats].

        Stick-slip lets a few segments diverge by chance, which dominate a mean square. A gain beyond doubt is therefore not
        judged by it, if the held-out segments agree.
        """
        assert candidate.fit is not None
        effect, gain = find_effect(candidate.name), max(candidate.gain_over(self.plain), 0.0)
        held_out = refit_initial_states(self.problem, candidate.fit)
        gains = (held_out.score - self.held_out.score)[self.problem.counted]
        reduction = self._error_reduction(candidate.fit, effect.sparse, gain > CLEAR_LEVELS * level)
        agreed = _clipped_sum(gains, SEGMENT_NATS)
        sure = beyond_doubt(gain, level, agreed)
        predicted = gain * len(gains) / max(int(np.count_nonzero(self.train)), 1)
        least = min(EXPECTED_SHARE * predicted - ALLOWED_LOSS, COUPLING_NATS if effect.coupling else SUFFICIENT_NATS)
        least = -ALLOWED_LOSS - CEDED_SHARE * gain if effect.sparse else least
        holds = _clipped_sum(gains, WIDE_SEGMENT_NATS) > least
        confirmed = sure or (holds and (effect.sparse or bool(effect.coupling) or self._error_falls(held_out)))
        return Assessment(reduction, agreed, is_large_enough(reduction, sure, bool(effect.coupling)), confirmed)

    def _error_reduction(self, fit: Fit, sparse: bool, clear: bool) -> float:
        """Return the factor by which the error falls on training segments; for a sparse effect with a clear gain where it acts."""
        after = squares(fit, self.train)
        whole = fall(self.squares, after, sparse)
        return max(whole, acting_fall(self.squares, after)) if sparse and clear else whole

    def _error_falls(self, held_out: Fit) -> bool:
        """True if the error falls on held-out segments, in all or in the typical one."""
        before, after = squares(self.held_out, self.problem.counted), squares(held_out, self.problem.counted)
        return max(fall(before, after), typical_fall(before, after)) > LEAST_HELD_OUT_FALL


def is_large_enough(error_reduction: float, sure: bool, coupling: bool) -> bool:
    """True if the error falls by a factor that matters, or by any factor where the gain is beyond doubt.

    A coupling must lower the error: its second inertia can gain likelihood by calling the residual a disturbance.
    """
    return error_reduction >= LEAST_FALL or (sure and (error_reduction >= 1 or not coupling))


def beyond_doubt(gain: float, level: float, held_out_gain: float) -> bool:
    """True if a gain is so far above what chance reaches (`level`) that no further test is needed (all in nats)."""
    return gain > CERTAIN_LEVELS * level or (gain > DOUBTLESS_LEVELS * level and held_out_gain > AGREED_NATS)


def _clipped_sum(gains: Array, most: float) -> float:
    return float(np.clip(gains, -most, most).sum())


# -- the best one, and ties ----------------------------------------------------------------------------------------------
def _is_sound(candidate: Candidate) -> bool:
    """True if a candidate is large enough and confirmed."""
    return candidate.assessment is not None and candidate.assessment.large_enough and candidate.assessment.confirmed


def _accepted(contenders: Sequence[Candidate], plain: Fit, null: Null) -> Candidate:
    """Return the candidate to add: the likeliest large one or, in its place, a simpler one or the next one that is confirmed."""
    least = RIVAL_SHARE * _likeliest(contenders).gain_over(plain)
    large = [c for c in contenders if c.assessment and c.assessment.large_enough and c.gain_over(plain) > least]
    best = _likeliest(large or contenders)
    sound = [c for c in contenders if _is_sound(c)]
    if best in sound:
        return _likeliest([c for c in sound if is_simpler_equal(c, best)] or [best])
    clear = {c.name for c in sound if c.gain_over(plain) > CLEAR_LEVELS * null.level(c.name)}
    return _likeliest([c for c in sound if _is_close(best, c, CLOSE_ERRORS if c.name in clear else CLOSER_ERRORS)] or [best])


def likelihood_difference(best: Candidate, other: Candidate) -> tuple[float, float]:
    """Return by how much the best candidate is likelier than another [nats] and the standard error of that.

    Source: vuong1989 (test of non-nested models).
    """
    assert best.fit is not None
    assert other.fit is not None
    difference = (best.fit.score - other.fit.score)[best.fit.weight > 0]
    deficit = best.penalised_likelihood - other.penalised_likelihood
    return deficit, float(np.std(difference) * np.sqrt(len(difference)))


def is_simpler_equal(simple: Candidate, rich: Candidate) -> bool:
    """True if a candidate has fewer parameters and the other one's further ones gain no more than chance.

    Or if it leaves hardly a larger error and the records hardly distinguish them: a step soon after the beginning is nearly
    a constant torque, and its moment can always be chosen to gain a few nats.

    Source: wilks1938 (likelihood ratio of nested models, 1 %).
    """
    assert simple.fit is not None
    assert rich.fit is not None
    if simple.size >= rich.size:
        return False
    if rich.fit.total - simple.fit.total < NATS_PER_PARAMETER * (rich.size - simple.size):
        return True
    if find_effect(simple.name).sparse:  # its fall in error may be that of a few segments
        return False
    assert simple.assessment is not None
    assert rich.assessment is not None
    equal = simple.assessment.error_reduction >= NEARLY_EQUAL_FALL * rich.assessment.error_reduction
    return equal and _is_close(rich, simple, CLOSER_ERRORS)


def _is_close(best: Candidate, other: Candidate, errors: float) -> bool:
    """True if another candidate is no more than so many standard errors behind the best one."""
    deficit, error = likelihood_difference(best, other)
    return deficit < errors * error


def is_tied(best: Candidate, other: Candidate, plain: Fit, uniform: bool) -> bool:
    """True if the records do not distinguish two candidates; in `uniform` motion every strong one is tied."""
    assert best.fit is not None
    assert other.fit is not None
    if uniform and best.fit.total - other.fit.total < (1 - RIVAL_SHARE) * best.gain_over(plain):
        return True
    return likelihood_difference(best, other)[0] < TIE_NATS and not is_simpler_equal(best, other)


def group(name: str) -> str:
    """Return the class of an effect."""
    return all_effects()[name].group
