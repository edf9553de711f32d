"""The whole workflow: records and a model in, a `Diagnosis` out."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from bristle.common.errors import BristleError
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.checks.input_hold import with_input_share
from bristle.diagnosis.checks.plausibility import Plausibility, check
from bristle.diagnosis.checks.records import must_show
from bristle.diagnosis.conclusion import conclude, fall_between, gap_between
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel, fit_with_noise
from bristle.diagnosis.localisation.residual_localisation import localise
from bristle.diagnosis.localisation.unexplained import FinalModel, Unexplained, unexplained
from bristle.diagnosis.modelfile import BOUND_FACTOR, Model, must_be_model
from bristle.diagnosis.preparation import base_servo_of, dataset_of, nominal_gap, prepare_model
from bristle.diagnosis.report import result as answer
from bristle.diagnosis.selection.start_values import Progress, SearchOptions
from bristle.diagnosis.selection.stepwise import SearchOutcome, search
from bristle.records.clock import must_agree
from bristle.records.record import Record

MAKES_UP = "Effects explain these records, but they only make up for bounds that are too tight."


def diagnose(
    model: Model, records: Sequence[Record], progress: Progress | None = None, options: SearchOptions | None = None
) -> answer.Diagnosis:
    """Find where a model and records disagree, and name what is missing.

    Parameters
    ----------
    model : Model
        Friction law, nominal parameters and bounds; from `load_model`.
    records : sequence of Record
        From `load_records` or `records_from_arrays`; two or more are better than one.
    progress : function, optional
        Called with a text and the fraction done.
    options : SearchOptions, optional
        Of the search; its progress is told to `progress`.

    Returns
    -------
    Diagnosis
        Verdict, effects with parameters (SI) and intervals, ties, views, gap, and all else that the report shows.

    Raises
    ------
    BristleError
        If there is no record, one lasts less than 2 s, nothing moves in any of them, the input is constant in all, or the model
        cannot be simulated.
    """
    must_be(model, records)
    tell, started = teller(progress), time.perf_counter()
    with threadpool_limits(1, user_api="blas"):  # matrices are small: more threads only wait, and sum in another order
        while True:
            said, dataset = check(model, records), dataset_of(model, records)
            if said.proposals:
                gap = nominal_gap(dataset, *base_servo_of(model, dataset))
                return mend_first(model, records, said, gap, time.perf_counter() - started)
            tell("base refit", 0.0)
            dataset, base, lines = prepare_model(model, records, dataset)
            outcome = search(dataset, base, reporting(options or SearchOptions(), tell))
            if outcome.input_share is None:
                break
            records = with_input_share(records, outcome.input_share)
        found = examine(model, records, dataset, base, outcome, tell, started)
    return replace(found, findings=(*found.findings, *lines, *said.findings))


def reporting(options: SearchOptions, tell: Progress) -> SearchOptions:
    """Return the options of a search that reports its progress as a part of the whole diagnosis."""
    return replace(options, progress=lambda name, share: tell(f"trying {name}", 0.1 + 0.7 * share))


def teller(progress: Progress | None) -> Progress:
    """Return what progress is told to, if anybody; raise `BristleError` if that is no function."""
    if not (progress is None or callable(progress)):
        raise BristleError(f"progress is a {type(progress).__name__}; give a function of a text and the fraction done, or None")
    return progress or (lambda text, fraction: None)


def must_be(model: Model, records: Sequence[Record]) -> None:
    """Raise `BristleError` if these are not what they should be: paths, say, or plain arrays, or records that show nothing."""
    must_be_model(model)
    if not isinstance(records, Sequence) or not all(isinstance(record, Record) for record in records):
        raise BristleError("the records are not a list of Record; give what load_records or records_from_arrays returns")
    if not records:
        raise BristleError("no record is given; give at least one")
    must_agree(records)
    must_show(model, records)


def mend_first(
    model: Model, records: Sequence[Record], said: Plausibility, gap: float, seconds: float, lines: Sequence[str] = ()
) -> answer.Diagnosis:
    """Return a diagnosis that looked for nothing, because data and model do not speak of the same thing.

    `gap` is the mean squared error of the model as it is [output squared]; `lines` are findings to begin with.
    """
    why = "No effect was looked for: data and model disagree in a way that is more likely a mistake in one of them. Proposed: "
    proposed = "; ".join(line.rstrip(".") for line in said.proposals)
    end = "" if proposed.endswith("?") else "."
    return answer.Diagnosis(
        verdict="not_identifiable", statement=(f"{why}{proposed}{end}",), effects=(), ties=(), experiment="",
        where=(), remains=Unexplained(False, None, 0.0), gap=answer.Gap(gap, gap, None, model.output_unit),
        excitation=excitation(model, records), findings=(*lines, *(f for r in records for f in r.findings), *said.findings),
        base={}, parameters={}, rounds=(), undetected={}, traces=(), model=model, proposals=said.proposals, seconds=seconds,
    )  # fmt: skip


def examine(
    model: Model,
    records: Sequence[Record],
    dataset: Dataset,
    base: FittedModel,
    outcome: SearchOutcome,
    tell: Progress,
    begun: float,
) -> answer.Diagnosis:
    """Search on top of a fitted model, and say what was found; `begun` is when the work began [s, `time.perf_counter`]."""
    final, rounds = outcome.final, outcome.rounds
    if final.servo.effects != base.servo.effects and (line := better_unbound(model, dataset, base, final)):
        given = replace(rounds[0], outcome="withdrawn", decision="it only makes up for bounds")
        found = conclude(model, records, dataset, base, base, [given], begun)
        return replace(
            found, verdict="not_identifiable", statement=(f"{MAKES_UP} Proposed: {line}.",),
            ties=(), experiment="", choices={}, choice_parameters={}, proposals=(line,), undetected={},
            remains=Unexplained(False, None, 0.0),  # nothing is left with the wider bounds until they are tried
        )  # fmt: skip
    tell("what remains", 0.85)
    if dataset.poor_excitation and final is not base and _in_part(model, dataset, base, final):
        why = f"'{rounds[0].best.name if rounds[0].best else ''}' closes the gap only in part: too poor records to name it"
        final, rounds = base, (replace(rounds[0], outcome="withdrawn", decision=why),)
    return conclude(model, records, dataset, base, final, rounds, begun)


def _in_part(model: Model, dataset: Dataset, base: FittedModel, final: FittedModel) -> bool:
    """True if something remains beside what was found."""
    _, after = localise(dataset, base, final)
    gap = gap_between(model, dataset, base, final)
    return unexplained(after, FinalModel((), final.fit.values, dataset.turn, gap.left, fall_between(dataset, base, final))).flag


def better_unbound(model: Model, dataset: Dataset, base: FittedModel, final: FittedModel) -> str | None:
    """Return a proposal where wider bounds alone explain the records better than the effects that were found within them."""
    tight = {f.name: f for f in base.servo.free if f.name in model.bounds and f.at_binding_bound(base.fit.values[f.name])}
    if not tight:
        return None
    free = tuple(f.widened(BOUND_FACTOR) if f.name in tight else f for f in base.servo.free)
    wide = fit_with_noise(dataset, replace(base.servo, free=free), base.fit.values)
    price = 0.5 * (len(final.fit.free) - len(wide.fit.free)) * math.log(np.count_nonzero(dataset.train) + 1.0)
    if wide.fit.total < final.fit.total - price:
        return None
    lines = []
    for name, f in tight.items():
        value, unit = wide.fit.values[name], model.unit(name)
        if not f.low <= value <= f.high:  # others only made up for these
            lines.append(f"{name} near {value:.3g} {unit}, outside its bounds [{f.low:.4g}, {f.high:.4g}]")
    if not lines:
        return None
    return f"wider bounds, for without any effect the records fit {' and '.join(lines)}, better than any effect within the bounds"
