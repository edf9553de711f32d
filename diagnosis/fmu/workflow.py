"""Somebody else's plant FMU as the model: a servo of our own is fitted to it, and the search runs on that in its place.

What the FMU does otherwise than the fitted servo, from the same states and under the same input, is taken out of what
was measured. What is then missing is missing in the FMU.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bristle.common.errors import BristleError, RestartError
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.checks.input_hold import with_input_share
from bristle.diagnosis.checks.plausibility import check
from bristle.diagnosis.conclusion import NOTHING_LEFT, Additions, Case, Conclusion, as_diagnosis, conclude
from bristle.diagnosis.estimation.dataset import STATE_SMOOTHING, Dataset, Segments, smooth
from bristle.diagnosis.estimation.fitted_model import fit_from_several_starts
from bristle.diagnosis.estimation.likelihood import Fit, Point, Problem, evaluate, mean_square
from bristle.diagnosis.estimation.noise import Noise, white_noise
from bristle.diagnosis.estimation.optimiser import refit
from bristle.diagnosis.estimation.simulator import Servo
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.preparation import base_servo_of, dataset_of, nominal_gap
from bristle.diagnosis.report import result as answer
from bristle.diagnosis.selection.start_values import Progress, SearchOptions
from bristle.diagnosis.selection.stepwise import search
from bristle.diagnosis.workflow import check_arguments, not_searched, reporting, teller
from bristle.fmus.host import Fmu
from bristle.fmus.playback import INPUT, Replay, ReplayResult, ReplaySegment, replay_records, replay_segments, start_variable
from bristle.records.record import Record

Array = NDArray[np.float64]
FMU_LEAD = 0.04  # s before a segment from which the FMU runs: hidden states come to life, position and velocity do not run off
FMU_CLOSE = 0.1  # of the gap: a servo that is as close to the FMU may move as far as the model's own bounds
FMU_PARAMETER_RANGE = 1.5  # else by this factor either way, for the difference is that of the fitted parameters
FMU_BOUND_FACTOR = 100.0  # times the model's own bounds: how far the servo follows an FMU that lies outside them
FMU_FIT_ROUNDS = 4  # times that the servo is fitted to the FMU, each time as closely as it came before
FMU_ERROR_RATIO = (
    0.5  # of what a refit leaves of the gap: if the servo is farther from the FMU than that, and than what the sensor alone
)
# gives, nothing is named
FMU_PARAMETER_ERROR = 0.02  # parameters that differ by less are not worth a line


@dataclass(frozen=True)
class EquivalentServo:
    """A servo fitted to an FMU.

    Attributes
    ----------
    dataset : Bench
        The records, less what the FMU does otherwise than the servo.
    values : dict
        Parameters of the servo, SI.
    error, gap : float
        rms of the servo less the FMU, and of the measured less the FMU, start states at their best [unit of the output].
    """

    dataset: Dataset
    values: Mapping[str, float]
    error: float
    gap: float


def diagnose_fmu(fmu_path: Path, model: Model, records: Sequence[Record], progress: Progress | None = None) -> answer.Diagnosis:
    """Find where a plant FMU and records disagree, and name what the FMU lacks.

    Parameters
    ----------
    fmu_path : Path
        Co-Simulation FMU of FMI 2 or 3 with input u and output theta, or v where the records hold velocities. It runs
        in a process of its own.
    model : Model
        What the records hold, and a law and nominal parameters that come near the FMU's; `fmu_model`, or from a file.
    records : sequence of Record
        From `load_records` or `records_from_arrays`; two or more are better than one.
    progress : function, optional
        Called with a text and the fraction done.

    Returns
    -------
    Diagnosis
        `model` has the parameters that the FMU behaves like; `findings` say how the FMU was run, how closely the fitted
        servo follows it, and which of its parameters look wrong. Verdict not_identifiable if the servo does not follow.

    Raises
    ------
    BristleError
        If the FMU cannot be read, lacks these variables, crashes or refuses a step; or the records are too short.
    """
    check_arguments(model, records)
    tell = teller(progress)
    fmu = _checked(Fmu(fmu_path, foreign=True), model)
    started = time.perf_counter()
    with threadpool_limits(1, user_api="blas"):
        while True:
            dataset, said = dataset_of(model, records), check(model, records)
            segments, lines = _simulated(fmu, dataset, tell)
            lines += _units(fmu, model)
            if said.proposals:
                gap = replace(dataset, segments=segments)
                nominal = nominal_gap(gap, *base_servo_of(model, gap))
                return not_searched(model, records, said, nominal, time.perf_counter() - started, lines)
            tell("fitting a servo to the FMU", 0.05)
            twin = _twin(model, dataset, replace(dataset, segments=segments))
            lines.append(_closeness(fmu, model, twin))
            like = replace(model, parameters={name: float(twin.values[name]) for name in model.parameters})
            free = replace(like, bounds=_bounds(model, twin))
            base = fit_from_several_starts(twin.dataset, *base_servo_of(free, twin.dataset))
            left = mean_square(base.fit, twin.dataset.held_out)
            kept = replace(like, bounds=_around(model, like.parameters))
            if twin.error > max(FMU_ERROR_RATIO * math.sqrt(left), base.problem.noise.sensor):
                return _refused(kept, twin, records, left, lines, time.perf_counter() - started)
            outcome = search(twin.dataset, base, reporting(SearchOptions(), tell))
            if outcome.input_share is None:
                break
            records = with_input_share(records, outcome.input_share)
        tell("residual", 0.85)
        case = Case(free, records, twin.dataset, base)
        found = conclude(case, outcome)
        wrong = _wrong(fmu, found, twin)
        agrees = [] if wrong or found.verdict != "none" or found.remains.flag else [_agreement(fmu, found, twin)]
        return as_diagnosis(case, found, started, Additions(agrees, (*lines, *wrong), model=kept))


def _checked(fmu: Fmu, model: Model) -> Fmu:
    """Refuse an FMU without the variables that the records speak of."""
    output, unit = ("v", "rad/s") if model.output_kind == "velocity" else ("theta", "rad")
    for name, causality in ((INPUT, "input"), (output, "output")):
        if not fmu.has(name, causality) or not fmu.is_real(name):
            known = ", ".join(fmu.names(causality)) or "none"
            raise BristleError(f"FMU {fmu.path}: no real {causality} '{name}' (there are: {known}); rename it so in the FMU")
    if not model.linear:
        fmu.check_si(output, unit)
    return fmu


# -- the FMU over the records ------------------------------------------------------------------------------------------
def _simulated(fmu: Fmu, dataset: Dataset, tell: Progress) -> tuple[Segments, list[str]]:
    """Return what the FMU gives in place of what was measured (averages and start states), and how it was run."""
    tell("simulating the FMU", 0.0)
    s = dataset.segments
    outputs = ("v",) if s.velocity else ("theta", "v") if fmu.has("v", "output") and fmu.is_real("v") else ("theta",)
    wanted = ("v",) if s.velocity else ("theta", "v")
    begins = {name: variable for name in wanted if (variable := start_variable(fmu, name)) is not None}
    try:
        for name in wanted:
            if name not in begins:
                raise RestartError(f"no parameter {name}_start and no start value of {name}")
        lead = round(FMU_LEAD / s.h)
        stretches = tuple(_stretches(dataset, lead, begins))
        known = {name: variable for name, variable in begins.items() if name in outputs}
        played = replay_segments(
            Replay(fmu, s.h, stretches, outputs, known), lambda n: tell("simulating the FMU", 0.05 * n / len(stretches))
        )
        return _gathered(s, played, lead), [
            f"{fmu.path.name} was {played.way} for each of {len(stretches)} segments, {lead * s.h:.3g} s before it, with "
            f"{' and '.join(begins.values())} as measured; other states it has then begin at their start values"
        ]
    except RestartError as error:
        whole = tuple(ReplaySegment(piece.time, piece.u, {}) for piece in s.pieces)
        played = replay_records(Replay(fmu, s.h, whole, outputs, {}))
        line = f"{fmu.path.name} cannot be begun anew at each segment ({error}): it ran over whole records from its own start"
        return _cut(s, played), [line]


def _stretches(dataset: Dataset, lead: int, begins: Mapping[str, str]) -> Iterator[ReplaySegment]:
    """Give the inputs of each segment with those of the lead before it, and the measured state where that begins."""
    s, m, offset = dataset.segments, dataset.motion, 0
    length = s.bins * s.width
    for piece in s.pieces:
        for first in range(0, len(piece.u), length):
            at = max(0, first - lead)
            state = {"theta": float(m.theta[offset + at]), "v": float(m.v[offset + at])}
            start = {variable: state[name] for name, variable in begins.items()}
            yield ReplaySegment(piece.time + s.h * at, piece.u[at : first + length], start)
        offset += len(piece.u)


def _gathered(s: Segments, played: ReplayResult, lead: int) -> Segments:
    """Return the segments as the FMU gives them, from one stretch each."""
    pieces, done, length = [], 0, s.bins * s.width
    for piece in s.pieces:
        n = len(piece.measured)
        parts = [_state(s, each) for each in played.outputs[done : done + n]]
        seen = np.array([_averages(s, y[len(y) - length :]) for y, _ in parts])
        starts = np.array([state[len(state) - length] for _, state in parts])
        pieces.append(replace(piece, measured=seen, initial=starts))
        done += n
    return replace(s, pieces=tuple(pieces))


def _cut(s: Segments, played: ReplayResult) -> Segments:
    """Return the segments as the FMU gives them, cut from whole records."""
    pieces = []
    for piece, outputs in zip(s.pieces, played.outputs, strict=True):
        y, state = _state(s, outputs)
        seen = np.array([_averages(s, part) for part in y.reshape(len(piece.measured), -1)])
        pieces.append(replace(piece, measured=seen, initial=state[:: s.bins * s.width]))
    return replace(s, pieces=tuple(pieces))


def _averages(s: Segments, y: Array) -> Array:
    return np.asarray(y.reshape(s.bins, s.width).mean(axis=1))


def _state(s: Segments, outputs: Array) -> tuple[Array, Array]:
    """Return the output (n,) and the state (n, 2) that an FMU shows; where it shows no velocity, from a parabola."""
    y = outputs[:, 0]
    if s.velocity:
        return y, np.column_stack([np.zeros_like(y), y])
    return y, np.column_stack([y, outputs[:, 1] if outputs.shape[1] > 1 else smooth(y, s.h, STATE_SMOOTHING, 1)])


# -- the servo in its place --------------------------------------------------------------------------------------------
def _twin(model: Model, dataset: Dataset, copy: Dataset) -> EquivalentServo:
    """Fit a servo to the FMU (`copy`), and take what is left out of what was measured."""
    servo, values = base_servo_of(model, copy)
    fit = _fitted(copy, servo, values)
    barred = any(f.at_binding_bound(fit.values[f.name]) for f in servo.free if f.name in model.bounds)
    if barred:  # an FMU may be anything, and is followed there
        free = tuple(f.widened(FMU_BOUND_FACTOR) if f.name in model.bounds else f for f in servo.free)
        fit = _fitted(copy, replace(servo, free=free), fit.values)
    first, pieces = 0, []
    for piece in dataset.segments.pieces:
        n = len(piece.measured)
        pieces.append(replace(piece, measured=piece.measured - fit.residual[first : first + n]))
        first += n
    corrected = replace(dataset, segments=replace(dataset.segments, pieces=tuple(pieces)))
    counted = corrected.segments.counted
    problem = Problem.of(corrected.segments, _white(corrected, 1.0), counted)
    measured = evaluate(problem, fit.at(initial=corrected.segments.initial))
    error, gap = (math.sqrt(mean_square(each, counted)) for each in (fit, measured))
    return EquivalentServo(corrected, fit.values, error, gap)


def _fitted(copy: Dataset, servo: Servo, values: Mapping[str, float]) -> Fit:
    """Fit a servo to the FMU by plain least squares: an FMU has no noise, and no segment of it is an accident."""
    counted, simulator = copy.segments.counted, servo.simulator(copy.segments)
    fit = evaluate(
        Problem.of(copy.segments, _white(copy, 1.0), counted), Point(simulator, servo.free, dict(values), copy.segments.initial)
    )
    for _ in range(FMU_FIT_ROUNDS):
        problem = Problem.of(copy.segments, _white(copy, math.sqrt(mean_square(fit, counted))), counted)
        fit = refit(problem, fit)
    return fit


def _white(dataset: Dataset, level: float) -> Noise:
    """Return a white noise so wide that a segment that is off by `level` rms counts as it is, and not as an outlier."""
    bins = dataset.segments.bins
    return white_noise(bins, math.sqrt(bins) * max(level, dataset.least_sd))


def _bounds(model: Model, twin: EquivalentServo) -> dict[str, tuple[float, float]]:
    """Return how far the parameters may move from those that the FMU behaves like."""
    around = _around(model, twin.values)
    if twin.error <= FMU_CLOSE * twin.gap:
        return around
    found = {}
    for name, (low, high) in around.items():
        value = twin.values[name]
        ends = sorted((value / FMU_PARAMETER_RANGE, value * FMU_PARAMETER_RANGE)) if value else (low, high)
        found[name] = (max(low, ends[0]), min(high, ends[1]))
    return {name: (low, high) for name, (low, high) in found.items() if low < high}


def _around(model: Model, values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return the bounds of a model, wide enough for values that may lie outside them."""
    return {name: (float(min(low, values[name])), float(max(high, values[name]))) for name, (low, high) in model.bounds.items()}


