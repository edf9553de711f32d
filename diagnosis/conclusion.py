"""After the search: what was found, as a `Diagnosis`."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bristle.diagnosis.checks.excitation import VELOCITY_CAVEAT, excitation
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel, disturbance_ratio, has_outliers_or_disturbance
from bristle.diagnosis.estimation.likelihood import Fit, errors, mean_square, squares
from bristle.diagnosis.estimation.optimiser import refit_nonsmooth, resume
from bristle.diagnosis.estimation.uncertainty import estimates
from bristle.diagnosis.localisation.residual_localisation import localise
from bristle.diagnosis.localisation.unexplained import FinalModel, Unexplained, unexplained
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report import result as answer
from bristle.diagnosis.report.text import Facts, experiment, statement, undetected
from bristle.diagnosis.selection.candidates import Assessment, Candidate
from bristle.diagnosis.selection.criterion import SearchRound, group
from bristle.diagnosis.selection.detection_limit import detection_limits
from bristle.diagnosis.selection.effect_size import fall
from bristle.plant.effects import effect as find_effect
from bristle.records.record import Record

KNOWN_HALF_WIDTH = 0.3  # half an interval over the value, which of one parameter at least must be less
UNEXPLAINED_SHARE = 0.5  # share of the residual in a view from which the residual is no noise, whether reported or not
MOST_TIED, MOST_TIED_UNIFORM = 3, 2  # classes in a tie at most, and in records of uniform motion


def conclude(
    model: Model,
    records: Sequence[Record],
    dataset: Dataset,
    base: FittedModel,
    final: FittedModel,
    rounds: Sequence[SearchRound],
    begun: float,
) -> answer.Diagnosis:
    """Return the answer, parameters and intervals refitted to all segments; `begun` is when the work began [s]."""
    whole, plain = _whole(dataset, final), estimates(model, _whole(dataset, base))
    where, after = localise(dataset, base, final)
    last = rounds[-1]
    ties = [tuple(sorted({v.best.name, *v.ties})) for v in rounds if v.best and v.ties and (v.named or v is last)]
    named = final.servo.effects[len(model.effects) :]
    gap = gap_between(model, dataset, base, final)
    left = unexplained(
        after,
        FinalModel(
            named, final.fit.values, dataset.turn, gap.left, fall_between(dataset, base, final),
            has_outliers_or_disturbance(dataset, final.fit), disturbance_ratio(dataset, final.fit),
        ),
    )  # fmt: skip
    gap = known_floor(gap, left.flag or (left.view is not None and left.share > UNEXPLAINED_SHARE))
    undecided = undecided_names(last)
    mute = () if named or undecided else unidentified_parameters(plain)
    verdict = "named" if named else unnamed(last, dataset.poor_excitation, left, mute)
    intervals = estimates(model, whole, final.problem.only(dataset.segments.counted))
    of = {v.best.name: v for v in rounds if v.best and v.named}
    effects = tuple(
        answer.Named(
            name, group(name), {k.removeprefix(f"{name}."): v for k, v in intervals.items() if k.startswith(f"{name}.")},
            v.gain, v.null.p(name, v.gain),
        )
        for name, v in ((name, of[name]) for name in named)
    )  # fmt: skip
    own = {k: v for k, v in intervals.items() if not any(k.startswith(f"{name}.") for name in named)}
    choices = {c.name: estimates(model, c.fit) for c in choices_of(rounds, undecided, named) if c.fit}
    told = {*named, *undecided, *(name for tie in ties for name in tie)}
    added = last.best.name if last.best and last.named else ""
    adrift = dataset.segments.velocity and len(records) > 1
    placed = any(find_effect(name).position_dependent for name in (*named, *undecided))
    beginnings = [VELOCITY_CAVEAT] if adrift and (placed or left.flag) else []
    missed = undetected(detection_limits(last.candidates, last.null, last.base), model, told, added, adrift)
    facts = Facts(verdict, gap, left, effects, ties, intervals, mute, dataset.poor_excitation, model.wording)
    return answer.Diagnosis(
        verdict=verdict,
        statement=statement(facts),
        effects=effects,
        ties=tuple(ties),
        experiment=experiment(facts),
        where=where,
        remains=left,
        gap=gap,
        excitation=excitation(model, records),
        findings=(*(f for r in records for f in r.findings), *bound_lines(model, plain, intervals), *beginnings),
        base=plain,
        parameters=own,
        rounds=tuple(_round(v) for v in rounds),
        undetected=missed,
        traces=_traces(dataset, base.fit, final.fit),
        model=model,
        seconds=time.perf_counter() - begun,
        choices={n: {k.removeprefix(f"{n}."): v for k, v in e.items() if k.startswith(f"{n}.")} for n, e in choices.items()},
        choice_parameters={n: {k: v for k, v in e.items() if not k.startswith(f"{n}.")} for n, e in choices.items()},
    )


def bound_lines(model: Model, plain: Mapping[str, answer.Estimate], whole: Mapping[str, answer.Estimate]) -> list[str]:
    """Return a line on parameters of the plain model that end at a bound, and on whether they still do with what was found."""
    lines = []
    for name, e in plain.items():
        if e.at_bound:
            low, high = model.bounds.get(name, (-math.inf, math.inf))
            unit = "" if e.unit == "1" else f" {e.unit}"
            later = "" if name not in whole or whole[name].at_bound else "; with what was found it does not"
            advice = "none is seen in these records" if e.value == 0.0 == low else "widen it if it may be wrong"
            where = f"its bound {e.value:.4g}{unit} of [{low:.4g}, {high:.4g}]"
            lines.append(f"the base refit of {name} ends at {where}{later}: {advice}")
    return lines


def unidentified_parameters(plain: Mapping[str, answer.Estimate]) -> tuple[str, ...]:
    """Return the parameters of the plain model if the records tell none of them to within `KNOWN_HALF_WIDTH`.

    The output does not follow the input then, and that no effect helps says nothing.
    """
    told = any(
        e.ci95 is not None and not e.at_bound and e.ci95[1] - e.ci95[0] < 2 * KNOWN_HALF_WIDTH * abs(e.value)
        for e in plain.values()
    )
    return () if told else tuple(plain)


def undecided_names(verdict: SearchRound) -> tuple[str, ...]:
    """Return the members of a tie that was not resolved, or what was withdrawn."""
    open_ = verdict.best and not verdict.named and (verdict.ties or verdict.outcome == "withdrawn")
    return tuple(sorted({verdict.best.name, *verdict.ties})) if verdict.best and open_ else ()


def choices_of(rounds: Sequence[SearchRound], undecided: Sequence[str], named: Sequence[str]) -> list[Candidate]:
    """Return what may be chosen: the members of an open tie, or those that the last name stands for, if there is none."""
    if undecided:
        return [c for c in rounds[-1].candidates if c.name in undecided]
    v = next((v for v in reversed(rounds) if v.named), None)
    if v is None or v.best is None or v.best.name not in named:
        return []
    return [c for c in v.candidates if c.name in v.ties]


def unnamed(last: SearchRound, narrow: str, left: Unexplained, mute: Sequence[str] = ()) -> str:
    """Return the verdict where nothing was named; where the motion is uniform, what shows at all has many likenesses.

    `mute` are the model's parameters if the records tell none of them.
    """
    classes = {group(name) for name in undecided_names(last)}
    if not classes:
        return "not_identifiable" if mute or (narrow and (left.flag or last.best)) else "none"
    many = MOST_TIED_UNIFORM if narrow else MOST_TIED
    return "tie" if len(classes) <= many and last.outcome != "withdrawn" else "not_identifiable"


def _traces(dataset: Dataset, before: Fit, after: Fit) -> tuple[answer.Trace, ...]:
    """Return what was measured and simulated, an average a bin, record by record, start states at their best as in the gap."""
    s, first, traces = dataset.segments, 0, []
    whole = np.ones(len(dataset.held_out), dtype=bool)
    left = [np.where(fit.good[:, None], errors(fit, whole), np.nan) for fit in (before, after)]
    for piece in s.pieces:
        n = len(piece.measured)
        part = slice(first, first + n)
        time_ = piece.time + s.h * (s.width * np.arange(n * s.bins, dtype=np.float64) + (s.width - 1) / 2)
        held = np.repeat(dataset.held_out[part], s.bins)
        old, new = ((piece.measured - error[part]).ravel() for error in left)
        u = piece.u.reshape(-1, s.width).mean(axis=1)
        traces.append(answer.Trace(piece.name, time_, u, piece.measured.ravel(), old, new, held))
        first += n
    return tuple(traces)


def _whole(dataset: Dataset, fitted: FittedModel) -> Fit:
    """Return the servo fitted to all segments, those kept from the search included."""
    problem = fitted.problem.only(dataset.segments.counted)
    return refit_nonsmooth(resume(problem, fitted.fit), lambda fit: problem, fitted.servo.effects)


def gap_between(model: Model, dataset: Dataset, base: FittedModel, final: FittedModel) -> answer.Gap:
    """Return mean squares over the segments that were kept from the search, and what the noise alone would give."""
    before, after = mean_square(base.fit, dataset.held_out), mean_square(final.fit, dataset.held_out)
    noise = final.problem.noise
    cover = np.linalg.inv(noise.whiten)
    covariance_ = cover @ cover.T
    live = dataset.held_out & final.fit.good
    floor = []
    for columns in final.fit.output_by_initial[live]:
        q, r = np.linalg.qr(columns)
        q = q[:, np.abs(np.diag(r)) > 1e-9 * max(np.abs(r).max(), 1e-300)]
        floor.append(np.trace(covariance_) - np.trace(q.T @ covariance_ @ q))
    alone = float(np.mean(floor)) / dataset.segments.bins
    return answer.Gap(before, after, min(alone, after), model.output_unit)


def known_floor(gap: answer.Gap, mixed: bool) -> answer.Gap:
    """Return a gap without the noise floor where that is not known.

    What is unexplained (`mixed`: so much of what is left) is taken for noise, and then the noise that would do is no floor; nor is
    it where the error that was reached after is above the one before.
    """
    unknown = gap.after > gap.before or (mixed and gap.noise_floor is not None and gap.noise_floor >= gap.after)
    return replace(gap, noise_floor=None) if unknown else gap


def fall_between(dataset: Dataset, base: FittedModel, final: FittedModel) -> float:
    """Return the factor by which the error fell over the segments that were kept from the search."""
    return fall(squares(base.fit, dataset.held_out), squares(final.fit, dataset.held_out))


def _round(v: SearchRound) -> answer.Round:
    """Return a round as it is reported."""
    bars = []
    for c in v.candidates:
        gain = c.fit.total - v.base if c.fit else math.nan
        tested = () if c.assessment is None else _figures(c.assessment)
        bars.append(answer.Candidate(c.name, gain, v.null.level(c.name), c.reason, *tested))
    bars.sort(key=lambda bar: math.inf if math.isnan(bar.gain) else -bar.gain)
    best = v.best.name if v.best else None
    top = best or (bars[0].name if bars else "")
    return answer.Round(
        tuple(bars), v.null.level(top), v.null.p(top, v.gain), best if v.named else None, v.decision, v.gain,
        v.assessment.error_reduction, v.finer_gain, best if v.outcome in ("rejected", "withdrawn") else None,
    )  # fmt: skip


def _figures(assessment: Assessment) -> tuple[float, float, float, float]:
    """Return size, kept, behind and doubt of a candidate in a report."""
    return (assessment.error_reduction, assessment.held_out_gain, *assessment.deficit)
