"""The whole workflow: records and a model in, a `Diagnosis` out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from threadpoolctl import threadpool_limits

from bristle.common.deadline import until, within
from bristle.common.errors import BristleError
from bristle.diagnosis.agreement import agreement, with_agreement, without_floor
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.checks.input_hold import with_input_share
from bristle.diagnosis.checks.plausibility import Plausibility, check
from bristle.diagnosis.checks.records import must_show
from bristle.diagnosis.conclusion import (
    NOTHING_LEFT,
    Additions,
    Case,
    Conclusion,
    as_diagnosis,
    conclude,
    may_be_nothing,
    without_effects,
)
from bristle.diagnosis.experiment.design import design
from bristle.diagnosis.experiment.sentence import designed_line
from bristle.diagnosis.filling import unnamed_torque, with_unnamed_torque
from bristle.diagnosis.modelfile import Model, must_be_model
from bristle.diagnosis.preparation import base_servo_of, dataset_of, nominal_gap, prepare_model
from bristle.diagnosis.report import result as answer
from bristle.diagnosis.selection.start_values import Progress, SearchOptions
from bristle.diagnosis.selection.stepwise import SearchOutcome, search
from bristle.diagnosis.whole.refit import refit_to_whole_records
from bristle.records.clock import must_agree
from bristle.records.record import Record

# of a time budget: after it no further effect is tried, and those under way are left
SEARCH_SHARE = 0.6
# of a time budget: after it effects are no longer compared, nor one refitted that was found
COMPARISON_SHARE = 0.75
# of a time budget: after it parameters are not refitted to whole records, and no unnamed torque is
# fitted
REFIT_SHARE = 0.8
DESIGN_SHARE = 0.9  # of a time budget: after it no experiment is designed

T = TypeVar("T")


def diagnose(
    model: Model,
    records: Sequence[Record],
    progress: Progress | None = None,
    options: SearchOptions | None = None,
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
        Of the search; its progress is reported to `progress`.

    Returns
    -------
    Diagnosis
        Verdict, effects with parameters (SI) and intervals, ties, views, gap, and all else that the
        report shows.

    Raises
    ------
    BristleError
        If there is no record, one lasts less than 2 s, nothing moves in any of them, the input is
        constant in all, or the model cannot be simulated.
    """
    check_arguments(model, records)
    tell = teller(progress)
    return search_prepared(
        lambda given: _prepared(model, given, tell), records, tell, options or SearchOptions()
    )


@dataclass(frozen=True)
class Prepared:
    """A case to be searched, and what is added to its diagnosis once the conclusion is known."""

    case: Case
    additions: Callable[[Conclusion], Additions]


# a diagnosis where nothing can be searched
Prepare = Callable[[Sequence[Record]], Prepared | answer.Diagnosis]


def _prepared(
    model: Model, records: Sequence[Record], tell: Progress
) -> Prepared | answer.Diagnosis:
    """Return the model fitted to the records, or a diagnosis where both seem to describe different
    things.
    """
    said, dataset = check(model, records), dataset_of(model, records)
    if said.proposals:
        return not_searched(
            model, records, nominal_gap(dataset, *base_servo_of(model, dataset)), implausible(said)
        )
    tell("base refit", 0.0)
    dataset, base, lines = prepare_model(model, records, dataset)
    return Prepared(
        Case(model, records, dataset, base),
        lambda found: Additions(findings_after=(*lines, *said.findings)),
    )


