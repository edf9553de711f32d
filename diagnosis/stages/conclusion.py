"""After the search: what the records say, as an answer."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bristle.diagnosis.answer import (
    Diagnosis,
    Estimate,
    Finding,
    Gap,
    Named,
    Reason,
    RecordTrace,
    ResidualView,
    Round,
    Undetected,
    Unexplained,
    Verdict,
    finding,
)
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.checks.preparation import PreparedCase
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import (
    FittedModel,
    disturbance_ratio,
)
from bristle.diagnosis.estimation.likelihood import Fit, errors, mean_square, squares
from bristle.diagnosis.estimation.optimiser import refit_nonsmooth, resume
from bristle.diagnosis.estimation.uncertainty import ANY_STRENGTH, estimates
from bristle.diagnosis.localisation.residual_localisation import localise
from bristle.diagnosis.localisation.unexplained import FinalModel, unexplained
from bristle.diagnosis.localisation.views import Share
from bristle.diagnosis.selection.candidates import EffectFit
from bristle.diagnosis.selection.criterion import TrialRound, group
from bristle.diagnosis.selection.detection_limit import detection_limits
from bristle.diagnosis.selection.effect_size import fall_in_all
from bristle.diagnosis.selection.stepwise import SearchOutcome
from bristle.diagnosis.stages.bounds import wider_bounds
from bristle.diagnosis.stages.case import SearchedCase
from bristle.plant.effects import effect as find_effect

# half an interval over the value, which of one parameter at least must be less
KNOWN_HALF_WIDTH = 0.3
# of the input's torque, rms: a larger disturbance is something that the model lacks
DOMINANT_DISTURBANCE = 0.5
# share of the residual in a view from which the residual is no noise, whether reported or not
UNEXPLAINED_SHARE = 0.5
MOST_TIED, MOST_TIED_UNIFORM = 3, 2  # classes in a tie at most, and in records of uniform motion
Estimates = Mapping[str, Estimate]  # by the parameters' names


@dataclass(frozen=True)
class ErrorsBeforeAndAfter:
    """A model against the one before the search."""

    views: tuple[ResidualView, ...]  # localisation of both residuals
    shares: list[Share]  # shares of the later one
    gap: Gap  # errors on held-out segments
    error_fall: float  # factor by which the error falls there, outliers clipped
    # mean squared error of all segments, over that of the model before the search
    error_left: float

    @classmethod
    def of(cls, case: PreparedCase, final: FittedModel) -> ErrorsBeforeAndAfter:
        """Return the comparison of the model that the search ended with."""
        held_out = case.dataset.held_out
        error_fall = fall_in_all(squares(case.base.fit, held_out), squares(final.fit, held_out))
        counted = case.dataset.segments.counted
        before = mean_square(case.base.fit, counted)
        error_left = mean_square(final.fit, counted) / before if before > 0 else 1.0
        gap = gap_between(case, final)
        return cls(*localise(case.dataset, case.base, final), gap, error_fall, error_left)

    def left(self, case: PreparedCase, final: FittedModel, named: Sequence[str]) -> Unexplained:
        """Return whether a part of the residual is unexplained beside the named effects."""
        model = FinalModel(
            named,
            final.fit.values,
            case.dataset.turn,
            self.error_left,
            self.error_fall,
            disturbance_ratio(case.dataset, final.fit),
        )
        return unexplained(self.shares, model)


def conclude(prepared: PreparedCase, outcome: SearchOutcome) -> tuple[SearchedCase, Diagnosis]:
    """Return what the records say, parameters and intervals refitted to all segments, and the case
    with its fits.
    """
    explains = _with_effects(prepared, outcome)
    wider = wider_bounds(prepared, explains) if explains else None
    final, rounds, compared = _after_withdrawal(prepared, outcome, wider)
    # the parameters before and after, of all segments
    base_fit = _refitted_to_all(prepared.dataset, prepared.base)
    fit = base_fit if final is prepared.base else _refitted_to_all(prepared.dataset, final)
    base = estimates(prepared.model, base_fit)
    problem = final.problem.only(prepared.dataset.segments.counted)
    fitted = estimates(prepared.model, fit, problem)
    case = SearchedCase(**vars(prepared), final=final, fit=fit, rounds=rounds)
    answer = _named_or_not(case, compared, base, fitted)
    return case, answer if wider is None else _waiting_for(wider, answer)


def _named_or_not(
    case: SearchedCase,
    compared: ErrorsBeforeAndAfter,
    base: dict[str, Estimate],
    fitted: dict[str, Estimate],
) -> Diagnosis:
    """Return the answer of a search whose effects are within the bounds."""
    model, dataset, last = case.model, case.dataset, case.rounds[-1].said
    named = case.final.servo.effects[len(model.effects) :]
    # what is left of the residual
    left = compared.left(case, case.final, named)
    left = replace(left, flag=left.flag or last.outcome == "limit")
    floor_unknown = left.flag or (left.view is not None and left.share > UNEXPLAINED_SHARE)
    # the verdict, and what may be chosen where it is open
    unidentified = () if named or last.undecided else unidentified_parameters(base)
    verdict: Verdict = (
        "named" if named else unnamed(last, bool(dataset.uniform), left, unidentified)
    )
    open_ = choices_of(case.rounds, last.undecided, named)
    choices = {c.name: estimates(model, c.fit) for c in open_ if c.fit}
    answer = Diagnosis(
        verdict=verdict,
        gap=known_floor(compared.gap, floor_unknown),
        excited=excitation(model, case.records),
        model=model,
        effects=_named(case.rounds, named, fitted),
        ties=_ties(case.rounds),
        where=compared.views,
        remains=left,
        base=base,
        fitted=fitted,
        rounds=tuple(each.said for each in case.rounds),
        traces=_traces(dataset, case.base.fit, case.final.fit),
        uniform=dataset.uniform,
        unidentified=unidentified,
        hindrance=hindrance(last, left),
        choices={name: _of_effect(name, e) for name, e in choices.items()},
        choice_parameters={name: _beside(name, e) for name, e in choices.items()},
    )
    return replace(answer, limits=_limits(case, answer))


def _waiting_for(wider: Finding, answer: Diagnosis) -> Diagnosis:
    """Return an answer that waits for wider bounds."""
    return replace(
        answer,
        verdict="not_identifiable",
        ties=(),
        limits=(),
        choices={},
        choice_parameters={},
        corrections=(wider,),
    )


def may_be_nothing(answer: Diagnosis) -> bool:
    """Return whether effects are named of which no strength is known to differ from 0."""
    return bool(answer.effects) and not any(e.known_within(ANY_STRENGTH) for e in answer.effects)


def without_effects(case: PreparedCase, outcome: SearchOutcome, answer: Diagnosis) -> SearchOutcome:
    """Return an outcome whose effects stand in for something else that is missing."""
    names = tuple(e.name for e in answer.effects)
    first = outcome.rounds[0].limited(finding(Reason.STANDS_IN, effects=names))
    return replace(outcome, final=case.base, rounds=(first,))


def _after_withdrawal(
    case: PreparedCase, outcome: SearchOutcome, wider: Finding | None
) -> tuple[FittedModel, tuple[TrialRound, ...], ErrorsBeforeAndAfter]:
    """Return final model, rounds and comparison, all effects withdrawn where wider bounds do as
    well.
    """
    if wider is None:
        return outcome.final, outcome.rounds, ErrorsBeforeAndAfter.of(case, outcome.final)
    why = finding(Reason.ONLY_BOUNDS)
    withdrawn = outcome.rounds[0].with_said(outcome="withdrawn", decision=why)
    return case.base, (withdrawn,), ErrorsBeforeAndAfter.of(case, case.base)


def _ties(rounds: Sequence[TrialRound]) -> tuple[tuple[str, ...], ...]:
    """Return the ties of the effects that were added, and of the last round."""
    said = [each.said for each in rounds]
    return tuple(r.tied for r in said if r.best and r.ties and (r.added or r is said[-1]))


def _named(
    rounds: Sequence[TrialRound], names: Sequence[str], fitted: Estimates
) -> tuple[Named, ...]:
    """Return the effects that are named, with gain and p of the rounds that added them."""
    by_name = {r.said.added: r.said for r in rounds if r.said.added}
    return tuple(
        Named(name, group(name), _of_effect(name, fitted), by_name[name].gain, by_name[name].p)
        for name in names
    )


def _of_effect(name: str, parameters: Estimates) -> dict[str, Estimate]:
    """Return the parameters of an effect by their short names."""
    begin = f"{name}."
    return {key.removeprefix(begin): e for key, e in parameters.items() if key.startswith(begin)}


def _beside(name: str, parameters: Estimates) -> dict[str, Estimate]:
    """Return the parameters of the model beside an effect."""
    return {key: e for key, e in parameters.items() if not key.startswith(f"{name}.")}


def hindrance(last: Round, left: Unexplained) -> Finding | None:
    """Return why nothing can be named although something is missing for certain; None where the
    motion or a tie is the reason.
    """
    if last.outcome == "limit":
        return last.decision if isinstance(last.decision, Finding) else None
    if last.unfinished and not last.undecided:
        so_far = last.decision if last.outcome == "rejected" else None
        return finding(Reason.BUDGET_BEFORE_ALL, effects=last.unfinished, so_far=so_far)
    if left.disturbance > DOMINANT_DISTURBANCE and not last.undecided:
        return finding(Reason.LARGE_DISTURBANCE, share=left.disturbance)
    return None


def is_unaligned(case: PreparedCase) -> bool:
    """True if it is not known how the positions of the records lie relative to each other."""
    return case.dataset.segments.velocity and len(case.records) > 1


def _limits(case: SearchedCase, answer: Diagnosis) -> tuple[Undetected, ...]:
    """Return how large each effect that is neither named nor tied may be without being detected."""
    last = case.rounds[-1]
    tied = (name for tie in answer.ties for name in tie)
    known = {*(e.name for e in answer.effects), *last.said.undecided, *tied}
    limits = detection_limits(last.trials, last.null, last.base)
    return reported_limits(limits, known, last.said.added or "", is_unaligned(case))


def reported_limits(
    limits: Sequence[Undetected],
    known: Collection[str] = (),
    added: str = "",
    unaligned: bool = False,
) -> tuple[Undetected, ...]:
    """Return the limits of effects that are not `known` to act; `added` is the effect that was
    added after they were tried.

    With `unaligned` it is not known where the positions of the records are relative to each other.
    """
    return tuple(
        replace(
            each,
            before=added,
            same_start=unaligned and not each.reason and find_effect(each.name).position_dependent,
        )
        for each in limits
        if each.name not in known
    )


def _with_effects(case: PreparedCase, outcome: SearchOutcome) -> Fit | None:
    """Return the fit with the effects that were found, or with the one that stands in for something
    else; None without any.
    """
    if outcome.final.servo.effects != case.base.servo.effects:
        return outcome.final.fit
    last = outcome.rounds[-1]
    return last.best.fit if last.best and last.said.outcome == "limit" else None


def unidentified_parameters(plain: Estimates) -> tuple[str, ...]:
    """Return the parameters of the base model if the records determine none of them to within
    `KNOWN_HALF_WIDTH`.

    The output then hardly follows the input, and that no effect is found means nothing.
    """
    return () if any(e.known_within(KNOWN_HALF_WIDTH) for e in plain.values()) else tuple(plain)


def choices_of(
    rounds: Sequence[TrialRound], undecided: Sequence[str], named: Sequence[str]
) -> list[EffectFit]:
    """Return what may be chosen: the members of an open tie, or those that the last name stands
    for, if there is none.
    """
    if undecided:
        return [c for c in rounds[-1].trials if c.name in undecided]
    latest = next((r for r in reversed(rounds) if r.said.added), None)
    if latest is None or latest.said.best not in named:
        return []
    return [c for c in latest.trials if c.name in latest.said.ties]


def unnamed(
    last: Round, uniform: bool, left: Unexplained, unidentified: Sequence[str] = ()
) -> Verdict:
    """Return the verdict where nothing was named; where the motion is uniform, what shows at all
    has many likenesses.

    Where a disturbance moves the servo as much as the input does, or the best effect stands in for
    something else, something is missing for certain.

    `unidentified` are the model's parameters if the records tell none of them.
    """
    classes = {group(name) for name in last.undecided}
    if classes:
        few = len(classes) <= (MOST_TIED_UNIFORM if uniform else MOST_TIED)
        return "tie" if few and last.outcome != "withdrawn" else "not_identifiable"
    certain = (
        last.outcome == "limit" or bool(last.unfinished) or left.disturbance > DOMINANT_DISTURBANCE
    )
    alike = uniform and (left.flag or last.best)
    return "not_identifiable" if unidentified or certain or alike else "none"


def _traces(dataset: Dataset, before: Fit, after: Fit) -> tuple[RecordTrace, ...]:
    """Return what was measured and simulated, an average a bin, record by record, start states at
    their best as in the gap.
    """
    s, traces = dataset.segments, []
    whole = np.ones(len(dataset.held_out), dtype=bool)
    left = [np.where(fit.good[:, None], errors(fit, whole), np.nan) for fit in (before, after)]
    for piece, part in zip(s.pieces, s.places, strict=True):
        time_ = piece.time + s.h * (
            s.width * np.arange(piece.measured.size, dtype=np.float64) + (s.width - 1) / 2
        )
        held = np.repeat(dataset.held_out[part], s.bins)
        old, new = ((piece.measured - error[part]).ravel() for error in left)
        u = piece.u.reshape(-1, s.width).mean(axis=1)
        traces.append(RecordTrace(piece.name, time_, u, piece.measured.ravel(), old, new, held))
    return tuple(traces)


def _refitted_to_all(dataset: Dataset, fitted: FittedModel) -> Fit:
    """Return a model refitted to all segments, held-out ones included."""
    problem = fitted.problem.only(dataset.segments.counted)
    return refit_nonsmooth(resume(problem, fitted.fit), lambda fit: problem, fitted.servo.effects)


def gap_between(case: PreparedCase, final: FittedModel) -> Gap:
    """Return mean squared errors on held-out segments, and what the noise alone would give."""
    before, after = (
        mean_square(case.base.fit, case.dataset.held_out),
        mean_square(final.fit, case.dataset.held_out),
    )
    noise = final.problem.noise
    cover = np.linalg.inv(noise.whiten)
    covariance = cover @ cover.T
    live = case.dataset.held_out & final.fit.good
    floor = []
    for columns in final.fit.output_by_initial[live]:
        q, r = np.linalg.qr(columns)
        q = q[:, np.abs(np.diag(r)) > 1e-9 * max(np.abs(r).max(), 1e-300)]
        floor.append(np.trace(covariance) - np.trace(q.T @ covariance @ q))
    alone = float(np.mean(floor)) / case.dataset.segments.bins
    return Gap(before, after, min(alone, after), case.model.output_unit)


def known_floor(gap: Gap, mixed: bool) -> Gap:
    """Return a gap without the noise floor where that is not known.

    An unexplained part of the residual (`mixed`: a large one) is taken for noise, which is then no
    floor; nor is it where the error after the search is above the one before.
    """
    unknown = gap.after > gap.before or (
        mixed and gap.noise_floor is not None and gap.noise_floor >= gap.after
    )
    return replace(gap, noise_floor=None) if unknown else gap
