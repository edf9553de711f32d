"""A plant FMU of any origin as the model: a servo is fitted to it, and the search runs on that
servo in its place.

The difference between FMU and servo, from the same states and with the same input, is subtracted
from the measured output. An effect that is then missing in the servo is missing in the FMU.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from bristle.common.errors import BristleError
from bristle.common.progress import Progress
from bristle.diagnosis.answer import Diagnosis, Finding, Line, Reason, finding
from bristle.diagnosis.checks.plausibility import check
from bristle.diagnosis.checks.preparation import (
    PreparedCase,
    base_servo_of,
    dataset_of,
    implausible,
    nominal_gap,
    not_searched,
)
from bristle.diagnosis.estimation.fitted_model import fit_from_several_starts
from bristle.diagnosis.estimation.likelihood import mean_square
from bristle.diagnosis.fmu.equivalent_servo import (
    EquivalentServo,
    fit_equivalent_servo,
    search_bounds,
    widened_bounds,
)
from bristle.diagnosis.fmu.plant_fmu import unit_notes
from bristle.diagnosis.fmu.simulated_segments import simulate_segments
from bristle.diagnosis.modelfile import Model
from bristle.fmus.host import Fmu
from bristle.records.record import Record

# of the error that a refit to the records leaves: largest error of a servo that replaces the FMU
FMU_ERROR_RATIO = 0.5
FMU_PARAMETER_ERROR = 0.02  # relative difference up to which a parameter is not reported


def prepared_fmu_case(
    fmu: Fmu,
    model: Model,
    records: Sequence[Record],
    notes: tuple[Line, ...],
    told: tuple[Progress, float | None],
) -> PreparedCase | Diagnosis:
    """Return a servo fitted to the FMU and then to the records, or a diagnosis where that makes no
    sense; `told`: where progress goes, and the seconds that a simulation may take.
    """
    tell, timeout = told
    if model.known:
        raise BristleError("[known] is no input of a plant FMU; diagnose with a model file instead")
    dataset, said = dataset_of(model, records), check(model, records)
    segments, how = simulate_segments(fmu, dataset, tell, timeout)
    simulated = replace(dataset, segments=segments)
    lines: tuple[Finding, ...] = (how, *unit_notes(fmu, model))
    if said.corrections:
        gap = nominal_gap(simulated, *base_servo_of(model, simulated))
        return implausible(model, records, gap, said, (*lines, *notes))
    # a servo that follows the FMU, and the same refitted to the records
    tell("fitting a servo to the FMU", 0.05)
    twin = fit_equivalent_servo(model, dataset, simulated)
    lines = (*lines, _closeness(fmu, model, twin))
    like = replace(model, parameters={name: float(twin.values[name]) for name in model.parameters})
    free = replace(like, bounds=search_bounds(model, twin))
    base = fit_from_several_starts(twin.dataset, *base_servo_of(free, twin.dataset))
    left = mean_square(base.fit, twin.dataset.held_out)
    kept = replace(like, bounds=widened_bounds(model, like.parameters))
    if twin.error > max(FMU_ERROR_RATIO * math.sqrt(left), base.problem.noise.sensor):
        why = _not_followed(kept, twin, left)
        return not_searched(kept, records, left, why, (*lines, *notes))

    def remark(answer: Diagnosis) -> Diagnosis:
        wrong = _wrong_parameters(fmu, answer, twin)
        agrees = not (wrong or answer.verdict != "none" or answer.remains.flag)
        leads = (_agreement(fmu, answer, twin),) if agrees else ()
        return replace(answer, leads=leads, notes=(*lines, *wrong, *answer.notes), model=kept)

    return PreparedCase(free, records, twin.dataset, base, notes, remark=remark)


# -- what is said ----------------------------------------------------------------------------------
def _closeness(fmu: Fmu, model: Model, twin: EquivalentServo) -> Finding:
    return finding(
        Reason.FMU_FOLLOWED,
        fmu=fmu.path.name,
        law=model.friction,
        effects=tuple(model.effects),
        error=twin.error,
        gap=twin.gap,
        unit=model.output_unit,
    )


def _agreement(fmu: Fmu, answer: Diagnosis, twin: EquivalentServo) -> Finding:
    """Return the answer where nothing is missing and no parameter is wrong."""
    alone, unit = math.sqrt(answer.gap.noise_floor or 0.0), answer.gap.output_unit
    errors = {"gap": twin.gap, "noise_floor": alone, "unit": unit}
    return finding(Reason.FMU_AGREES, fmu=fmu.path.name, **errors)


def _wrong_parameters(fmu: Fmu, answer: Diagnosis, twin: EquivalentServo) -> list[Finding]:
    """Return what is said of each parameter of the FMU that the segments contradict, what was found
    taken into account.
    """
    named = {effect.name for effect in answer.effects}
    assert answer.whole is not None
    notes = []
    for name, e in answer.whole.segment_parameters.items():
        value = twin.values.get(name)
        if value is None or e.ci95 is None or name.split(".")[0] in named:
            continue
        near = abs(value - e.value) <= FMU_PARAMETER_ERROR * abs(e.value)
        if near or e.ci95[0] <= value <= e.ci95[1]:
            continue
        seen = {"of_fmu": value, "of_records": e.value, "ci95": e.ci95}
        which = {"name": name, "fmu": fmu.path.name, "unit": e.unit, "at_bound": e.at_bound}
        notes.append(finding(Reason.FMU_PARAMETER, **which, **seen))
    return notes


def _not_followed(like: Model, twin: EquivalentServo, left: float) -> Finding:
    """Return why the servo cannot replace the FMU; `left` is its mean square when refitted to the
    records [output squared].
    """
    errors = {"error": twin.error, "left": math.sqrt(left), "unit": like.output_unit}
    return finding(Reason.FMU_NOT_FOLLOWED, law=like.friction, **errors)