def search_prepared(
    prepare: Prepare, records: Sequence[Record], tell: Progress, options: SearchOptions
) -> answer.Diagnosis:
    """Return the diagnosis of what `prepare` makes of the records.

    Where the search finds that the input was held otherwise than the records say, they are
    corrected and prepared again.
    """
    started = time.perf_counter()
    options = replace(options, deadline=started + SEARCH_SHARE * options.budget)

    def in_time(begin: float, result: Callable[[], T]) -> T | None:
        """Return a result, None where a share of the budget is gone before it is begun, or all of
        it before it is there.
        """
        late = time.perf_counter() > started + begin * options.budget
        return None if late else within(started + options.budget, result)

    def over_whole_records(
        case: Case, found: Conclusion
    ) -> tuple[bool | None, tuple[Conclusion, answer.WholeRecords]]:
        """Return a conclusion over whole records, and first None where no time was left for a refit
        to these.
        """
        refit = in_time(REFIT_SHARE, lambda: refit_to_whole_records(case, found))
        return (True, refit) if refit else (None, refit_to_whole_records(case, found, refit=False))

    # matrices are small: more threads only wait, and sum in another order
    with threadpool_limits(1, user_api="blas"):
        while True:
            prepared = prepare(records)
            if isinstance(prepared, answer.Diagnosis):
                return replace(prepared, seconds=time.perf_counter() - started)
            with until(started + COMPARISON_SHARE * options.budget):
                outcome = search(
                    prepared.case.dataset, prepared.case.base, _reporting(options, tell)
                )
            if outcome.input_share is None:
                break
            records = with_input_share(records, outcome.input_share)
        tell("residual", 0.85)
        found = conclude(prepared.case, outcome)
        tell("whole records", 0.9)
        case = prepared.case
        in_full, (refitted, whole) = over_whole_records(case, found)
        if may_be_nothing(refitted):
            found = conclude(case, without_effects(case, outcome, refitted))
            in_full, (refitted, whole) = over_whole_records(case, found)
        more = prepared.additions(found)
        fill = in_time(REFIT_SHARE, lambda: [unnamed_torque(case, found)])
        agree = in_time(REFIT_SHARE, lambda: [agreement(case, found)])
        tell("what to measure next", 0.95)
        ask = in_time(DESIGN_SHARE, lambda: [design(case, found, options)])
        done = {
            "parameters were not refitted to whole records": in_full,
            "no unnamed torque": fill,
            "records were not compared for their parameters": agree,
            "no input of a further record": ask,
        }
        left = _cut_short(outcome, options, [what for what, was in done.items() if was is None])
        more = replace(more, findings_after=(*more.findings_after, *left))
        [unnamed], [agrees], [designed] = fill or [None], agree or [None], ask or [None]
        said = as_diagnosis(case, without_floor(refitted, agrees), whole, more)
        said = with_agreement(with_unnamed_torque(said, unnamed), agrees)
        text = " ".join(filter(None, (said.experiment, designed_line(designed, case.model))))
        return replace(
            said, experiment=text, designed=designed, seconds=time.perf_counter() - started
        )


def _cut_short(outcome: SearchOutcome, options: SearchOptions, later: Sequence[str]) -> list[str]:
    """Return a line on what a time budget left out, of the search and after it (`later`), if it
    did.
    """
    unfinished = ", ".join(outcome.rounds[-1].unfinished)
    left = [f"effects not tried to the end in the last round: {unfinished}"] if unfinished else []
    left += [outcome.cut_short] if outcome.cut_short and not left else []
    left += later
    return (
        [f"the time budget of {options.budget:g} s was used up: {'; '.join(left)}"] if left else []
    )


def _reporting(options: SearchOptions, tell: Progress) -> SearchOptions:
    """Return the options of a search that reports its progress as a part of the whole diagnosis."""
    return replace(options, progress=lambda name, share: tell(f"trying {name}", 0.1 + 0.7 * share))


def teller(progress: Progress | None) -> Progress:
    """Return what progress is reported to, if anything; raise `BristleError` if that is no
    function.
    """
    if not (progress is None or callable(progress)):
        raise BristleError(
            f"progress is a {type(progress).__name__}; give a function of a text and the fraction"
            " done, or None"
        )
    return progress or (lambda text, fraction: None)


def check_arguments(model: Model, records: Sequence[Record]) -> None:
    """Raise `BristleError` if these are not what they should be: paths, say, or plain arrays, or
    records that show nothing.
    """
    must_be_model(model)
    if not isinstance(records, Sequence) or not all(
        isinstance(record, Record) for record in records
    ):
        raise BristleError(
            "the records are not a list of Record; give what load_records or records_from_arrays"
            " returns"
        )
    if not records:
        raise BristleError("no record is given; give at least one")
    must_agree(records)
    must_show(model, records)


def implausible(said: Plausibility, lines: Sequence[str] = ()) -> Additions:
    """Return what is reported where data and model seem to describe different things; `lines` are
    findings to begin with.
    """
    why = (
        "No effect was tried: data and model disagree in a way that is more likely a mistake in one"
        " of them. Proposed: "
    )
    proposed = "; ".join(line.rstrip(".") for line in said.proposals)
    return Additions(
        [f"{why}{proposed}{'' if proposed.endswith('?') else '.'}"],
        lines,
        said.findings,
        proposals=said.proposals,
    )


def not_searched(
    model: Model, records: Sequence[Record], gap: float, said: Additions
) -> answer.Diagnosis:
    """Return a diagnosis without a search; `gap` is the mean squared error of the model [output
    squared], `said` is why.
    """
    return answer.Diagnosis(
        verdict="not_identifiable",
        statement=tuple(said.statement),
        effects=(),
        ties=(),
        experiment="",
        where=(),
        remains=NOTHING_LEFT,
        gap=answer.Gap(gap, gap, None, model.output_unit),
        excitation=excitation(model, records),
        findings=(
            *said.findings_before,
            *(f for r in records for f in r.findings),
            *said.findings_after,
        ),
        base={},
        parameters={},
        rounds=(),
        undetected={},
        traces=(),
        model=model,
        proposals=said.proposals,
    )
