"""Noise of a residual where nothing is missing: a coloured torque and the sensor's noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bristle.common.table import Array

CORNERS = (1.0, 3.0, 10.0, 30.0, 100.0)  # Hz: corner frequencies of the disturbance torque
RATIOS = np.logspace(-4, 8, 61)  # variance of the output by the disturbance over that by the sensor


def response(
    inertia: float, damping: float, h: float, width: int, bins: int, velocity: bool
) -> Array:
    """Return the averages (bins) that a torque of 1 N.m held over one sample (width * bins columns)
    gives.

    Exact for J v' = T - d v held over a sample. Source: astrom2008 (step response of a first-order
    lag).
    """
    n = width * bins
    t = h * np.arange(n + 1)
    rate = max(damping / inertia, 1e-9)
    lag = -np.expm1(-rate * t) / rate  # velocity after a unit acceleration of duration t
    kernel = lag if velocity else (t - lag) / rate
    # response after k samples to a pulse one sample long
    step = np.diff(kernel, prepend=0.0) / inertia
    delay = np.arange(n)[:, None] - np.arange(n)[None, :]
    table = np.where(delay > 0, step[np.clip(delay, 0, n)], 0.0)
    return np.asarray(table.reshape(bins, width, n).mean(axis=1))


@dataclass(frozen=True)
class Noise:
    """Gaussian noise of a segment's averages."""

    # (bins, bins): multiplies averages from the left, so that their covariance becomes 1
    whiten: Array
    log_det: float  # logarithm of the determinant of the covariance
    torque: float  # standard deviation of the disturbance [N.m]
    corner: float  # corner frequency of the disturbance [Hz]
    sensor: float  # standard deviation of the independent error of an average [unit of the output]


def white_noise(bins: int, sd: float) -> Noise:
    """Return the noise of a sensor alone, with a standard deviation of averages [unit of the
    output].
    """
    return Noise(np.eye(bins) / sd, 2 * bins * math.log(sd), 0.0, 1.0, sd)


def colour(pulses: Array, corner: float, h: float) -> Array:
    """Return the covariance of averages under a first-order noise torque of variance 1 with a
    corner frequency [Hz].
    """
    return np.asarray(pulses @ _memory(pulses.shape[1], 2 * np.pi * corner * h) @ pulses.T)


@lru_cache(maxsize=16)
def _memory(n: int, decay: float) -> Array:
    """Return the correlation of n samples of a first-order noise."""
    return np.asarray(np.exp(-decay * np.abs(np.subtract.outer(np.arange(n), np.arange(n)))))


def estimate(
    residual: Array, weights: Array, pulses: Array, h: float, least: float, slowest: float = 0.0
) -> Noise:
    """Return the most likely noise of residuals (segments, bins), given the weight of each segment.

    The initial states of segments are unknown, so that constants and ramps carry no information and
    are projected out. Parameters: pulses as of `response`; least: smallest standard deviation of an
    average by the sensor; slowest: smallest corner frequency of the disturbance [Hz].

    Source: patterson1971 (restricted maximum likelihood).
    """
    bins = residual.shape[1]
    # constants and ramps are projected out
    ramp = np.column_stack([np.ones(bins), np.linspace(-1, 1, bins)])
    free = np.linalg.svd(ramp, full_matrices=True)[0][:, 2:]
    projected = free.T @ residual.T
    sample = (projected * weights) @ projected.T / weights.sum()
    # at each corner all ratios of disturbance to sensor at once, in its eigenvectors
    best = (np.inf, 0.0, 0.0, CORNERS[0])
    for corner in (c for c in CORNERS if c >= slowest):
        full = colour(pulses, corner, h)
        unit = np.trace(full) / bins
        values, vectors = np.linalg.eigh(free.T @ full @ free / unit)
        power = np.einsum("ij,ik,kj->j", vectors, sample, vectors)
        spectrum = 1 + RATIOS[:, None] * np.maximum(values, 0.0)
        # the likeliest variance of the sensor at each ratio is known in closed form
        variance = np.maximum((power / spectrum).mean(axis=1), least**2)
        cost = np.log(variance[:, None] * spectrum).sum(axis=1) + (
            power / (variance[:, None] * spectrum)
        ).sum(axis=1)
        k = int(np.argmin(cost))
        if cost[k] < best[0]:
            best = (
                float(cost[k]),
                float(variance[k]),
                float(variance[k] * RATIOS[k] / unit),
                corner,
            )
    _, sensor, torque, corner = best
    # what whitens residuals under the best of them
    covariance = sensor * np.eye(bins) + torque * colour(pulses, corner, h)
    factor = np.linalg.cholesky(covariance)
    return Noise(
        np.linalg.inv(factor),
        2 * float(np.log(np.diag(factor)).sum()),
        torque**0.5,
        corner,
        sensor**0.5,
    )
