"""A servo fitted to a dataset together with its noise, and how well it fits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.likelihood import Fit, FitPoint, Problem, mean_square, rescored
from bristle.diagnosis.estimation.optimiser import ROUGH_STOP_GAIN, refit, resume
from bristle.diagnosis.estimation.simulator import OWN_BRISTLES, Servo
from bristle.diagnosis.sliding.fit import SlidingFit, SlidingModel, fit_sliding
from bristle.plant.controller import CONTROLLER
from bristle.plant.servo import J

NOISE_FIT_ITERATIONS = 40  # steps of a fit under a given noise
NOISE_PASSES = 8  # most alternations of noise and parameters
FAST_NOISE_PASSES = 2  # alternations under a noise that is kept fast
# Hz: a disturbance with at least this corner frequency cannot hide a slow effect
FAST_CORNER = 10.0
BRIEF_CORNER = 30.0  # Hz: least corner frequency of a noise that is kept fast
# of the motion's square: a larger error calls for start values from the sliding motion
POOR_FIT_SHARE = 0.03
DIVERGED_SHARE = 1.0  # of the motion's square: a model with a larger error has diverged
REDUCED_FRICTION = 0.5  # of the dry friction: start value for a model that diverges
OUTLIER_WEIGHT = 0.16  # weight, usually about 1, below which a segment is an outlier
# of the input's torque, rms: a larger disturbance hints at a missing effect
LARGE_DISTURBANCE = 0.15
COARSE_SAMPLE = 0.2  # rad: of a loop's oscillation in a sample, from which on it acts in between
TIE_NATS = 6.0  # nats: fits closer than this are a tie


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A servo fitted, with the problem it was fitted under."""

    servo: Servo
    problem: Problem
    fit: Fit


def under_own_noise(dataset: Dataset, fit: Fit, slowest: float = 0.0) -> Problem:
    """Return the problem of the training segments under the noise of a fit's residual; `slowest` as
    of `noise.estimate`.
    """
    return Problem.of(
        dataset.segments,
        dataset.noise(fit.residual, fit.weight, fit.values, slowest),
        dataset.train,
    )


def refit_with_noise(dataset: Dataset, fit: Fit) -> Fit:
    """Return a fit refitted under the noise of its own residual, until neither changes.

    A slow noise can absorb what a model explains only in part, so that parameters and noise keep
    each other where they are. A second refit therefore begins under a noise that is kept fast; the
    more likely result counts.
    """
    end = _alternate(dataset, fit)
    if end.noise.corner >= FAST_CORNER:
        return end
    fast = fit
    for _ in range(FAST_NOISE_PASSES):
        fast = resume(
            under_own_noise(dataset, fast, BRIEF_CORNER),
            fast,
            NOISE_FIT_ITERATIONS,
            ROUGH_STOP_GAIN,
        )
    return max(end, _alternate(dataset, fast), key=lambda each: each.total)


def _alternate(dataset: Dataset, fit: Fit) -> Fit:
    """Estimate noise and parameters in turn."""
    for _ in range(NOISE_PASSES):
        problem = under_own_noise(dataset, fit)
        before = rescored(problem, fit).total
        fit = resume(problem, fit, NOISE_FIT_ITERATIONS, ROUGH_STOP_GAIN)
        if fit.total < before + ROUGH_STOP_GAIN:
            break
    return fit


def fit_with_noise(dataset: Dataset, servo: Servo, values: Mapping[str, float]) -> FittedModel:
    """Fit a servo and its noise in turn, from given values."""
    simulator, initial = servo.simulator(dataset.segments), dataset.segments.initial
    simulated, _, good, _ = simulator.run(values, initial)
    residual = np.where(good[:, None], dataset.segments.measured - simulated, 0.0)
    noise = dataset.noise(residual, (dataset.train & good).astype(float), values)
    problem, point = (
        Problem.of(dataset.segments, noise, dataset.train),
        FitPoint(simulator, servo.free, dict(values), initial),
    )
    fit = refit_with_noise(dataset, refit(problem, point, NOISE_FIT_ITERATIONS, ROUGH_STOP_GAIN))
    problem = under_own_noise(dataset, fit)
    return FittedModel(servo, problem, resume(problem, fit))


