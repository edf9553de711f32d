"""The stepwise search: effects are added one after the other, and removed where no longer
needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bristle.common.deadline import OutOfTime
from bristle.diagnosis.checks.input_hold import InputShare, estimate_input_share
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel, has_outliers_or_disturbance
from bristle.diagnosis.estimation.optimiser import pressed_bounds
from bristle.diagnosis.estimation.uncertainty import (
    ANY_STRENGTH,
    STRENGTH_HALF_WIDTH,
    strength_is_known,
)
from bristle.diagnosis.localisation.residual_localisation import SENSOR_VIEWS, views_of
from bristle.diagnosis.selection.candidates import (
    EXHAUSTIVE,
    HOPEFUL_LEVELS,
    OUT_OF_TIME,
    QUICK,
    Candidate,
    Effort,
    fit_candidates,
)
from bristle.diagnosis.selection.criterion import (
    SearchRound,
    accept_or_reject,
    group,
)
from bristle.diagnosis.selection.discretisation import numerical
from bristle.diagnosis.selection.null_distribution import Null
from bristle.diagnosis.selection.refinement import (
    add_effect,
    backward_elimination,
    is_wave_harmonic,
    refit_shape,
    with_candidate,
)
from bristle.diagnosis.selection.start_values import SearchContext, SearchOptions
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects

MOST_EFFECTS = 4  # most effects that are added
STRUCTURE_P = 0.05  # p of a view of the residual up to which another round follows
# nats: least gain beyond the end of an interval that presses against it (1 % level of a likelihood
# ratio)
NATS_PER_PARAMETER = 3.3
NOT_EXHAUSTIVE = "effects were tried from their best start values only"
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
    rounds: tuple[SearchRound, ...]
    input_share: InputShare | None = None
    # what the time budget left out, beside the effects that the last round did not try
    cut_short: str = ""


def search(dataset: Dataset, base: FittedModel, options: SearchOptions) -> SearchOutcome:
    """Add effects one after the other as long as one is found that is certain and large enough."""
    fitted, rounds = base, list[SearchRound]()
    while True:
        context = SearchContext(dataset, fitted, options)
        try:
            share = estimate_input_share(dataset, fitted) if options.test_input_hold else None
            if share is not None:
                return SearchOutcome(fitted, tuple(rounds), share)
            found = _find_effect(context, base, rounds)
        except OutOfTime:
            return SearchOutcome(fitted, (*rounds, _unfinished(context, base, rounds)))
        if found.outcome != "added":
            return SearchOutcome(
                fitted, (*rounds, found), cut_short=NOT_EXHAUSTIVE if found.cut_short else ""
            )
        fitted, removed = _added(context, base, found)
        removal = f"; removed, as no longer needed: {', '.join(removed)}" if removed else ""
        found = replace(found, decision=f"{found.decision}{removal}")
        rounds.append(found)
        if len(rounds) >= MOST_EFFECTS or dataset.poor_excitation:
            return SearchOutcome(fitted, tuple(rounds))
        if options.late:
            return SearchOutcome(
                fitted, tuple(rounds), cut_short="no further effect was looked for"
            )
        if not residual_has_structure(
            replace(context, fitted=fitted), found, _classes(base, rounds)
        ):
            rounds[-1] = replace(
                found,
                decision=(
                    f"{found.decision}; neither a view nor an effect shows structure in the"
                    " residual"
                ),
            )
            return SearchOutcome(fitted, tuple(rounds))


def _classes(base: FittedModel, rounds: Sequence[SearchRound]) -> set[str]:
    """Return the classes of effects that the model has or had."""
    return {group(name) for name in (*base.servo.effects, *(r.best.name for r in rounds if r.best))}


def _names(base: FittedModel, rounds: Sequence[SearchRound]) -> list[str]:
    """Return the effects of other classes than those."""
    taken = _classes(base, rounds)
    return [name for name in all_effects() if group(name) not in taken]


def _unfinished(
    context: SearchContext, base: FittedModel, rounds: Sequence[SearchRound]
) -> SearchRound:
    """Return a round whose effects could not be compared in time."""
    untried = tuple(Candidate(name, None, reason=OUT_OF_TIME) for name in _names(base, rounds))
    return SearchRound(
        untried, Null(np.zeros(1), {}), context.fit.total, decision="the time budget was used up"
    )


def _added(
    context: SearchContext, base: FittedModel, found: SearchRound
) -> tuple[FittedModel, list[str]]:
    """Return the model with the best candidate and without what is no longer needed, and the names
    of that.
    """
    assert found.best is not None
    try:
        with_effect = replace(context, fitted=add_effect(context, found.best, found.level))
        return backward_elimination(with_effect, base, found.level)
    except OutOfTime:  # as it was compared with the others
        return with_candidate(context, found.best).fitted, []


def _find_effect(
    context: SearchContext, base: FittedModel, rounds: Sequence[SearchRound]
) -> SearchRound:
    """Return the next round; with all start values if a quick one finds nothing and the model still
    fits poorly.
    """
    names, further = _names(base, rounds), bool(rounds)
    found = propose_effect(context, names, QUICK, further)
    poor = (
        found.outcome in ("none", "rejected")
        and found.candidates
        and needs_exhaustive_search(context.dataset, context.fitted)
    )
    if not poor:
        return found
    try:
        return (
            replace(found, cut_short=True)
            if context.options.late
            else propose_effect(context, names, EXHAUSTIVE, further)
        )
    except OutOfTime:
        return replace(found, cut_short=True)


def propose_effect(
    context: SearchContext, names: Sequence[str], effort: Effort, further: bool = False
) -> SearchRound:
    """Return a round with its outcome: an effect to add (outcome "added"), or why there is none;
    `further`: beside others.
    """
    found = evaluate_candidates(context, names, effort)
    return found if found.best is None else decide(context, found, further)


def decide(context: SearchContext, found: SearchRound, further: bool = False) -> SearchRound:
    """Return a round with the decision on its best candidate; its strength must not be nothing, and
    of a `further` one be known.
    """
    if not found.assessment.accepted:
        found = retry_with_shape(context, found)
    assert found.best is not None
    name = found.best.name
    if not found.assessment.accepted:
        return found.rejected(f"'{name}' is significant, but {found.assessment.objection}")
    if is_wave_harmonic(context.dataset, context.fitted, found.best):
        return found.rejected(f"'{name}' may only correct the shape of an effect that was added")
    if found.unfinished:
        return found.rejected(
            f"'{name}' is the best, but others were not tried to the end", keep_ties=True
        )
    if any(group(other) != group(name) for other in found.ties):
        return replace(
            found, decision="several effects explain the residual equally well", outcome="tie"
        )
    if found.finer_gain is not None and numerical(found.gain, found.finer_gain, found.level):
        why = (
            f"'{name}' is a numerical artefact: its gain vanishes with finer steps of the"
            " simulation"
        )
        return found.rejected(why, keep_ties=True)
    assert found.best.fit is not None
    pressed = {
        key: gain
        for key, gain in pressed_bounds(found.best.fit, f"{name}.").items()
        if gain > NATS_PER_PARAMETER
    }
    if pressed:
        ends = " and ".join(f"{key} at {found.best.fit.values[key]:.3g}" for key in pressed)
        why = (
            f"'{name}' would explain most with {ends}, the end of what it can be: it stands in for"
            " something else"
        )
        return replace(found, decision=why, outcome="limit", ties=())
    share = STRENGTH_HALF_WIDTH if further else ANY_STRENGTH
    if strength_is_known(found.best.fit, context.own_noise(found.best.fit), name, share=share):
        return replace(found, decision=f"'{name}' added", outcome="added")
    if further:
        return found.rejected(
            f"'{name}' is significant, but beside what was found its strength is not known"
        )
    return replace(found, decision=stands_in([name]), outcome="limit", ties=())


def stands_in(names: Sequence[str]) -> str:
    """Return why effects of which no strength is known are not named."""
    effects, it = (
        " and ".join(f"'{name}'" for name in names),
        "it stands" if len(names) == 1 else "they stand",
    )
    return (
        f"{effects} would explain most, but with a strength that may be nothing: {it} in for"
        " something else"
    )


def evaluate_candidates(
    context: SearchContext, names: Sequence[str], effort: Effort = QUICK
) -> SearchRound:
    """Try the named effects on top of a fitted model, and compare those above the null's level."""
    fit, servo = context.fit, context.fitted.servo
    tried, null = fit_candidates(context, names, effort)
    fitted = [
        c for c in tried if c.fit is not None and not servo.adds_no_bristles(c.name, c.fit.values)
    ]
    if not fitted:
        return SearchRound(
            tuple(tried), null, fit.total, decision="no effect can be added to this model"
        )
    best = max(fitted, key=lambda c: c.penalised_likelihood)
    above = [c for c in fitted if c.gain_over(fit) > required_gain(c, servo.credible, null)]
    if above and best.penalised_likelihood > Candidate("", fit).penalised_likelihood:
        return accept_or_reject(context, tried, above, null)
    decision = "no gain above the level that chance reaches"
    return SearchRound(tuple(tried), null, fit.total, gain=best.gain_over(fit), decision=decision)


