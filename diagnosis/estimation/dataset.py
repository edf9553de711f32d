"""Records as segments with their noise, and a servo fitted to them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.inverse_dynamics import Balance, BalancedModel
from bristle.diagnosis.estimation.likelihood import Fit, Problem, mean_square, rescored
from bristle.diagnosis.estimation.noise import Noise, estimate, response
from bristle.diagnosis.estimation.optimiser import ROUGH_STOP_GAIN, refit, resume
from bristle.diagnosis.estimation.segments import Motion, Segments
from bristle.diagnosis.estimation.simulator import OWN_BRISTLES, Free, Servo
from bristle.plant.friction import law as find_law

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
NOISE_FIT_ITERATIONS = 40  # steps of the first fit, which may be far from its end
NOISE_PASSES, FAST_NOISE_PASSES = (
    8,
    2,
)  # times at most that noise and parameters are estimated in turn; that they are under a brief noise
FAST_CORNER, BRIEF_CORNER = 10.0, 30.0  # Hz: a noise with such a corner hides nothing; corner of one under which nothing can hide
BRISTLE_BEND = 0.25  # of the sensor's step: bristles that bend less are no effect
FAR_OFF_SHARE = 0.03  # share of the motion's square: beyond it, starts are sought along the measured motion too;
DIVERGED_SHARE = 1.0  # a model that misses more than all of it has run away
REDUCED_FRICTION = (
    0.5  # of its dry friction, then: that holds an axis where a missing torque would, and steps end where it sticks (cogging
)
# of a slow motor: of 24 starts with the friction of the model without it 16 found it, of 24 with half of it all)
LEAST_NOISE_SEGMENTS = 10  # segments in motion that tell the noise
HELD_OUT_EVERY = 4  # every fourth segment is kept from the search
OUTLIER_WEIGHT = 0.16  # weight of a segment, usually about 1, below which a model misses it by far (of 60 controls 3 have one)
LARGE_DISTURBANCE = (
    0.15  # disturbance over the torque of the input, above which it misses all of them (controls: 0.025, tones 0.11, couplings
)
# 0.17 and more)
TIE_NATS = 6.0  # nats between two fits that the records hardly tell apart


@dataclass(frozen=True)
class Dataset:
    """Everything that stays the same over a search.

    `barred` says why an effect is no candidate; `turn` is the path after which a motion begins anew: one turn of a shaft;
    `doubtful`: the input may change between samples.
    """

    segments: Segments
    motion: Motion
    resolution: float
    least: float
    narrow: str = ""  # why the records are too poor to tell effects apart by their form
    barred: Mapping[str, str] = field(default_factory=dict)
    linear: bool = False  # the axis does not turn
    turn: float = 2 * math.pi
    doubtful: bool = False

    @cached_property
    def train(self) -> Mask:
        """Segments that the search may see."""
        return np.asarray(self.segments.judged & ~self.held)

    @cached_property
    def held(self) -> Mask:
        """Segments kept from the search: none with an end of the range, for what begins there may show nowhere else.

        Where no other is left, as in a record of two seconds, those with an end are kept as well, or the last one.
        """
        m = self.motion
        judged = np.repeat(self.segments.judged, len(m.theta) // len(self.segments.judged))
        ends = [int(np.argmax(np.where(judged, side * x, -np.inf))) for x in (m.theta, m.u) for side in (1, -1)]
        free = np.ones(len(self.segments.judged), dtype=bool)
        free[np.array(ends) * len(free) // len(m.theta)] = False
        every = self.segments.judged & (self.segments.block % HELD_OUT_EVERY == HELD_OUT_EVERY - 1)
        last = np.arange(len(free)) == np.flatnonzero(self.segments.judged)[-1]
        return next(np.asarray(kept) for kept in (every & free, every, last) if kept.any())

    def problem(self, noise: Noise, judged: Mask) -> Problem:
        """Return a problem over these segments."""
        return Problem(noise, judged, self.segments.seen, self.segments.starts, self.segments.spread)

    def noise(self, residual: Array, weight: Array, values: Mapping[str, float], slowest: float = 0.0) -> Noise:
        """Return the noise of a residual (segments, bins), from the segments in motion; `slowest` as of `estimate`.

        At rest friction takes the disturbance and the sensor repeats its last step: that says nothing of their size.
        """
        s = self.segments
        share = self.motion.moving.reshape(len(residual), -1).mean(axis=1)
        in_motion = weight * share
        weight = in_motion if np.count_nonzero(in_motion > 0.5) >= LEAST_NOISE_SEGMENTS else weight
        pulses = response(values["J"], values["a2"], s.h, s.width, s.bins, s.velocity)
        return estimate(residual, weight, pulses, s.h, self.least, slowest)

    def left_by(self, fit: Fit, slowest: float = 0.0) -> Problem:
        """Return the problem of the segments that the search may see, under the noise that a fit leaves; `slowest` as there."""
        return self.problem(self.noise(fit.residual, fit.weight, fit.values, slowest), self.train)

    def settled(self, fit: Fit) -> Fit:
        """Return a fit refitted under the noise that it leaves itself, until neither changes.

        What a model explains only in part hides in the noise that it leaves, if that is slow: parameters and noise keep
        each other where they are. Under a noise that cannot be slow it has to be explained; from there they may find
        another end, and the more likely one counts.
        """
        end = self._in_turn(fit)
        if end.noise.corner >= FAST_CORNER:
            return end
        bold = fit
        for _ in range(FAST_NOISE_PASSES):
            bold = resume(self.left_by(bold, BRIEF_CORNER), bold, NOISE_FIT_ITERATIONS, ROUGH_STOP_GAIN)
        return max(end, self._in_turn(bold), key=lambda each: each.total)

    def _in_turn(self, fit: Fit) -> Fit:
        for _ in range(NOISE_PASSES):
            problem = self.left_by(fit)
            before = rescored(problem, fit).total
            fit = resume(problem, fit, NOISE_FIT_ITERATIONS, ROUGH_STOP_GAIN)
            if fit.total < before + ROUGH_STOP_GAIN:
                break
        return fit

    def missed(self, fit: Fit) -> float:
        """Return the squared error over that of the motion within segments, less a straight line each."""
        s = self.segments
        ramp = np.linalg.qr(np.column_stack([np.ones(s.bins), np.linspace(-1.0, 1.0, s.bins)]))[0]
        moved = (s.seen - (s.seen @ ramp) @ ramp.T)[self.train]
        return mean_square(fit, self.train) / max(float(np.mean(np.square(moved))), 1e-300)

    def far(self, fit: Fit) -> bool:
        """True if a model misses so much of the motion that steps from where it stands may lead nowhere."""
        return self.missed(fit) > FAR_OFF_SHARE

    def away(self, fit: Fit) -> bool:
        """True if a model runs away from the motion."""
        return self.missed(fit) > DIVERGED_SHARE

    def odd(self, fit: Fit) -> bool:
        """True if a model misses some segment by far, or calls a large part of the torque a disturbance."""
        return bool(fit.weight[self.train].min() < OUTLIER_WEIGHT) or self.disturbance(fit) > LARGE_DISTURBANCE

    def disturbance(self, fit: Fit) -> float:
        """Return the torque that a model takes for a disturbance, over that of the input; rms."""
        drive = abs(fit.values["b"]) * float(np.sqrt(np.mean(np.square(self.motion.u))))
        return fit.noise.torque / drive if drive else 0.0

    def balanced(self, fitted: FittedModel) -> BalancedModel:
        """Return the model fitted to the balance of torques along the measured motion."""
        balance = Balance(self.segments, self.motion, fitted.problem.judged, fitted.servo.fixed)
        return BalancedModel(balance, fitted.servo, fitted.fit.values, self.noise)


@dataclass(frozen=True)
class FittedModel:
    """A servo fitted, with the problem it was fitted under."""

    servo: Servo
    problem: Problem
    fit: Fit


def fit_with_noise(dataset: Dataset, servo: Servo, values: Mapping[str, float]) -> FittedModel:
    """Fit a servo and its noise in turn, from given values."""
    simulator, starts, judged = servo.simulator(dataset.segments), dataset.segments.starts, dataset.train
    seen, _, good, _ = simulator.run(values, starts)
    residual = np.where(good[:, None], dataset.segments.seen - seen, 0.0)
    noise = dataset.noise(residual, (judged & good).astype(float), values)
    fit = refit(dataset.problem(noise, judged), simulator, servo.free, values, starts, NOISE_FIT_ITERATIONS, enough=ROUGH_STOP_GAIN)
    fit = dataset.settled(fit)
    problem = dataset.left_by(fit)
    return FittedModel(servo, problem, resume(problem, fit))


def fit_from_several_starts(dataset: Dataset, servo: Servo, values: Mapping[str, float]) -> FittedModel:
    """Fit a servo and its noise from given values and, if that ends far off, from others.

    These are what balances the torques and, where the servo runs away, less dry friction. Of ends that the records hardly
    tell apart, one with fewer parameters at their bounds is the model that is known.
    """
    first = fit_with_noise(dataset, servo, values)
    if not dataset.far(first.fit):
        return first
    less = reduced_friction_start(first) if dataset.away(first.fit) else {}
    others = [*dataset.balanced(first).models, *([less] if less else [])]
    ends = [first, *(fit_with_noise(dataset, servo, {**values, **found}) for found in others)]
    most = max(fitted.fit.total for fitted in ends)
    return min((s for s in ends if s.fit.total > most - TIE_NATS), key=lambda s: (_at_bounds(s), -s.fit.total))


def reduced_friction_start(fitted: FittedModel) -> dict[str, float]:
    """Return less dry friction than a servo has, if any, from which one that runs away may be fitted better."""
    return {f.name: REDUCED_FRICTION * fitted.fit.values[f.name] for f in fitted.servo.free if f.name.endswith(".Fc")}


def _at_bounds(fitted: FittedModel) -> int:
    return sum(f.stuck(fitted.fit.values[f.name]) for f in fitted.servo.free)


def base_servo(
    law: str, nominal: Mapping[str, float], bounds: Mapping[str, tuple[float, float]], fixed: Mapping[str, float], step: float
) -> tuple[Servo, dict[str, float]]:
    """Return a servo whose bounded parameters are free, loosely held by their nominal values, and where to start.

    `step` is the sensor's, in position: set-valued friction bends by at most a quarter of it.
    """
    free = []
    for name, (low, high) in bounds.items():
        doubt = max(2.0 * abs(nominal[name]), 0.5 * (high - low), 1e-12)
        free.append(Free(name, low, high, nominal=nominal[name], doubt=doubt))
    rigid = f"{law}.Fc" in nominal and not find_law(law).states
    values = dict(nominal)
    if rigid:
        least = max(nominal[f"{law}.Fc"], 1e-9) / (BRISTLE_BEND * step)
        values[f"{OWN_BRISTLES}.stiffness"] = 3 * least
        values[f"{OWN_BRISTLES}.damping"] = damping = (3 * least * nominal["J"]) ** 0.5
        free.append(Free(f"{OWN_BRISTLES}.stiffness", least, 1e4 * least, True, math.log(3 * least), 1.0))
        free.append(Free(f"{OWN_BRISTLES}.damping", 0.0, 30 * damping, False, damping, 2 * damping))
    return Servo(law, (), tuple(bounds), tuple(free), fixed, rigid), values
