"""The whole workflow: records and a model in, a `Diagnosis` or a `Validation` out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from bristle.common.deadline import until
from bristle.common.errors import BristleError
from bristle.common.progress import Progress, teller
from bristle.diagnosis.answer import (
    Diagnosis,
    Finding,
    Line,
    Reason,
    Validation,
    finding,
)
from bristle.diagnosis.between.two_positions import between_sensors
from bristle.diagnosis.checks.input_hold import with_input_share
from bristle.diagnosis.checks.preparation import (
    PreparedCase,
    notes_of,
    prepared_case,
)
from bristle.diagnosis.checks.records import as_inputs, check_arguments
from bristle.diagnosis.experiment.design import designed_experiment
from bristle.diagnosis.fmu.fmu_case import prepared_fmu_case
from bristle.diagnosis.fmu.plant_fmu import plant_fmu, unit_notes
from bristle.diagnosis.following.gains import seen_controller
from bristle.diagnosis.following.whole_loop import following_case
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.selection.start_values import SearchOptions
from bristle.diagnosis.selection.stepwise import SearchOutcome, search
from bristle.diagnosis.stages.agreement import agreement
from bristle.diagnosis.stages.case import Budget, SearchedCase, Stage
from bristle.diagnosis.stages.conclusion import conclude, may_be_nothing, without_effects
from bristle.diagnosis.stages.doubt import suspected
from bristle.diagnosis.stages.remarks import remarks
from bristle.diagnosis.stages.sliding_motion import from_sliding_motion
from bristle.diagnosis.stages.unnamed_torque import unnamed_torque
from bristle.diagnosis.validation.validate import (
    model_simulation,
    on_one_clock,
    validated,
    validated_fmu,
)
from bristle.diagnosis.validation.whole_records import (
    as_fitted_to_segments,
    refitted_to_whole_records,
)
from bristle.records.record import Record

# of a time budget: after it no further effect is tried, and those under way are left
SEARCH_SHARE = 0.6
# of a time budget: after it effects are no longer compared, nor one refitted that was found
COMPARISON_SHARE = 0.75


@dataclass(frozen=True)
class Step:
    """A stage after the search, and what a time budget does to it."""

    stage: Stage
    share: float = 1.0  # of a time budget: after it the stage is not begun
    # what is then left out; None if the stage is run in any case
    left_out: Reason | None = None
    otherwise: Stage | None = None  # what is done in its place
    told: tuple[str, float] | None = None  # progress


# the errors and the parameters over whole records, on which the verdict may turn
WHOLE_RECORDS = Step(
    refitted_to_whole_records,
    0.8,
    Reason.NOT_REFITTED,
    as_fitted_to_segments,
    ("whole records", 0.9),
)
LATER_STEPS = (  # after that
    Step(remarks),
    Step(unnamed_torque, 0.8, Reason.NO_UNNAMED_TORQUE),
    Step(agreement, 0.8, Reason.NOT_COMPARED_RECORDS),
    Step(suspected),
    Step(designed_experiment, 0.9, Reason.NO_DESIGNED_INPUT, told=("what to measure next", 0.95)),
)

# what makes a case of records and their notes, or a diagnosis where nothing can be searched
Prepare = Callable[[Sequence[Record], tuple[Line, ...]], PreparedCase | Diagnosis]


# -- diagnosis -------------------------------------------------------------------------------------
def diagnose(
    model: Model,
    records: Sequence[Record],
    progress: Progress | None = None,
    options: SearchOptions | None = None,
) -> Diagnosis:
    """Find where a model and records disagree, and name what is missing.

    Parameters
    ----------
    model : Model
        Friction law, nominal parameters and bounds; from `load_model`.
    records : sequence of Record
        From `load_records` or `records_from_arrays`; two or more are better than one.
    progress : function, optional
        Called with a text and the fraction done; by default both are shown on a terminal and in a
        notebook.
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
    prepare = prepared_case if model.controller is None else following_case
    with teller("diagnose", progress) as tell:
        answer = search_prepared(
            lambda given, notes: prepare(model, given, notes, tell),
            as_inputs(model, records),
            tell,
            options,
        )
    return replace(
        answer,
        between=between_sensors(model, records),
        seen_controller=seen_controller(model, records),
    )


