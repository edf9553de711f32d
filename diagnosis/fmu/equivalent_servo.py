"""A servo fitted to an FMU, and the records less the difference between the two."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from bristle.diagnosis.checks.preparation import base_servo_of
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.likelihood import Fit, FitPoint, Problem, evaluate, mean_square
from bristle.diagnosis.estimation.noise import Noise, white_noise
from bristle.diagnosis.estimation.optimiser import refit
from bristle.diagnosis.estimation.simulator import Servo
from bristle.diagnosis.modelfile import Model

# of the gap: error of a servo up to which its parameters may move within the model's own bounds
FMU_CLOSE = 0.1
# factor by which the parameters of a servo with a larger error may move either way
FMU_PARAMETER_RANGE = 1.5
# times the model's own bounds: how far the servo's parameters may follow an FMU
FMU_BOUND_FACTOR = 100.0
FMU_FIT_ROUNDS = 4  # fits of the servo to the FMU, each with the noise of the one before


@dataclass(frozen=True)
class EquivalentServo:
    """A servo fitted to an FMU."""

    dataset: Dataset  # the records, less the difference between FMU and servo
    values: Mapping[str, float]  # parameters of the servo, SI
    error: float  # rms of the servo less the FMU, initial states at their best [unit of the output]
    gap: float  # the same of the measured less the FMU


def fit_equivalent_servo(model: Model, dataset: Dataset, copy: Dataset) -> EquivalentServo:
    """Fit a servo to the FMU (`copy`), and take what is left out of what was measured."""
    servo, values = base_servo_of(model, copy)
    fit = _fitted(copy, servo, values)
    barred = any(
        f.at_binding_bound(fit.values[f.name]) for f in servo.free if f.name in model.bounds
    )
    if barred:  # an FMU may be anything, and is followed there
        free = tuple(
            f.widened(FMU_BOUND_FACTOR) if f.name in model.bounds else f for f in servo.free
        )
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
    """Fit a servo to the FMU by plain least squares: an FMU has no noise, and no segment of it is
    an accident.
    """
    s, counted = copy.segments, copy.segments.counted
    start = FitPoint(servo.simulator(s), servo.free, dict(values), s.initial)
    fit = evaluate(Problem.of(s, _white(copy, 1.0), counted), start)
    for _ in range(FMU_FIT_ROUNDS):
        problem = Problem.of(s, _white(copy, math.sqrt(mean_square(fit, counted))), counted)
        fit = refit(problem, fit)
    return fit


def _white(dataset: Dataset, error: float) -> Noise:
    """Return a white noise so wide that a segment that is off by `error` rms counts as it is, and
    not as an outlier.
    """
    bins = dataset.segments.bins
    return white_noise(bins, math.sqrt(bins) * max(error, dataset.least_sd))


def search_bounds(model: Model, twin: EquivalentServo) -> dict[str, tuple[float, float]]:
    """Return how far the parameters may move from those that the FMU behaves like."""
    around = widened_bounds(model, twin.values)
    if twin.error <= FMU_CLOSE * twin.gap:
        return around
    bounds = {}
    for name, (low, high) in around.items():
        value = twin.values[name]
        ends = (
            sorted((value / FMU_PARAMETER_RANGE, value * FMU_PARAMETER_RANGE))
            if value
            else (low, high)
        )
        bounds[name] = (max(low, ends[0]), min(high, ends[1]))
    return {name: (low, high) for name, (low, high) in bounds.items() if low < high}


def widened_bounds(model: Model, values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return the bounds of a model, wide enough for values that may lie outside them."""
    return {
        name: (float(min(low, values[name])), float(max(high, values[name])))
        for name, (low, high) in model.bounds.items()
    }