def required_gain(
    candidate: Candidate, credible: Mapping[str, tuple[float, float]], null: Null
) -> float:
    """Return the gain that a candidate must exceed [nats]: a far larger one where its parameters
    are hardly credible.
    """
    return (1.0 if candidate.credible(credible) else CERTAIN_LEVELS) * null.level(candidate.name)


def retry_with_shape(context: SearchContext, found: SearchRound) -> SearchRound:
    """Return the round with the shape of its best candidate fitted too; the same round if that
    gains too little.

    With a wrong shape an effect lowers the error in some segments and raises it in others.
    """
    assert found.best is not None
    extended = with_candidate(context, found.best)
    end = refit_shape(extended, found.best.name, found.level)
    if end is extended.fitted:
        return found
    tried = [replace(c, fit=end.fit) if c.name == found.best.name else c for c in found.candidates]
    return accept_or_reject(
        context, tried, [c for c in tried if c.assessment is not None], found.null
    )


def needs_exhaustive_search(dataset: Dataset, fitted: FittedModel) -> bool:
    """True if outliers or a large disturbance are left that neither free play nor uniform motion
    accounts for.
    """
    poor = has_outliers_or_disturbance(dataset, fitted.fit)
    return (
        poor
        and not dataset.poor_excitation
        and not any(find_effect(name).free_play for name in fitted.servo.effects)
    )


def residual_has_structure(context: SearchContext, found: SearchRound, taken: set[str]) -> bool:
    """True if a view predicts the residual of a model, or a candidate of the last round outside
    `taken` classes gains by it.
    """
    if any(
        share.p <= STRUCTURE_P and share.view not in SENSOR_VIEWS
        for share in views_of(context.fitted, context.dataset)
    ):
        return True
    response = context.response
    for c in found.candidates:
        for directions in c.directions if group(c.name) not in taken else ():
            score = np.einsum(
                "s,snk,sn->k", response.weight, directions, response.rest, optimize=True
            )
            if 0.5 * float(score @ score) > HOPEFUL_LEVELS * found.null.level(c.name):
                return True
    return False