def diagnose_fmu(
    fmu_path: Path,
    model: Model,
    records: Sequence[Record],
    progress: Progress | None = None,
    options: SearchOptions | None = None,
    timeout: float | None = None,
) -> Diagnosis:
    """Find where a plant FMU and records disagree, and name what the FMU lacks.

    Parameters
    ----------
    fmu_path : Path
        Co-Simulation FMU of FMI 2 or 3 with input u and output theta, or v where the records hold
        velocities. It runs in a process of its own.
    model : Model
        What the records hold, and a law and nominal parameters that come near the FMU's;
        `fmu_model`, or from a file.
    records : sequence of Record
        From `load_records` or `records_from_arrays`; two or more are better than one.
    progress : function, optional
        Called with a text and the fraction done; by default both are shown on a terminal and in a
        notebook.
    options : SearchOptions, optional
        Of the search; its progress is reported to `progress`.
    timeout : float, optional
        Seconds that the simulation of the FMU may take.

    Returns
    -------
    Diagnosis
        `model` has the parameters that the FMU behaves like; `findings` say how the FMU was run,
        how closely the fitted servo follows it, and which of its parameters look wrong. Verdict
        not_identifiable if the servo does not follow.

    Raises
    ------
    BristleError
        If the FMU cannot be read, lacks these variables, crashes or refuses a step; or the records
        are too short.
    """
    check_arguments(model, records)
    fmu = plant_fmu(fmu_path, model)
    with teller("diagnose", progress) as tell:

        def prepare(given: Sequence[Record], notes: tuple[Line, ...]) -> PreparedCase | Diagnosis:
            return prepared_fmu_case(fmu, model, given, notes, (tell, timeout))

        answer = search_prepared(prepare, as_inputs(model, records), tell, options)
    return replace(
        answer,
        between=between_sensors(model, records),
        seen_controller=seen_controller(model, records),
    )


def search_prepared(
    prepare: Prepare,
    records: Sequence[Record],
    tell: Progress,
    options: SearchOptions | None = None,
) -> Diagnosis:
    """Return the diagnosis of what `prepare` makes of the records."""
    budget = Budget(options or SearchOptions(), time.perf_counter())
    # matrices are small: more threads only wait, and sum in another order
    with threadpool_limits(1, user_api="blas"):
        searched = _searched(prepare, records, tell, budget)
        answer = searched if isinstance(searched, Diagnosis) else _answered(*searched, tell, budget)
    return replace(answer, seconds=time.perf_counter() - budget.started)


def _searched(
    prepare: Prepare, records: Sequence[Record], tell: Progress, budget: Budget
) -> tuple[PreparedCase, SearchOutcome] | Diagnosis:
    """Return the prepared case and what its search found, or a diagnosis where nothing was
    searched.

    Where the search finds that the input was held otherwise than the records say, they are
    corrected and prepared again; where it finds nothing, a case that can be prepared otherwise is.
    """
    held = tuple[Finding, ...]()
    given = records
    options = replace(budget.options, deadline=budget.until(SEARCH_SHARE))

    def searched(case: PreparedCase) -> SearchOutcome:
        with until(budget.until(COMPARISON_SHARE)):
            own = replace(options, guess=case.model.parameters, joint=case.joint)
            return search(case.dataset, case.base, _reporting(own, tell))

    while True:
        prepared = prepare(records, notes_of(given, held))
        if isinstance(prepared, Diagnosis):
            return prepared
        outcome = searched(prepared)
        if prepared.otherwise and outcome.in_vain and not options.late:
            prepared = prepared.otherwise()
            outcome = searched(prepared)
        if outcome.input_share is None:
            return prepared, outcome
        records, more = with_input_share(records, outcome.input_share)
        held = (*held, *more)


def _answered(
    prepared: PreparedCase, outcome: SearchOutcome, tell: Progress, budget: Budget
) -> Diagnosis:
    """Return what follows from a search, stage by stage."""
    tell("residual", 0.85)
    case, answer = conclude(prepared, outcome)
    answer = from_sliding_motion(case, answer, budget)
    answer, late = _taken(WHOLE_RECORDS, case, answer, tell, budget)
    # effects of which no strength is known over whole records either stand in for something else
    if may_be_nothing(answer):
        case, answer = conclude(prepared, without_effects(prepared, outcome, answer))
        answer, late = _taken(WHOLE_RECORDS, case, answer, tell, budget)
    left_out = [late]
    for step in LATER_STEPS:
        answer, late = _taken(step, case, answer, tell, budget)
        left_out.append(late)
    cut = _cut_short(outcome, budget, [finding(reason) for reason in left_out if reason])
    return replace(answer, notes=(*answer.notes, *cut))