# -- what is said of it ------------------------------------------------------------------------------------------------
def _units(fmu: Fmu, model: Model) -> list[str]:
    """Return a line if the FMU declares another unit for its input than the records have, and was given their numbers.

    (Plants of ours have their input in V; one with b = 1 N.m/V stands for a plant that takes a torque.)
    """
    unit = fmu.unit(INPUT)
    if unit in ("1", model.input_unit) or (fmu.has("b", "parameter") and float(fmu.start("b")) == 1.0):
        return []
    return [
        f"input {INPUT} of {fmu.path.name} is in {unit}, that of the records in {model.input_unit}, and was given their numbers: "
        "if one is not worth the other, export the FMU with that input or correct [input]"
    ]


def _closeness(fmu: Fmu, model: Model, twin: EquivalentServo) -> str:
    servo = " and ".join([f"{model.friction} friction", *model.effects])
    return (
        f"a servo with {servo} follows {fmu.path.name} to {twin.error:.3g} {model.output_unit} rms; "
        f"what was measured is {twin.gap:.3g} {model.output_unit} rms away from it"
    )


def _agreement(fmu: Fmu, found: Conclusion, twin: EquivalentServo) -> str:
    """Return the answer where nothing is missing and no parameter is wrong."""
    unit, alone = found.gap.output_unit, math.sqrt(found.gap.noise_floor or 0.0)
    of_it = "disturbance and sensor alone give " + ("as much" if alone >= twin.gap else f"{alone:.3g} {unit} of it")
    return f"{fmu.path.name} agrees with the records: rms {twin.gap:.3g} {unit}; {of_it}."