def fit_from_several_starts(
    dataset: Dataset, servo: Servo, values: Mapping[str, float]
) -> FittedModel:
    """Fit a servo and its noise from the parameters of its sliding motion and, if that fits poorly,
    from others.

    These are the given ones and, where the servo diverges, less dry friction. Of results in a tie
    the one with the fewest parameters at their bounds is returned.
    """
    slides = sliding_fit(dataset, servo, values)
    first = fit_with_noise(dataset, servo, {**values, **(slides.free_values if slides else {})})
    if not fits_poorly(dataset, first.fit):
        return first
    less = reduced_friction_start(first) if has_diverged(dataset, first.fit) else {}
    others = [*([{}] if slides else []), *([less] if less else [])]
    ends = [first, *(fit_with_noise(dataset, servo, {**values, **other}) for other in others)]
    most = max(fitted.fit.total for fitted in ends)
    tied = [s for s in ends if s.fit.total > most - TIE_NATS]
    return min(
        tied,
        key=lambda s: (sum(f.at_bound(s.fit.values[f.name]) for f in s.servo.free), -s.fit.total),
    )


def sliding_fit(dataset: Dataset, servo: Servo, values: Mapping[str, float]) -> SlidingFit | None:
    """Return a servo fitted to where the records slide, from given values; None where that does not
    show it, or a controller changes the torque between samples too much for it.
    """
    return (
        None if _acts_between(dataset, servo, values) else rough_sliding_fit(dataset, servo, values)
    )


def _acts_between(dataset: Dataset, servo: Servo, values: Mapping[str, float]) -> bool:
    """Return whether the torque that a controller asks for changes much within a sample, so that it
    is not what its goal and the position at the sample make of it.
    """
    if CONTROLLER.name not in servo.effects:
        return False
    known = {**servo.fixed, **values}
    oscillation = math.sqrt(known[f"{CONTROLLER.name}.kp"] / known[J.name])
    return dataset.segments.h * oscillation > COARSE_SAMPLE


def rough_sliding_fit(
    dataset: Dataset, servo: Servo, values: Mapping[str, float]
) -> SlidingFit | None:
    """Return a fit as of `sliding_fit`, for start values: also of a loop that is fast for the
    records' sampling.
    """
    # a short lag acts like an inertia, which a torque that is only asked for does not tell from it
    hidden = (f"{OWN_BRISTLES}.", f"{CONTROLLER.name}.lag")
    own = tuple(f for f in servo.free if not f.name.startswith(hidden))
    model = SlidingModel(servo.law, servo.effects, own, dataset.stretches, dataset.resolution)
    return fit_sliding(model, {**servo.fixed, **values})


def reduced_friction_start(fitted: FittedModel) -> dict[str, float]:
    """Return start values with less dry friction than a servo has; none if the law has none."""
    return {
        f.name: REDUCED_FRICTION * fitted.fit.values[f.name]
        for f in fitted.servo.free
        if f.name.endswith(".Fc")
    }


def relative_error(dataset: Dataset, fit: Fit) -> float:
    """Return the squared error over that of the motion in segments, less a straight line each."""
    s = dataset.segments
    ramp = np.linalg.qr(np.column_stack([np.ones(s.bins), np.linspace(-1.0, 1.0, s.bins)]))[0]
    moved = (s.measured - (s.measured @ ramp) @ ramp.T)[dataset.train]
    return mean_square(fit, dataset.train) / max(float(np.mean(np.square(moved))), 1e-300)


def fits_poorly(dataset: Dataset, fit: Fit) -> bool:
    """True if the error is so large that steps along derivatives may not lead to the optimum."""
    return relative_error(dataset, fit) > POOR_FIT_SHARE


def has_diverged(dataset: Dataset, fit: Fit) -> bool:
    """True if the simulation diverges from the measured motion."""
    return relative_error(dataset, fit) > DIVERGED_SHARE


def has_outliers_or_disturbance(dataset: Dataset, fit: Fit) -> bool:
    """True if a training segment is an outlier, or the disturbance is large beside the torque."""
    return (
        bool(fit.weight[dataset.train].min() < OUTLIER_WEIGHT)
        or disturbance_ratio(dataset, fit) > LARGE_DISTURBANCE
    )


def disturbance_ratio(dataset: Dataset, fit: Fit) -> float:
    """Return the estimated disturbance torque over the torque of the input; rms."""
    drive = abs(fit.values["b"]) * float(np.sqrt(np.mean(np.square(dataset.motion.u))))
    return fit.noise.torque / drive if drive else 0.0
