"""Regression of the torque on acceleration, velocity and direction, all low-passed alike: J, a2 and
Fc without a simulation.

It is biased by every effect that the model lacks, but accurate enough to show a wrong sign or a
wrong unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import butter, sosfiltfilt

from bristle.common.table import Array
from bristle.records.record import Record

LOWPASS_CUTOFF = 25.0  # Hz: cutoff of the low-pass, where the sampling allows it
CUTOFF_SAMPLES = 8.0  # samples: least period of the cutoff
LOWEST_CUTOFF = 2.0  # Hz: below it the cutoff is not lowered further
CUTOFF_STEP = 0.7  # factor by which the cutoff is lowered
# of the acceleration, rms: most that may come from the resolution; else the cutoff is lowered
ACCELERATION_NOISE = 0.2
# blocks of neighbouring samples of a record that are left out in turn for the standard errors
JACKKNIFE_BLOCKS = 20
LEAST_ROWS = 100  # rows in motion: with fewer there is no regression


@dataclass(frozen=True)
class Rows:
    """Rows of the regression: torque (n,), core terms (n, 3), free terms (n, k), block (n,)."""

    torque: Array
    core: Array
    free: Array
    block: NDArray[np.int_]

    @property
    def scale(self) -> Array:
        """Root mean squares of the core terms (3,)."""
        return np.asarray(np.maximum(np.sqrt(np.mean(self.core**2, axis=0)), 1e-300))


@dataclass(frozen=True)
class Regression:
    """J, a2 and Fc of either sign (3,), standard errors (3,), and the share they explain."""

    rows: Rows
    value: Array
    error: Array
    explained: float

    def known(self, errors: float) -> NDArray[np.bool_]:
        """True for values that are so many standard errors above 0."""
        return np.asarray(self.value > errors * self.error)


def _slope(x: Array, h: float) -> Array:
    """Return the derivative by central differences of fourth order; the two values at either end
    repeat their neighbour.
    """
    d = np.empty_like(x)
    d[2:-2] = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * h)
    d[:2], d[-2:] = d[2], d[-3]
    return d


def _motion(
    y: Array, h: float, step: float, velocity: bool
) -> tuple[Array, Array, Array, Array, float]:
    """Return (low-pass, position, velocity, acceleration, noise of the velocity) of one record.

    The cutoff is lowered until the steps of the output contribute little to the acceleration.
    """
    cutoff = min(LOWPASS_CUTOFF, 1.0 / (CUTOFF_SAMPLES * h))
    order = 1 if velocity else 2
    while True:
        low = butter(2, cutoff, fs=1.0 / h, output="sos")
        smooth = sosfiltfilt(low, y)
        v = smooth if velocity else _slope(smooth, h)
        a = _slope(v, h)
        # white noise of step^2/12 after the low-pass and `order` differentiations
        density = step**2 / 12.0 * 2.0 * h
        noise = [
            math.sqrt(density * (2 * math.pi) ** (2 * n) * cutoff ** (2 * n + 1) / (2 * n + 1))
            for n in (order - 1, order)
        ]
        if noise[1] < ACCELERATION_NOISE * float(np.std(a)) or cutoff < LOWEST_CUTOFF:
            break
        cutoff *= CUTOFF_STEP
    theta = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * h / 2)]) if velocity else smooth
    return low, theta, v, a, noise[0]


def regression_rows(
    columns: Sequence[tuple[Array, Array]],
    records: Sequence[Record],
    velocity: bool,
    steps: bool = True,
) -> Rows | None:
    """Return the rows of all records while they move, or None if there are too few.

    `columns` (n,): torque and output of each record. `records`: give sampling period and
    resolution. `velocity`: whether the output is a velocity. `steps`: whether the output has the
    records' resolution.
    """
    torque, core, free, block = [], [], [], []
    motions = [
        _motion(y, r.h, (r.resolution or 0.0) * steps, velocity)
        for (_, y), r in zip(columns, records, strict=True)
    ]
    scale = float(np.sqrt(np.mean(np.concatenate([v**2 for _, _, v, _, _ in motions]))))
    for number, ((u, _), record, (low, theta, v, a, noise)) in enumerate(
        zip(columns, records, motions, strict=True)
    ):
        rest = max(3.0 * noise, 0.02 * scale)
        direction = sosfiltfilt(low, np.where(np.abs(v) > rest, np.sign(v), 0.0))
        # not near a reversal, where friction does not follow the sign
        use = np.abs(direction) > 0.9
        use[:10] = use[-10:] = False  # nor where the filter is not valid
        chosen = np.flatnonzero(use)[:: max(1, round(0.01 / record.h))]
        torque.append(sosfiltfilt(low, u)[chosen])
        core.append(np.column_stack([sosfiltfilt(low, a), sosfiltfilt(low, v), direction])[chosen])
        free.append(np.column_stack([np.ones_like(v), theta, np.sin(theta), np.cos(theta)])[chosen])
        block.append(number * JACKKNIFE_BLOCKS + (chosen * JACKKNIFE_BLOCKS) // len(v))
    rows = Rows(*(np.concatenate(parts) for parts in (torque, core, free, block)))
    if len(rows.torque) < LEAST_ROWS or float(np.ptp(rows.torque)) == 0.0:
        return None
    size = np.max(np.abs(rows.free), axis=0)
    return Rows(rows.torque, rows.core, rows.free / np.where(size > 0.0, size, 1.0), rows.block)


def regress(rows: Rows) -> Regression:
    """Return the regression with Huber's weights; standard errors by the jackknife over blocks."""
    size = rows.scale
    x = np.column_stack([rows.core / size, rows.free])
    ridge = 1e-9 * len(x) * np.eye(x.shape[1])  # theta, sin and cos are collinear on a small range
    weight = np.ones(len(x))
    for _ in range(8):
        b = np.linalg.solve(
            (x * weight[:, None]).T @ x + ridge, (x * weight[:, None]).T @ rows.torque
        )
        r = rows.torque - x @ b
        spread = 1.4826 * float(np.median(np.abs(r))) + 1e-12 * float(np.max(np.abs(rows.torque)))
        weight = np.minimum(1.0, 1.5 * spread / np.maximum(np.abs(r), 1e-300))
    blocks = np.unique(rows.block)
    parts = []
    for part in np.array_split(blocks, min(JACKKNIFE_BLOCKS, len(blocks))):
        keep = ~np.isin(rows.block, part)
        z, w = x[keep], weight[keep, None]
        parts.append(np.linalg.solve((z * w).T @ z + ridge, (z * w).T @ rows.torque[keep]))
    n = len(parts)
    error = np.sqrt((n - 1) / n * np.sum((np.array(parts) - np.mean(parts, axis=0)) ** 2, axis=0))
    return Regression(rows, b[:3] / size, error[:3] / size, _share(r, rows.torque))


def explained_share(rows: Rows | None, sign: float = 1.0) -> tuple[float, Array]:
    """Return the share of the torque that J, a2 and Fc not below 0 explain, and these (3,), for an
    input of this sign.
    """
    if rows is None:
        return 0.0, np.zeros(3)
    size = rows.scale
    x = np.column_stack([rows.core / size, rows.free, -rows.free])
    b, _ = nnls(x, sign * rows.torque, maxiter=1000)
    return _share(sign * rows.torque - x @ b, sign * rows.torque), b[:3] / size


def _share(residual: Array, torque: Array) -> float:
    return 1.0 - float(np.sum(residual**2) / np.sum((torque - np.mean(torque)) ** 2))
