"""After the search: what the records say, gathered as a `Conclusion` and then written as a
`Diagnosis`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bristle.diagnosis.checks.excitation import VELOCITY_CAVEAT, excitation
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import (
    FittedModel,
    disturbance_ratio,
    fit_with_noise,
    has_outliers_or_disturbance,
)
from bristle.diagnosis.estimation.likelihood import Fit, errors, mean_square, squares
from bristle.diagnosis.estimation.optimiser import refit_nonsmooth, resume
from bristle.diagnosis.estimation.simulator import Free
from bristle.diagnosis.estimation.uncertainty import ANY_STRENGTH, estimates
from bristle.diagnosis.localisation.residual_localisation import localise
from bristle.diagnosis.localisation.unexplained import FinalModel, Unexplained, unexplained
from bristle.diagnosis.localisation.views import Share
from bristle.diagnosis.modelfile import BOUND_FACTOR, Model
from bristle.diagnosis.report import result as answer
from bristle.diagnosis.report.text import (
    Facts,
    begins_anew,
    experiment,
    open_loop_line,
    statement,
    undetected,
)
from bristle.diagnosis.selection.candidates import Candidate
from bristle.diagnosis.selection.criterion import SearchRound, group
from bristle.diagnosis.selection.detection_limit import detection_limits
from bristle.diagnosis.selection.effect_size import fall_in_all
from bristle.diagnosis.selection.stepwise import SearchOutcome, stands_in
from bristle.plant.effects import effect as find_effect
from bristle.records.record import Record

# half an interval over the value, which of one parameter at least must be less
KNOWN_HALF_WIDTH = 0.3
# of the input's torque, rms: a larger disturbance is something that the model lacks
DOMINANT_DISTURBANCE = 0.5
# share of the residual in a view from which the residual is no noise, whether reported or not
UNEXPLAINED_SHARE = 0.5
MOST_TIED, MOST_TIED_UNIFORM = 3, 2  # classes in a tie at most, and in records of uniform motion
Estimates = Mapping[str, answer.Estimate]  # by the parameters' names
NOTHING_LEFT = Unexplained(False, None, 0.0)
TIGHT_BOUNDS = "Effects explain these records, but they only make up for bounds that are too tight."


@dataclass(frozen=True)
class Case:
    """What is searched: a model and records, the records as a dataset, and the model fitted to it
    without further effects.
    """

    model: Model
    records: Sequence[Record]
    dataset: Dataset
    base: FittedModel


@dataclass(frozen=True)
class Comparison:
    """A model against the one before the search."""

    views: tuple[answer.View, ...]  # localisation of both residuals
    shares: list[Share]  # shares of the later one
    gap: answer.Gap  # errors on held-out segments
    error_fall: float  # factor by which the error falls there, outliers clipped

    @classmethod
    def of(cls, case: Case, final: FittedModel) -> Comparison:
        """Return the comparison of the model that the search ended with."""
        held_out = case.dataset.held_out
        error_fall = fall_in_all(squares(case.base.fit, held_out), squares(final.fit, held_out))
        return cls(*localise(case.dataset, case.base, final), gap_between(case, final), error_fall)

    def left(self, case: Case, final: FittedModel, named: Sequence[str]) -> Unexplained:
        """Return whether a part of the residual is unexplained beside the effects that were
        named.
        """
        outliers, disturbance = (
            has_outliers_or_disturbance(case.dataset, final.fit),
            disturbance_ratio(case.dataset, final.fit),
        )
        model = FinalModel(
            named,
            final.fit.values,
            case.dataset.turn,
            self.gap.left,
            self.error_fall,
            outliers,
            disturbance,
        )
        return unexplained(self.shares, model)

    def closes_in_part(self, case: Case, final: FittedModel) -> bool:
        """True if some view predicts a part of the residual, in uniform motion that does not show
        its form.
        """
        model = FinalModel((), final.fit.values, case.dataset.turn, self.gap.left, self.error_fall)
        return unexplained(self.shares, model).flag


@dataclass(frozen=True)
class Conclusion:
    """What the records say.

    `base`, `parameters`: of the model before the search, and of the final model with its effects.
    `choices`: parameters with each member of a tie in place of the named effect.

    Others are as of `Diagnosis`.
    """

    verdict: str
    final: FittedModel  # the model with all effects that are named
    fit: Fit  # that model refitted to all segments
    rounds: tuple[SearchRound, ...]
    comparison: Comparison  # of the final model with the one before the search
    remains: Unexplained
    gap: answer.Gap
    effects: tuple[answer.Named, ...]
    ties: tuple[tuple[str, ...], ...]
    # members of a tie that was not resolved, or the effect that was withdrawn
    undecided: tuple[str, ...]
    base: dict[str, answer.Estimate]
    parameters: dict[str, answer.Estimate]
    # the model's parameters if the records determine none of them
    unidentified: tuple[str, ...] = ()
    choices: Mapping[str, Estimates] = field(default_factory=dict)
    proposal: str = ""  # wider bounds to try first, or an empty text

    @property
    def own_parameters(self) -> dict[str, answer.Estimate]:
        """Parameters of the final model without those of the effects that are named."""
        return {
            k: v
            for k, v in self.parameters.items()
            if k.split(".")[0] not in {e.name for e in self.effects}
        }


@dataclass(frozen=True)
class Additions:
    """What a workflow adds to a diagnosis: lines before and after, proposals, and the model if it
    is not the one searched.
    """

    statement: Sequence[str] = ()
    findings_before: Sequence[str] = ()
    findings_after: Sequence[str] = ()
    model: Model | None = None
    proposals: tuple[str, ...] = ()


def conclude(case: Case, outcome: SearchOutcome) -> Conclusion:
    """Return what the records say, parameters and intervals refitted to all segments."""
    explains = _with_effects(case, outcome)
    proposal = wider_bounds(case, explains) if explains else ""
    final, rounds, comparison = _after_withdrawal(case, outcome, proposal)
    last, named = rounds[-1], final.servo.effects[len(case.model.effects) :]
    left = comparison.left(case, final, named)
    left = replace(left, flag=left.flag or last.outcome == "limit")
    undecided = undecided_names(last)
    base_fit = _refitted_to_all(case.dataset, case.base)
    whole = base_fit if final is case.base else _refitted_to_all(case.dataset, final)
    base = estimates(case.model, base_fit)
    parameters = estimates(case.model, whole, final.problem.only(case.dataset.segments.counted))
    unidentified = () if named or undecided else unidentified_parameters(base)
    verdict = "named" if named else unnamed(last, case.dataset.poor_excitation, left, unidentified)
    floor_unknown = left.flag or (left.view is not None and left.share > UNEXPLAINED_SHARE)
    return Conclusion(
        "not_identifiable" if proposal else verdict,
        final,
        whole,
        rounds,
        comparison,
        left,
        known_floor(comparison.gap, floor_unknown),
        _named(rounds, named, parameters),
        () if proposal else _ties(rounds),
        undecided,
        base,
        parameters,
        unidentified,
        (
            {}
            if proposal
            else {
                c.name: estimates(case.model, c.fit)
                for c in choices_of(rounds, undecided, named)
                if c.fit
            }
        ),
        proposal,
    )


def may_be_nothing(c: Conclusion) -> bool:
    """Return whether effects are named of which no strength is known to differ from 0."""
    return bool(c.effects) and not any(e.known_within(ANY_STRENGTH) for e in c.effects)


def without_effects(case: Case, outcome: SearchOutcome, c: Conclusion) -> SearchOutcome:
    """Return an outcome in which the effects of a conclusion stand in for something else that is
    missing.
    """
    first = replace(
        outcome.rounds[0], outcome="limit", ties=(), decision=stands_in([e.name for e in c.effects])
    )
    return replace(outcome, final=case.base, rounds=(first,))


def _after_withdrawal(
    case: Case, outcome: SearchOutcome, proposal: str
) -> tuple[FittedModel, tuple[SearchRound, ...], Comparison]:
    """Return final model, rounds and comparison, all effects withdrawn where they cannot be named.

    That is where wider bounds (`proposal`) do as well, or where the motion is uniform and a part
    stays unexplained.
    """
    base, rounds = case.base, outcome.rounds
    why = "it only makes up for bounds" if proposal else ""
    if not proposal:
        comparison = Comparison.of(case, outcome.final)
        added = outcome.final is not base and rounds[0].best
        if not (
            added
            and case.dataset.poor_excitation
            and comparison.closes_in_part(case, outcome.final)
        ):
            return outcome.final, rounds, comparison
        why = (
            f"'{added.name}' reduces the error only in part, and the motion is too uniform to"
            " identify it"
        )
    return base, (replace(rounds[0], outcome="withdrawn", decision=why),), Comparison.of(case, base)


def _ties(rounds: Sequence[SearchRound]) -> tuple[tuple[str, ...], ...]:
    """Return the ties of the effects that were added, and of the last round."""
    return tuple(
        tuple(sorted({r.best.name, *r.ties}))
        for r in rounds
        if r.best and r.ties and (r.named or r is rounds[-1])
    )


def _named(
    rounds: Sequence[SearchRound], names: Sequence[str], parameters: Estimates
) -> tuple[answer.Named, ...]:
    """Return the effects that are named, with gain and p of the rounds that added them."""
    by_name = {r.best.name: r for r in rounds if r.best and r.named}
    found = ((name, _of_effect(name, parameters), by_name[name]) for name in names)
    return tuple(
        answer.Named(name, group(name), own, r.gain, r.null.p(name, r.gain))
        for name, own, r in found
    )


def _of_effect(name: str, parameters: Estimates) -> dict[str, answer.Estimate]:
    """Return the parameters of an effect by their short names."""
    return {
        key.removeprefix(f"{name}."): e
        for key, e in parameters.items()
        if key.startswith(f"{name}.")
    }


def as_diagnosis(
    case: Case, c: Conclusion, whole: answer.WholeRecords, more: Additions
) -> answer.Diagnosis:
    """Return a conclusion as it is reported, with what whole records say."""
    model, dataset = case.model, case.dataset
    # not known before the wider bounds are tried
    remains = NOTHING_LEFT if c.proposal else c.remains
    poor = dataset.poor_excitation
    facts = Facts(
        c.verdict,
        c.gap,
        remains,
        c.effects,
        c.ties,
        c.parameters,
        c.unidentified,
        poor,
        model.wording,
        _hindrance(c),
    )
    lines = (
        (f"{TIGHT_BOUNDS} Proposed: {c.proposal}.",)
        if c.proposal
        else (*statement(facts), open_loop_line(whole, dataset.segments.seconds))
    )
    found = [f for r in case.records for f in r.findings]
    own = [
        *bound_lines(model, c.base, c.parameters),
        *_velocity_caveat(case, c),
        *_clock_lines(case, c),
    ]
    return answer.Diagnosis(
        verdict=c.verdict,
        statement=(*more.statement, *lines),
        effects=c.effects,
        ties=c.ties,
        experiment="" if c.proposal else experiment(facts),
        where=c.comparison.views,
        remains=remains,
        gap=c.gap,
        excitation=excitation(model, case.records),
        findings=(*more.findings_before, *found, *own, *more.findings_after),
        base=c.base,
        parameters=c.own_parameters,
        rounds=tuple(_round(r) for r in c.rounds),
        undetected={} if c.proposal else _undetected(case, c),
        traces=_traces(dataset, case.base.fit, c.final.fit),
        model=more.model or model,
        proposals=(c.proposal,) if c.proposal else (),
        whole=whole,
        choices={name: _of_effect(name, e) for name, e in c.choices.items()},
        choice_parameters={
            name: {k: v for k, v in e.items() if not k.startswith(f"{name}.")}
            for name, e in c.choices.items()
        },
    )


def _hindrance(c: Conclusion) -> str:
    """Return why nothing can be named although something is missing for certain; empty where the
    motion or a tie is the reason.
    """
    if c.rounds[-1].outcome == "limit":
        return c.rounds[-1].decision
    if c.rounds[-1].unfinished and not c.undecided:
        so_far = f"; so far, {c.rounds[-1].decision}" if c.rounds[-1].outcome == "rejected" else ""
        return (
            f"the time budget was used up before {len(c.rounds[-1].unfinished)} effects were tried"
            f" to the end{so_far}"
        )
    if c.remains.disturbance > DOMINANT_DISTURBANCE and not c.undecided:
        size = f"{c.remains.disturbance:.0%} of the input"
        return (
            f"the model needs a disturbance of {size} to follow them; check columns, signs and"
            " units"
        )
    return ""


def _unaligned(case: Case) -> bool:
    """True if it is not known how the positions of the records lie relative to each other."""
    return case.dataset.segments.velocity and len(case.records) > 1


def _velocity_caveat(case: Case, c: Conclusion) -> list[str]:
    """Return a line where an answer depends on the positions at which several records of velocities
    begin.
    """
    names = (*(e.name for e in c.effects), *c.undecided)
    depends = c.remains.flag or any(find_effect(name).position_dependent for name in names)
    return [VELOCITY_CAVEAT] if _unaligned(case) and depends else []


def _clock_lines(case: Case, c: Conclusion) -> list[str]:
    """Return a line on each named effect that depends on time, where each record has a clock of its
    own: what its time means.
    """
    given, fitted = case.dataset.segments, c.final.fit.simulator.segments
    if not given.own_clocks:
        return []
    names, lines = [piece.name for piece in given.pieces], []
    for effect in c.effects:
        timing = find_effect(effect.name).timing
        order = sorted(range(len(names)), key=lambda i: fitted.times[i])
        if timing == "course" and fitted.times == given.times:
            lines.append(begins_anew(effect.name))
        elif timing == "course":
            lines.append(
                f"{effect.name} goes on from one record to the next in the order given:"
                f" {', '.join(names)}"
            )
        elif timing == "event":
            onset = c.final.fit.values[f"{effect.name}.onset"]
            [*_, inside] = [i for i in order if fitted.times[i] <= onset] or order[:1]
            local = given.times[inside] + onset - fitted.times[inside]
            follow = ", ".join(names[i] for i in order)
            lines.append(
                f"{effect.name} sets in at {local:.4g} s by the clock of record {names[inside]};"
                f" its onset counts time over the records one after the other: {follow}"
            )
    return lines


def _undetected(case: Case, c: Conclusion) -> dict[str, str]:
    """Return for each effect that is neither named nor tied how large it may be without being
    detected.
    """
    last = c.rounds[-1]
    known = {*(e.name for e in c.effects), *c.undecided, *(name for tie in c.ties for name in tie)}
    added = last.best.name if last.best and last.named else ""
    limits = detection_limits(last.candidates, last.null, last.base)
    return undetected(limits, case.model, known, added, _unaligned(case))


def _with_effects(case: Case, outcome: SearchOutcome) -> Fit | None:
    """Return the fit with the effects that were found, or with the one that stands in for something
    else; None without any.
    """
    if outcome.final.servo.effects != case.base.servo.effects:
        return outcome.final.fit
    best = outcome.rounds[-1].best
    return best.fit if best and outcome.rounds[-1].outcome == "limit" else None


def wider_bounds(case: Case, found: Fit) -> str:
    """Return a proposal where wider bounds alone explain the records better than the effects found
    within them, or "".
    """
    values, bounds = case.base.fit.values, case.model.bounds
    tight = {
        f.name: f
        for f in case.base.servo.free
        if f.name in bounds and f.at_binding_bound(values[f.name])
    }
    if not tight:
        return ""
    free = tuple(f.widened(BOUND_FACTOR) if f.name in tight else f for f in case.base.servo.free)
    wide = fit_with_noise(case.dataset, replace(case.base.servo, free=free), values)
    price = (
        0.5
        * (len(found.free) - len(wide.fit.free))
        * math.log(np.count_nonzero(case.dataset.train) + 1.0)
    )
    return (
        "" if wide.fit.total < found.total - price else widening(case.model, tight, wide.fit.values)
    )


def widening(model: Model, tight: Mapping[str, Free], values: Mapping[str, float]) -> str:
    """Return the proposal to widen those tight bounds that the values of a better fit leave, or ""
    if they leave none.
    """
    lines = []
    for name, f in tight.items():
        value, unit = values[name], model.unit(name)
        if not f.low <= value <= f.high:  # the others are at a bound only because of these
            lines.append(
                f"{name} near {value:.3g} {unit}, outside its bounds [{f.low:.4g}, {f.high:.4g}]"
            )
    better = "without any effect better than with effects within the bounds"
    return f"wider bounds, since the records fit {' and '.join(lines)}, {better}" if lines else ""


def bound_lines(model: Model, plain: Estimates, whole: Estimates) -> list[str]:
    """Return a line on parameters of the plain model that end at a bound, and on whether they still
    do with what was found.
    """
    lines = []
    for name, e in plain.items():
        if e.at_bound:
            low, high = model.bounds.get(name, (-math.inf, math.inf))
            unit = "" if e.unit == "1" else f" {e.unit}"
            later = (
                ""
                if name not in whole or whole[name].at_bound
                else "; with what was found it does not"
            )
            advice = (
                "none is seen in these records"
                if e.value == 0.0 == low
                else "widen it if it may be wrong"
            )
            where = f"its bound {e.value:.4g}{unit} of [{low:.4g}, {high:.4g}]"
            lines.append(f"the base refit of {name} ends at {where}{later}: {advice}")
    return lines


def unidentified_parameters(plain: Estimates) -> tuple[str, ...]:
    """Return the parameters of the base model if the records determine none of them to within
    `KNOWN_HALF_WIDTH`.

    The output then hardly follows the input, and that no effect is found means nothing.
    """
    return () if any(e.known_within(KNOWN_HALF_WIDTH) for e in plain.values()) else tuple(plain)


def undecided_names(verdict: SearchRound) -> tuple[str, ...]:
    """Return the members of a tie that was not resolved, or what was withdrawn."""
    open_ = verdict.best and not verdict.named and (verdict.ties or verdict.outcome == "withdrawn")
    return tuple(sorted({verdict.best.name, *verdict.ties})) if verdict.best and open_ else ()


def choices_of(
    rounds: Sequence[SearchRound], undecided: Sequence[str], named: Sequence[str]
) -> list[Candidate]:
    """Return what may be chosen: the members of an open tie, or those that the last name stands
    for, if there is none.
    """
    if undecided:
        return [c for c in rounds[-1].candidates if c.name in undecided]
    v = next((v for v in reversed(rounds) if v.named), None)
    if v is None or v.best is None or v.best.name not in named:
        return []
    return [c for c in v.candidates if c.name in v.ties]


def unnamed(last: SearchRound, narrow: str, left: Unexplained, mute: Sequence[str] = ()) -> str:
    """Return the verdict where nothing was named; where the motion is uniform, what shows at all
    has many likenesses.

    Where a disturbance moves the servo as much as the input does, or the best effect stands in for
    something else, something is missing for certain.

    `mute` are the model's parameters if the records tell none of them.
    """
    classes = {group(name) for name in undecided_names(last)}
    if not classes:
        hidden = (
            last.outcome == "limit"
            or bool(last.unfinished)
            or left.disturbance > DOMINANT_DISTURBANCE
        )
        return (
            "not_identifiable"
            if mute or hidden or (narrow and (left.flag or last.best))
            else "none"
        )
    many = MOST_TIED_UNIFORM if narrow else MOST_TIED
    return "tie" if len(classes) <= many and last.outcome != "withdrawn" else "not_identifiable"


def _traces(dataset: Dataset, before: Fit, after: Fit) -> tuple[answer.Trace, ...]:
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
        traces.append(answer.Trace(piece.name, time_, u, piece.measured.ravel(), old, new, held))
    return tuple(traces)


def _refitted_to_all(dataset: Dataset, fitted: FittedModel) -> Fit:
    """Return a model refitted to all segments, held-out ones included."""
    problem = fitted.problem.only(dataset.segments.counted)
    return refit_nonsmooth(resume(problem, fitted.fit), lambda fit: problem, fitted.servo.effects)


def gap_between(case: Case, final: FittedModel) -> answer.Gap:
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
    return answer.Gap(before, after, min(alone, after), case.model.output_unit)


def known_floor(gap: answer.Gap, mixed: bool) -> answer.Gap:
    """Return a gap without the noise floor where that is not known.

    An unexplained part of the residual (`mixed`: a large one) is taken for noise, which is then no
    floor; nor is it where the error after the search is above the one before.
    """
    unknown = gap.after > gap.before or (
        mixed and gap.noise_floor is not None and gap.noise_floor >= gap.after
    )
    return replace(gap, noise_floor=None) if unknown else gap


def _round(v: SearchRound) -> answer.Round:
    """Return a round as it is reported."""
    bars = []
    for c in v.candidates:
        gain = c.fit.total - v.base if c.fit else math.nan
        a = c.assessment
        tested = (
            () if a is None else (a.error_reduction, a.predictive_gain, a.net_share, *a.deficit)
        )
        bars.append(answer.Candidate(c.name, gain, v.null.level(c.name), c.reason, *tested))
    bars.sort(key=lambda bar: math.inf if math.isnan(bar.gain) else -bar.gain)
    best = v.best.name if v.best else None
    top = best or (bars[0].name if bars else "")
    return answer.Round(
        tuple(bars),
        v.null.level(top),
        v.null.p(top, v.gain),
        best if v.named else None,
        v.decision,
        v.gain,
        v.assessment.error_reduction,
        v.finer_gain,
        best if v.outcome in ("rejected", "withdrawn") else None,
    )
