"""The stepwise search: effects are added one by one, and removed where no longer needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bristle.common.deadline import OutOfTime
from bristle.diagnosis.answer import (
    SENSOR_VIEWS,
    STRENGTH_HALF_WIDTH,
    Finding,
    Reason,
    finding,
)
from bristle.diagnosis.checks.input_hold import InputShare, estimate_input_share
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel, has_outliers_or_disturbance
from bristle.diagnosis.estimation.optimiser import pressed_bounds
from bristle.diagnosis.estimation.uncertainty import (
    ANY_STRENGTH,
    strength_is_known,
)
from bristle.diagnosis.localisation.residual_localisation import views_of
from bristle.diagnosis.selection.candidates import (
    EXHAUSTIVE,
    HOPEFUL_LEVELS,
    OUT_OF_TIME,
    QUICK,
    EffectFit,
    Effort,
    fit_candidates,
)
from bristle.diagnosis.selection.criterion import (
    TrialRound,
    accept_or_reject,
    group,
)
from bristle.diagnosis.selection.null_distribution import Null
from bristle.diagnosis.selection.refinement import (
    add_effect,
    backward_elimination,
    faint_effects,
    refit_shape,
    with_candidate,
)
from bristle.diagnosis.selection.sliding_choice import by_sliding
from bristle.diagnosis.selection.start_values import SearchContext, SearchOptions
from bristle.diagnosis.sliding.torque import FAINT
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects

MOST_EFFECTS = 4  # most effects that are added
STRUCTURE_P = 0.05  # p of a view of the residual up to which another round follows
# nats: least gain beyond the end of an interval that presses against it (1 % point of a likelihood
# ratio)
NATS_PER_PARAMETER = 3.3
# times the null's level: least gain of an effect with parameters that are hardly credible
CERTAIN_LEVELS = 10.0


@dataclass(frozen=True)
class SearchOutcome:
    """What the search found: the model with all effects that were added, its rounds, and how the
    input was held.

    With an `input_share` the search ended before its next round: the records have to be prepared
    with that input.
    """

    final: FittedModel
    rounds: tuple[TrialRound, ...]
    input_share: InputShare | None = None
    # what the time budget left out, beside the effects that the last round did not try
    cut_short: Finding | None = None

    @property
    def in_vain(self) -> bool:
        """True if its first round was its last one and found neither an effect nor a tie."""
        if self.input_share is not None or len(self.rounds) != 1:
            return False
        return self.rounds[0].said.outcome in ("none", "rejected")


def search(dataset: Dataset, base: FittedModel, options: SearchOptions) -> SearchOutcome:
    """Add effects one after the other as long as one is found that is certain and large enough."""
    fitted, rounds = base, list[TrialRound]()
    while True:
        context = SearchContext(dataset, fitted, options)
        try:
            # records that show an input which was not held are prepared again before they are
            # searched
            share = estimate_input_share(dataset, fitted) if options.test_input_hold else None
            if share is not None:
                return SearchOutcome(fitted, tuple(rounds), share)
            latest = by_sliding(context, _next_round(context, base, rounds))
        except OutOfTime:
            return SearchOutcome(fitted, (*rounds, _unfinished(context, base, rounds)))
        if latest.said.outcome != "added":
            cut = finding(Reason.BEST_STARTS_ONLY) if latest.said.cut_short else None
            return SearchOutcome(fitted, (*rounds, latest), cut_short=cut)
        # the effect joins the model, and what it makes superfluous goes
        fitted, removed = _added(context, base, latest, _certain(rounds))
        rounds.append(_decided(latest, removed=tuple(removed)))
        if len(rounds) >= MOST_EFFECTS:
            return SearchOutcome(fitted, tuple(rounds))
        if options.late:
            cut = finding(Reason.NO_FURTHER_EFFECT)
            return SearchOutcome(fitted, tuple(rounds), cut_short=cut)
        after = replace(context, fitted=fitted)
        if not residual_has_structure(after, rounds[-1], _classes(base, rounds)):
            rounds[-1] = _decided(rounds[-1], structure=False)
            return SearchOutcome(fitted, tuple(rounds))


def _decided(latest: TrialRound, **more: Any) -> TrialRound:
    """Return a round whose decision has further facts."""
    decision = latest.said.decision
    assert isinstance(decision, Finding)
    return latest.with_said(decision=replace(decision, facts={**decision.facts, **more}))


def _classes(base: FittedModel, rounds: Sequence[TrialRound]) -> set[str]:
    """Return the classes of effects that the model has or had."""
    return {group(name) for name in (*base.servo.effects, *(r.best.name for r in rounds if r.best))}


def _names(base: FittedModel, rounds: Sequence[TrialRound]) -> list[str]:
    """Return the effects of other classes than those."""
    taken = _classes(base, rounds)
    return [name for name in all_effects() if group(name) not in taken]


def _unfinished(
    context: SearchContext, base: FittedModel, rounds: Sequence[TrialRound]
) -> TrialRound:
    """Return a round whose effects could not be compared in time."""
    untried = tuple(EffectFit(name, None, reason=OUT_OF_TIME) for name in _names(base, rounds))
    untried_round = TrialRound.of(untried, Null(np.zeros(1), {}), context.fit.total)
    return untried_round.with_said(decision=finding(Reason.OUT_OF_BUDGET))


def _certain(rounds: Sequence[TrialRound]) -> list[str]:
    """Return the effects that sliding motion shows, of which segments do not decide."""
    decided = [(r.best, r.said.decision) for r in rounds]
    return [
        best.name
        for best, decision in decided
        if best and isinstance(decision, Finding) and decision.reason is Reason.SLIDING
    ]


def _added(
    context: SearchContext, base: FittedModel, latest: TrialRound, certain: Sequence[str]
) -> tuple[FittedModel, list[str]]:
    """Return the model with the best candidate and without what is no longer needed, and the names
    of that; effects that are `certain` stay.
    """
    assert latest.best is not None
    if _certain([latest]):
        return with_candidate(context, latest.best).fitted, []
    try:
        with_effect = replace(context, fitted=add_effect(context, latest.best, latest.level))
        return backward_elimination(with_effect, base, latest.level, certain)
    except OutOfTime:  # as it was compared with the others
        return with_candidate(context, latest.best).fitted, []


def _next_round(
    context: SearchContext, base: FittedModel, rounds: Sequence[TrialRound]
) -> TrialRound:
    """Return the next round; with all start values of couplings if a quick one finds nothing and
    the model still fits poorly.
    """
    names, further = _names(base, rounds), bool(rounds)
    quick = propose_effect(context, names, QUICK, further)
    in_vain = quick.said.outcome in ("none", "rejected") and quick.trials
    if not (in_vain and needs_exhaustive_search(context.dataset, context.fitted)):
        return quick
    # of one inertia a few steps from the best starts lead as far
    done = [c for c in quick.trials if not find_effect(c.name).coupling]
    try:
        if not context.options.late:
            return propose_effect(context, names, EXHAUSTIVE, further, done)
    except OutOfTime:
        pass
    return quick.with_said(cut_short=True)


def propose_effect(
    context: SearchContext,
    names: Sequence[str],
    effort: Effort,
    further: bool = False,
    done: Sequence[EffectFit] = (),
) -> TrialRound:
    """Return a round with its outcome: an effect to add (outcome "added"), or why there is none;
    `further`: beside others; `done` as of `fit_candidates`.
    """
    latest = evaluate_candidates(context, names, effort, done)
    return latest if latest.best is None else decide(context, latest, further)


def decide(context: SearchContext, latest: TrialRound, further: bool = False) -> TrialRound:
    """Return a round with the decision on its best candidate; its strength must not be nothing, and
    of a `further` one be known.
    """
    decided = _decision(context, latest, further)
    if latest.assessment.accepted and decided.said.outcome != "limit":
        return decided
    # a wrong form may be why it is refused
    other = retry_with_shape(context, latest)
    return decided if other is latest else _decision(context, other, further)


def _decision(context: SearchContext, latest: TrialRound, further: bool) -> TrialRound:
    return (
        _without_worth(context, latest)
        or _beside_rivals(latest)
        or _at_limits(latest)
        or _by_strength(context, latest, further)
    )


def _without_worth(context: SearchContext, latest: TrialRound) -> TrialRound | None:
    """Return a round whose best candidate does not meet the criterion."""
    assert latest.best is not None
    name, objection = latest.best.name, latest.assessment.objection
    if objection is not None:
        return latest.rejected(finding(Reason.UNMET, effect=name, objection=objection))
    return None


def _beside_rivals(latest: TrialRound) -> TrialRound | None:
    """Return a round whose best candidate is not known to be the best."""
    assert latest.best is not None
    name, ties = latest.best.name, latest.said.ties
    if latest.said.unfinished:
        return latest.rejected(finding(Reason.OTHERS_UNFINISHED, effect=name), keep_ties=True)
    if any(group(other) != group(name) for other in ties):
        return latest.with_said(decision=finding(Reason.TIE, effects=(name, *ties)), outcome="tie")
    return None


def _at_limits(latest: TrialRound) -> TrialRound | None:
    """Return a round whose best candidate presses against the end of what it can be."""
    assert latest.best is not None
    assert latest.best.fit is not None
    name = latest.best.name
    ends = {
        key: latest.best.fit.values[key]
        for key, gain in pressed_bounds(latest.best.fit, f"{name}.").items()
        if gain > NATS_PER_PARAMETER
    }
    return (
        latest.limited(finding(Reason.BOUND, effect=name, ends=tuple(ends.items())))
        if ends
        else None
    )


def _by_strength(context: SearchContext, latest: TrialRound, further: bool) -> TrialRound:
    """Return a round whose best candidate is added if its strength is known well enough."""
    assert latest.best is not None
    assert latest.best.fit is not None
    name, share = latest.best.name, STRENGTH_HALF_WIDTH if further else ANY_STRENGTH
    if further and [*faint_effects(with_candidate(context, latest.best), [name])]:
        return latest.rejected(finding(Reason.FAINT, effect=name, share=FAINT))
    if strength_is_known(latest.best.fit, context.own_noise(latest.best.fit), name, share=share):
        return latest.with_said(decision=finding(Reason.ADDED, effect=name), outcome="added")
    if further:
        return latest.rejected(finding(Reason.UNKNOWN_STRENGTH, effect=name))
    return latest.limited(finding(Reason.STANDS_IN, effects=(name,)))


def evaluate_candidates(
    context: SearchContext,
    names: Sequence[str],
    effort: Effort = QUICK,
    done: Sequence[EffectFit] = (),
) -> TrialRound:
    """Try the named effects on top of a fitted model, and compare those above the null's level."""
    fit, servo = context.fit, context.fitted.servo
    tried, null = fit_candidates(context, names, effort, done)
    fitted = [
        c for c in tried if c.fit is not None and not servo.adds_nothing(c.name, c.fit.values)
    ]
    if not fitted:
        nothing = TrialRound.of(tried, null, fit.total)
        return nothing.with_said(decision=finding(Reason.NOTHING_TO_ADD))
    best = max(fitted, key=lambda c: c.penalised_likelihood)
    above = [c for c in fitted if c.gain_over(fit) > required_gain(c, servo.credible, null)]
    if above and best.penalised_likelihood > EffectFit("", fit).penalised_likelihood:
        return accept_or_reject(context, tried, above, null)
    by_chance = TrialRound.of(tried, null, fit.total, gain=best.gain_over(fit))
    return by_chance.with_said(decision=finding(Reason.CHANCE))


