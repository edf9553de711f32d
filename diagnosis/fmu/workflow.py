"""A plant FMU of any origin as the model: a servo is fitted to it, and the search runs on that
servo in its place.

The difference between FMU and servo, from the same states and with the same input, is subtracted
from the measured output. An effect that is then missing in the servo is missing in the FMU.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bristle.common.errors import BristleError, suggest
from bristle.diagnosis.checks.plausibility import check
from bristle.diagnosis.conclusion import Additions, Case, Conclusion
from bristle.diagnosis.estimation.fitted_model import fit_from_several_starts
from bristle.diagnosis.estimation.likelihood import mean_square
from bristle.diagnosis.fmu.equivalent_servo import (
    EquivalentServo,
    fit_equivalent_servo,
    search_bounds,
    widened_bounds,
)
from bristle.diagnosis.fmu.simulated_segments import simulate_segments
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.preparation import base_servo_of, dataset_of, nominal_gap
from bristle.diagnosis.report import result as answer
from bristle.diagnosis.selection.start_values import Progress, SearchOptions
from bristle.diagnosis.workflow import (
    Prepared,
    check_arguments,
    implausible,
    not_searched,
    search_prepared,
    teller,
)
from bristle.fmus.alias import alias
from bristle.fmus.host import Fmu
from bristle.fmus.playback import INPUT
from bristle.records.record import Record

# of the error that a refit to the records leaves: largest error of a servo that replaces the FMU
FMU_ERROR_RATIO = 0.5
FMU_PARAMETER_ERROR = 0.02  # relative difference up to which a parameter is not reported


def diagnose_fmu(
    fmu_path: Path,
    model: Model,
    records: Sequence[Record],
    progress: Progress | None = None,
    options: SearchOptions | None = None,
    timeout: float | None = None,
) -> answer.Diagnosis:
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
        Called with a text and the fraction done.
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
    tell = teller(progress)
    fmu = plant_fmu(fmu_path, model)
    return search_prepared(
        lambda given: _prepared(fmu, model, given, tell, timeout),
        records,
        tell,
        options or SearchOptions(),
    )


def _prepared(
    fmu: Fmu, model: Model, records: Sequence[Record], tell: Progress, timeout: float | None
) -> Prepared | answer.Diagnosis:
    """Return a servo fitted to the FMU and then to the records, or a diagnosis where that makes no
    sense.
    """
    dataset, said = dataset_of(model, records), check(model, records)
    segments, lines = simulate_segments(fmu, dataset, tell, timeout)
    lines += unit_lines(fmu, model)
    if said.proposals:
        simulated = replace(dataset, segments=segments)
        return not_searched(
            model,
            records,
            nominal_gap(simulated, *base_servo_of(model, simulated)),
            implausible(said, lines),
        )
    tell("fitting a servo to the FMU", 0.05)
    twin = fit_equivalent_servo(model, dataset, replace(dataset, segments=segments))
    lines.append(_closeness(fmu, model, twin))
    like = replace(model, parameters={name: float(twin.values[name]) for name in model.parameters})
    free = replace(like, bounds=search_bounds(model, twin))
    base = fit_from_several_starts(twin.dataset, *base_servo_of(free, twin.dataset))
    left = mean_square(base.fit, twin.dataset.held_out)
    kept = replace(like, bounds=widened_bounds(model, like.parameters))
    if twin.error > max(FMU_ERROR_RATIO * math.sqrt(left), base.problem.noise.sensor):
        return not_searched(kept, records, left, Additions([_why_refused(kept, twin, left)], lines))

    def additions(found: Conclusion) -> Additions:
        wrong = _wrong(fmu, found, twin)
        agrees = (
            []
            if wrong or found.verdict != "none" or found.remains.flag
            else [_agreement(fmu, found, twin)]
        )
        return Additions(agrees, (*lines, *wrong), model=kept)

    return Prepared(Case(free, records, twin.dataset, base), additions)


def plant_fmu(path: Path, model: Model) -> Fmu:
    """Return a plant FMU under the names that the model gives its variables.

    Raises
    ------
    BristleError
        If the FMU cannot be read, or lacks the variables that the records speak of.
    """
    units = {
        name: model.unit_in_fmu(name, unit)
        for name, unit in (("u", "V"), ("theta", "rad"), ("v", "rad/s"))
    }
    aliases = {}
    for key, given in model.variables.items():
        where = f"{model.path or 'model'}: variables.{key}"
        if key not in units:
            raise BristleError(
                f"{where}: no variable of the records{suggest(key, list(units))}; known:"
                f" {', '.join(units)}"
            )
        try:
            aliases[key] = alias(given, [units[key]])
        except BristleError as error:
            raise BristleError(f"{where}: {error}") from None
    return _checked_plant(Fmu(path, True, aliases), model)


def _checked_plant(fmu: Fmu, model: Model) -> Fmu:
    """Refuse an FMU without the variables that the records speak of."""
    output, unit = ("v", "rad/s") if model.output_kind == "velocity" else ("theta", "rad")
    for name, causality in ((INPUT, "input"), (output, "output")):
        if not fmu.has(name, causality) or not fmu.is_real(name):
            known = ", ".join(fmu.names(causality)) or "none"
            raise BristleError(
                f"FMU {fmu.path}: no real {causality} '{name}' (there are: {known}); name the one"
                " that is meant "
                f'in the model file: [variables] {name} = "..."'
            )
    if not model.linear:
        fmu.check_si(output, unit)
    return fmu


# -- texts -----------------------------------------------------------------------------------------
def unit_lines(fmu: Fmu, model: Model) -> list[str]:
    """Return a line if the FMU declares another unit for its input than the records have, and was
    given their numbers.

    (Plants of ours have their input in V; one with b = 1 N.m/V stands for a plant that takes a
    torque.)
    """
    unit = fmu.unit(INPUT)
    if unit in ("1", model.input_unit) or (
        fmu.has("b", "parameter") and float(fmu.start("b")) == 1.0
    ):
        return []
    return [
        f"input {INPUT} of {fmu.path.name} is in {unit}, that of the records in {model.input_unit},"
        " and was given their numbers: if one is not worth the other, export the FMU with that"
        " input or correct [input]"
    ]


def _closeness(fmu: Fmu, model: Model, twin: EquivalentServo) -> str:
    servo = " and ".join([f"{model.friction} friction", *model.effects])
    return (
        f"a servo with {servo} follows {fmu.path.name} to {twin.error:.3g} {model.output_unit} rms;"
        f" what was measured is {twin.gap:.3g} {model.output_unit} rms away from it"
    )


def _agreement(fmu: Fmu, found: Conclusion, twin: EquivalentServo) -> str:
    """Return the answer where nothing is missing and no parameter is wrong."""
    unit, alone = found.gap.output_unit, math.sqrt(found.gap.noise_floor or 0.0)
    of_it = "disturbance and sensor alone give " + (
        "as much" if alone >= twin.gap else f"{alone:.3g} {unit} of it"
    )
    return f"{fmu.path.name} agrees with the records: rms {twin.gap:.3g} {unit}; {of_it}."


def _wrong(fmu: Fmu, found: Conclusion, twin: EquivalentServo) -> list[str]:
    """Return a line for each parameter of the FMU that the records contradict, what was found taken
    into account.
    """
    lines = []
    for name, e in found.own_parameters.items():
        value = twin.values.get(name)
        if value is None or e.ci95 is None or e.ci95[0] <= value <= e.ci95[1]:
            continue
        if abs(value - e.value) <= FMU_PARAMETER_ERROR * abs(e.value):
            continue
        unit = "" if e.unit == "1" else f" {e.unit}"
        by = _excess(value / e.value) if e.value and value / e.value > 0 else "wrong"
        line = (
            f"{name} of {fmu.path.name} looks {by}: it behaves like {value:.4g}{unit}, the records"
            f" like {e.value:.4g}{unit}"
        )
        lines.append(
            f"{line} ({e.ci95[0]:.4g} to {e.ci95[1]:.4g})"
            + (", the bound of the search" if e.at_bound else "")
        )
    return lines


def _excess(ratio: float) -> str:
    """Return a ratio in words."""
    way, size = ("high", ratio) if ratio > 1 else ("low", 1 / ratio)
    return f"{size:.1f} times too {way}" if size >= 2 else f"{abs(ratio - 1):.0%} too {way}"


def _why_refused(like: Model, twin: EquivalentServo, left: float) -> str:
    """Return why the servo cannot replace the FMU; `left` is its mean square when refitted to the
    records [output squared].
    """
    return (
        f"The search runs on a servo that is fitted to the FMU, and with {like.friction} friction"
        f" none comes near: it stays {twin.error:.3g} {like.output_unit} rms from the FMU, and"
        f" {math.sqrt(left):.3g} {like.output_unit} from the records when refitted to them. What"
        " the FMU lacks cannot be seen behind that. Give a MODEL.toml with the FMU's own friction"
        " law, effects and parameters."
    )
