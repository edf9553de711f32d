"""A servo fitted to the innovations of its sliding motion, with the noise that the records show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import NotStaticError
from bristle.common.table import Array
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.sliding.kalman import KalmanFilter, SlidingNoise
from bristle.diagnosis.sliding.stretches import Stretches
from bristle.diagnosis.sliding.torque import Names, driving_input, sliding_torque

ITERATIONS = 40  # most steps of a fit
LEAST_RISE = 0.01  # nats: a step that gains less ends a fit
LARGEST_STEP = 1.5  # of a logarithm: largest step of a fit
LOWEST_CORNER, HIGHEST_CORNER = 0.02, 300.0  # Hz: of what a disturbance may have
START_CORNER = 5.0  # Hz: where a fit begins
START_SHARE = 0.1  # of the input's torque, rms: disturbance where a fit begins
START_WHITE, LEAST_WHITE = 1e-2, 1e-4  # of the same, in a sample: white torque there, and at least
LEAST_SENSOR = 0.3  # of the noise of a rounding sensor: least noise
# of deviations: how much wider they are than the sandwich gives (benchmarks/estimates.py)
SANDWICH_FACTOR = 1.2
LEAST_SHOWN = 1e-9  # of the information of a parameter: less is rounding
HIDDEN_PART = 1e-3  # of a direction that is not shown: least share of a parameter that is in it
END_PASSES = 2  # fits to stretches whose ends a fit before predicts
NOISES = 4  # parameters of the noise: disturbance, corner, sensor, white torque
BLOCKS = 200  # parts of the records whose scores count as independent
FAST_CORNER = 10.0  # Hz: corner frequency of a disturbance that cannot hide a slow effect
SCREENING_ITERATIONS = 4  # steps of a fit that only compares start values
LEAST_RATE = 1e-6  # 1/s: least viscous friction over inertia that the filter takes
LEAST_COUNTED = 200  # counted samples from which on a fit is tried
INERTIA, VISCOUS = "J", "a2"


@dataclass(frozen=True)
class SlidingModel:
    """What is fitted: law and effects, their free parameters, and where records slide."""

    law: str
    effects: Names
    free: tuple[Free, ...]
    over: Stretches
    resolution: float

    def torque(self, values: Mapping[str, float]) -> tuple[Array, Array]:
        """Return the torque as of `sliding_torque`, with its slopes by the free parameters."""
        names = tuple(f.name for f in self.free)
        return sliding_torque(self.law, self.effects, names, values, self.over)

    def least_noises(self, values: Mapping[str, float]) -> Array:
        """Return the least values of the noise's parameters (NOISES,)."""
        sensor = LEAST_SENSOR * self.resolution / math.sqrt(12.0)
        white = LEAST_WHITE * self.drive(values) * math.sqrt(self.over.h)
        return np.array([0.0, LOWEST_CORNER, sensor, white])

    def drive(self, values: Mapping[str, float]) -> float:
        """Return the torque of the input, rms [N.m]."""
        u = driving_input(self.effects, values, self.over)
        return abs(values["b"]) * float(np.sqrt(np.mean(np.square(u))))