def _wrong(fmu: Fmu, found: Conclusion, twin: EquivalentServo) -> list[str]:
    """Return a line for each parameter of the FMU that the records contradict, what was found taken into account."""
    lines = []
    for name, e in found.own_parameters.items():
        value = twin.values.get(name)
        if (
            value is None
            or e.ci95 is None
            or e.ci95[0] <= value <= e.ci95[1]
            or abs(value - e.value) <= FMU_PARAMETER_ERROR * abs(e.value)
        ):
            continue
        unit = "" if e.unit == "1" else f" {e.unit}"
        by = _excess(value / e.value) if e.value and value / e.value > 0 else "wrong"
        line = f"{name} of {fmu.path.name} looks {by}: it behaves like {value:.4g}{unit}, the records like {e.value:.4g}{unit}"
        lines.append(f"{line} ({e.ci95[0]:.4g} to {e.ci95[1]:.4g})" + (", the bound of the search" if e.at_bound else ""))
    return lines


def _excess(ratio: float) -> str:
    """Return a ratio in words."""
    way, size = ("high", ratio) if ratio > 1 else ("low", 1 / ratio)
    return f"{size:.1f} times too {way}" if size >= 2 else f"{abs(ratio - 1):.0%} too {way}"


def _refused(
    like: Model, twin: EquivalentServo, records: Sequence[Record], left: float, lines: list[str], seconds: float
) -> answer.Diagnosis:
    """Return a diagnosis that names nothing, because the servo that the search would run on is not the FMU.

    `left` is the mean square [output squared] that is left between the servo and the records when it is refitted.
    """
    why = (
        f"The search runs on a servo that is fitted to the FMU, and with {like.friction} friction none comes near: it stays "
        f"{twin.error:.3g} {like.output_unit} rms from the FMU, and {math.sqrt(left):.3g} {like.output_unit} from the records when "
        "refitted to them. What the FMU lacks cannot be seen behind that. "
        "Give a MODEL.toml with the FMU's own friction law, effects and parameters."
    )
    return answer.Diagnosis(
        verdict="not_identifiable", statement=(why,), effects=(), ties=(), experiment="", where=(),
        remains=NOTHING_LEFT, gap=answer.Gap(left, left, None, like.output_unit),
        excitation=excitation(like, records), findings=(*lines, *(f for r in records for f in r.findings)), base={},
        parameters={}, rounds=(), undetected={}, traces=(), model=like, seconds=seconds,
    )  # fmt: skip