def _taken(
    step: Step, case: SearchedCase, answer: Diagnosis, tell: Progress, budget: Budget
) -> tuple[Diagnosis, Reason | None]:
    """Return the answer after a step, and what it left out for want of time."""
    if step.told:
        tell(*step.told)
    if step.left_out is None:
        return step.stage(case, answer, budget), None
    done = budget.within(step.share, lambda: step.stage(case, answer, budget))
    if done is not None:
        return done, None
    return step.otherwise(case, answer, budget) if step.otherwise else answer, step.left_out


def _cut_short(outcome: SearchOutcome, budget: Budget, later: Sequence[Finding]) -> list[Finding]:
    """Return what is said of what a time budget left out, of the search and `later`, if it did."""
    unfinished = outcome.rounds[-1].said.unfinished
    left = [finding(Reason.EFFECTS_UNFINISHED, effects=unfinished)] if unfinished else []
    left += [outcome.cut_short] if outcome.cut_short and not left else []
    left += later
    seconds = budget.options.budget
    return [finding(Reason.BUDGET_USED, seconds=seconds, left_out=tuple(left))] if left else []


def _reporting(options: SearchOptions, tell: Progress) -> SearchOptions:
    """Return the options of a search that reports its progress as a part of the whole diagnosis."""
    return replace(options, progress=lambda name, share: tell(f"trying {name}", 0.1 + 0.7 * share))


# -- validation ------------------------------------------------------------------------------------
def validate(
    model: Model, records: Sequence[Record], start_samples: int | None = None
) -> Validation:
    """Simulate a model over records in open loop, and compare.

    Parameters
    ----------
    model : Model
        From `load_model`: a model file, or the augmented.toml of a diagnosis. Nothing of it is
        fitted.
    records : sequence of Record
        From `load_records` or `records_from_arrays`. Position and velocity at their starts are
        fitted.
    start_samples : int, optional
        Simulate each record also from a start that is fitted to so many of its first samples alone,
        and give the errors after them, as benchmarks of identification do.

    Returns
    -------
    Validation
        Errors of every record over its whole length and over shorter horizons.

    Raises
    ------
    BristleError
        If there is no record, or the model cannot be simulated.
    """
    check_arguments(model, records)
    if model.controller is not None and "kp" not in model.controller:
        raise BristleError(
            "the model: controller.kp is not given, and nothing is fitted here; validate the"
            " augmented.toml of a diagnosis, or give kp"
        )
    records, notes = on_one_clock(model, as_inputs(model, records))
    name = model.friction if model.path is None else model.path.name
    simulation = model_simulation(model, records[0].h)
    return validated(name, model, records, simulation, notes, start_samples)


def validate_fmu(
    fmu_path: Path,
    model: Model,
    records: Sequence[Record],
    timeout: float | None = None,
    start_samples: int | None = None,
) -> Validation:
    """Simulate a plant FMU over records in open loop, and compare.

    Parameters
    ----------
    fmu_path : Path
        Co-Simulation FMU of FMI 2 or 3 with input u and output theta, or v where the records hold
        velocities. It runs in a process of its own. Where it can be started from the measured
        position and velocity, it is, and the position is fitted.
    model : Model
        What the records hold; `fmu_model`, or from a file.
    records : sequence of Record
        From `load_records` or `records_from_arrays`.
    timeout : float, optional
        Seconds that a simulation may take.
    start_samples : int, optional
        As of `validate`.

    Returns
    -------
    Validation
        As of `validate`; of an FMU that cannot be started from a given state, over whole records
        alone.

    Raises
    ------
    BristleError
        If the FMU cannot be read, lacks these variables, crashes, takes longer than `timeout` or
        refuses a step.
    """
    check_arguments(model, records)
    fmu = plant_fmu(fmu_path, model)
    notes = unit_notes(fmu, model)
    return validated_fmu(fmu, model, records, notes, timeout, start_samples)