@dataclass(frozen=True)
class SlidingFit:
    """A fit: parameters by name, noise, log-likelihood [nats], and what its derivatives need.

    The parameters of `slopes` (counted, k) and `information` (k, k) are the free ones in their
    units, then the logarithms of disturbance, corner frequency, sensor noise and white torque.
    """

    model: SlidingModel
    values: dict[str, float]
    noise: SlidingNoise
    total: float
    filter: KalmanFilter
    innovations: Array
    slopes: Array
    variance_slopes: Array

    @property
    def noises(self) -> Array:
        """The noise's parameters (NOISES,)."""
        return np.exp(self.noise.logarithms[-NOISES:])

    @cached_property
    def scores(self) -> Array:
        """Slopes of the log-likelihood of each sample (counted, k)."""
        variance, e = self.filter.variance[:, None], self.innovations[:, None]
        return np.asarray(
            -self.slopes * (e / variance)
            - 0.5 * self.variance_slopes * ((1.0 - e * e / variance) / variance)
        )

    @cached_property
    def information(self) -> Array:
        """Fisher information (k, k), that of the priors included."""
        variance = self.filter.variance[:, None]
        own, other = self.slopes / np.sqrt(variance), self.variance_slopes / variance
        return np.asarray(own.T @ own + 0.5 * other.T @ other + self._known_before)

    @property
    def _known_before(self) -> Array:
        """Curvature of the priors (k, k)."""
        prior = [0.0 if f.nominal is None else self._prior(f)[1] for f in self.model.free]
        return np.diag([*prior, *np.zeros(NOISES)])

    def _prior(self, f: Free) -> tuple[float, float]:
        """Return slope and curvature of the logarithm of a parameter's prior, in its unit."""
        assert f.nominal is not None
        value = self.values[f.name]
        by = (1.0 / value if f.factor else 1.0) / f.prior_sd
        return -by * (f.scaled(value) - f.nominal) / f.prior_sd, by**2

    @cached_property
    def gradient(self) -> Array:
        """Slope of the log-likelihood (k,), that of the priors included."""
        prior = [0.0 if f.nominal is None else self._prior(f)[0] for f in self.model.free]
        return np.asarray(self.scores.sum(axis=0) + np.array([*prior, *np.zeros(NOISES)]))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the parameters (k, k); of what the motion does not show it is infinite.

        Source: white1982 (sandwich), kunsch1989 (blocks).
        """
        sums = np.array([part.sum(axis=0) for part in np.array_split(self.scores, BLOCKS)])
        size = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        values, vectors = np.linalg.eigh(self.information / np.outer(size, size))
        shown = values > LEAST_SHOWN
        inverse = (vectors[:, shown] / values[shown]) @ vectors[:, shown].T / np.outer(size, size)
        spread = SANDWICH_FACTOR**2 * inverse @ (sums.T @ sums + self._known_before) @ inverse
        hidden = np.abs(vectors[:, ~shown]).max(axis=1, initial=0.0) > HIDDEN_PART
        hidden |= np.diag(self.information) <= 0.0
        return np.asarray(spread + np.diag(np.where(hidden, np.inf, 0.0)))

    @property
    def price(self) -> float:
        """Half the Bayesian information criterion's penalty of a parameter [nats].

        Source: schwarz1978.
        """
        return 0.5 * math.log(len(self.innovations))

    @property
    def worth(self) -> float:
        """Log-likelihood less the price of the parameters [nats]."""
        return self.total - self.price * len(self.model.free)

    @property
    def free_values(self) -> dict[str, float]:
        """Values of the free parameters."""
        return {f.name: self.values[f.name] for f in self.model.free}

    @property
    def disturbance(self) -> float:
        """Disturbance torque over the torque of the input; rms."""
        return self.noise.torque / max(self.model.drive(self.values), 1e-300)

    def deviations(self) -> dict[str, float]:
        """Return the standard deviations of the free parameters."""
        own = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return {f.name: float(sd) for f, sd in zip(self.model.free, own, strict=False)}

    @cached_property
    def _own(self) -> Array:
        """Directions in which the free parameters move the whitened innovations (counted, k)."""
        scale = np.sqrt(self.filter.variance)[:, None]
        return np.linalg.qr(_scaled(self.slopes[:, : len(self.model.free)] / scale))[0]

    def regress(self, torques: Array) -> tuple[Array, float]:
        """Return coefficients (k,) of torques (samples, k) [N.m] beside the free parameters, and
        their gain [nats].
        """
        scale, own = np.sqrt(self.filter.variance)[:, None], self._own
        # what torques add to the prediction the measurement lacks without them
        columns = -self.filter.columns(np.ascontiguousarray(torques.T)) / scale
        left = self.innovations / scale[:, 0]
        left, columns = left - own @ (own.T @ left), columns - own @ (own.T @ columns)
        size = np.sqrt(np.square(columns).sum(axis=0)) + 1e-300
        answer = np.linalg.lstsq(columns / size, left, rcond=1e-9)[0]
        return answer / size, 0.5 * float(answer @ ((columns / size).T @ left))


def _scaled(columns: Array) -> Array:
    size = np.sqrt(np.square(columns).sum(axis=0))
    return np.asarray(columns[:, size > 0] / size[size > 0])


def evaluate(model: SlidingModel, values: Mapping[str, float], noise: SlidingNoise) -> SlidingFit:
    """Return a model at these parameters."""
    torque, by = model.torque(values)
    with np.errstate(over="ignore", invalid="ignore"):  # far from any servo: no likelihood
        through = KalmanFilter(noise, model.over)
    e, own = through.innovations(model.over.measured, torque)
    slopes = np.column_stack([through.columns(by), own[:, 2:]])
    variance_slopes = np.zeros_like(slopes)
    variance_slopes[:, -NOISES:] = through.variance_slope[:, 2:]
    # inertia and viscous friction act in the filter itself
    for k, (name, value) in enumerate(((INERTIA, noise.inertia), (VISCOUS, noise.viscous))):
        for place in [i for i, f in enumerate(model.free) if f.name == name]:
            with np.errstate(over="ignore", invalid="ignore"):
                slopes[:, place] += own[:, k] / value
                variance_slopes[:, place] += through.variance_slope[:, k] / value
    total = -math.inf
    if through.variance.min() > 0:
        with np.errstate(over="ignore"):  # far from what was measured: infinitely unlikely
            total = -0.5 * float(np.sum(np.log(through.variance) + e * e / through.variance))
    for f in model.free:
        if f.nominal is not None:
            total -= 0.5 * ((f.scaled(values[f.name]) - f.nominal) / f.prior_sd) ** 2
    return SlidingFit(model, dict(values), noise, total, through, e, slopes, variance_slopes)


def _moved(fit: SlidingFit, step: Array) -> SlidingFit | None:
    """Return a fit after a step (k,), within the intervals; None where nothing is known there."""
    model, values = fit.model, dict(fit.values)
    for f, d in zip(model.free, step, strict=False):
        value = values[f.name]
        # the inertia stays positive
        if f.factor or f.name == INERTIA:
            value *= math.exp(float(np.clip(d / value, -LARGEST_STEP, LARGEST_STEP)))
        else:
            value += float(d)
        values[f.name] = f.clip(value)
    by = np.exp(np.clip(step[-NOISES:], -LARGEST_STEP, LARGEST_STEP))
    least = model.least_noises(values)
    torque, corner, sensor, white = np.maximum(by * fit.noises, least).tolist()
    viscous = max(values[VISCOUS], LEAST_RATE * values[INERTIA])
    noise = SlidingNoise(
        values[INERTIA], viscous, torque, min(corner, HIGHEST_CORNER), sensor, white
    )
    new = evaluate(model, values, noise)
    return new if math.isfinite(new.total) else None


def _held(fit: SlidingFit) -> NDArray[np.bool_]:
    """Return which parameters (k,) press against an end of their intervals."""
    slope, noises = fit.gradient, fit.noises
    own = [f.leaves(fit.values[f.name], g) for f, g in zip(fit.model.free, slope, strict=False)]
    held = (noises <= fit.model.least_noises(fit.values)) & (slope[-NOISES:] < 0)
    held |= np.array([False, noises[1] >= HIGHEST_CORNER, False, False]) & (slope[-NOISES:] > 0)
    return np.array([*own, *held])


def climb(fit: SlidingFit, iterations: int = ITERATIONS) -> SlidingFit:
    """Return the likeliest parameters, by steps along the Fisher information.

    Source: levenberg1944, marquardt1963 (damped steps).
    """
    damping = 1e-3
    for _ in range(iterations):
        free = ~_held(fit)
        size = np.sqrt(np.maximum(np.diag(fit.information)[free], 1e-300))
        table = fit.information[np.ix_(free, free)] / np.outer(size, size)
        gain = -math.inf
        while damping < 1e6:
            step = np.zeros(len(free))
            damped = table + damping * np.eye(len(size))
            step[free] = np.linalg.solve(damped, fit.gradient[free] / size) / size
            new = _moved(fit, step)
            gain = -math.inf if new is None else new.total - fit.total
            if new is not None and gain >= 0:
                fit, damping = new, max(damping / 10, 1e-8)
                break
            damping *= 10
        if gain < LEAST_RISE:
            break
    return fit


def fit_sliding(model: SlidingModel, values: Mapping[str, float]) -> SlidingFit | None:
    """Return the likeliest fit from the values of all parameters; None where too little slides or
    the torque is no function of the motion.
    """
    if len(model.over.counted) < LEAST_COUNTED or not model.drive(values):
        return None
    try:
        return _within_what_slides(climb(_begun(model, values)))
    except NotStaticError:
        return None


def at_guess(fit: SlidingFit, guess: Mapping[str, float]) -> SlidingFit:
    """Return a model with other values of parameters, and the noise that a fit begins with."""
    return _begun(fit.model, {**fit.values, **guess})


def loss_at(fit: SlidingFit, values: Mapping[str, float]) -> float:
    """Return what the log-likelihood of a fit loses [nats] with these values of its parameters, the
    noise fitted to them.
    """
    own = {name: values[name] for name in fit.free_values}
    held = replace(fit, model=replace(fit.model, free=()))
    return fit.total - climb(at_guess(held, own)).total


def _begun(model: SlidingModel, values: Mapping[str, float]) -> SlidingFit:
    inside = dict(values) | {f.name: f.clip(values[f.name]) for f in model.free}
    noise = SlidingNoise(
        inside[INERTIA],
        max(inside[VISCOUS], LEAST_RATE * inside[INERTIA]),
        START_SHARE * model.drive(inside),
        START_CORNER,
        model.resolution,
        START_WHITE * model.drive(inside) * math.sqrt(model.over.h),
    )
    return evaluate(model, inside, noise)


def _within_what_slides(fit: SlidingFit) -> SlidingFit:
    """Return a fit to stretches that end where the fit itself predicts the next sample to stand
    still.

    A light servo stops within a sample, sooner than a smoothed speed shows.
    """
    for _ in range(END_PASSES):
        torque, _ = fit.model.torque(fit.values)
        over = fit.filter.as_predicted(torque)
        if len(over.counted) < LEAST_COUNTED:
            break
        fit = climb(evaluate(replace(fit.model, over=over), fit.values, fit.noise))
    return fit


def refit_over(fit: SlidingFit, over: Stretches, free: tuple[Free, ...]) -> SlidingFit:
    """Return a fit with these parameters free, and its noise, to some of its stretches."""
    return climb(evaluate(replace(fit.model, over=over, free=free), fit.values, fit.noise))


def fit_beside(
    fit: SlidingFit,
    name: str,
    free: tuple[Free, ...],
    values: Mapping[str, float],
    iterations: int,
) -> SlidingFit:
    """Return a fit with an effect more, after some steps from these values of its parameters.

    A slow disturbance may stand in for the effect: the steps begin with one that is fast.

    Raise `NotStaticError` where its torque is no function of the motion.
    """
    old = fit.model
    model = replace(old, effects=(*old.effects, name), free=(*old.free, *free))
    noise = _fast(fit.noise)
    inside = {f.name: f.clip(values[f.name]) for f in free}
    return climb(evaluate(model, {**fit.values, **values, **inside}, noise), iterations)


def with_fast_disturbance(fit: SlidingFit) -> SlidingFit:
    """Return a fit as it is under a disturbance that cannot stand in for a slow effect."""
    return evaluate(fit.model, fit.values, _fast(fit.noise))


def _fast(noise: SlidingNoise) -> SlidingNoise:
    return replace(noise, corner=max(noise.corner, FAST_CORNER))