def required_gain(
    candidate: EffectFit, credible: Mapping[str, tuple[float, float]], null: Null
) -> float:
    """Return the gain that a candidate must exceed [nats]: a far larger one where its parameters
    are hardly credible.
    """
    return (1.0 if candidate.credible(credible) else CERTAIN_LEVELS) * null.level(candidate.name)


def retry_with_shape(context: SearchContext, latest: TrialRound) -> TrialRound:
    """Return the round with the shape of its best candidate fitted too; the same round if that
    gains too little.

    With a wrong shape an effect lowers the error in some segments and raises it in others.
    """
    assert latest.best is not None
    extended = with_candidate(context, latest.best)
    end = refit_shape(extended, latest.best.name, latest.level)
    if end is extended.fitted:
        return latest
    tried = [replace(c, fit=end.fit) if c.name == latest.best.name else c for c in latest.trials]
    return accept_or_reject(
        context, tried, [c for c in tried if c.assessment is not None], latest.null
    )


def needs_exhaustive_search(dataset: Dataset, fitted: FittedModel) -> bool:
    """True if outliers or a large disturbance remain that free play and motion do not explain."""
    poor = has_outliers_or_disturbance(dataset, fitted.fit)
    return (
        poor
        and dataset.uniform is None
        and not any(find_effect(name).free_play for name in fitted.servo.effects)
    )


def residual_has_structure(context: SearchContext, latest: TrialRound, taken: set[str]) -> bool:
    """True if a view predicts the residual of a model, or a candidate of the last round outside
    `taken` classes gains by it.
    """
    if any(
        share.p <= STRUCTURE_P and share.view not in SENSOR_VIEWS
        for share in views_of(context.fitted, context.dataset)
    ):
        return True
    response = context.response
    for c in latest.trials:
        for directions in c.directions if group(c.name) not in taken else ():
            score = np.einsum(
                "s,snk,sn->k", response.weight, directions, response.rest, optimize=True
            )
            if 0.5 * float(score @ score) > HOPEFUL_LEVELS * latest.null.level(c.name):
                return True
    return False
