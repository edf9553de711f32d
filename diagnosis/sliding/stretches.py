"""Where records slide: stretches of samples in which the sign of the velocity is certain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs

from bristle.common.table import Array

SMOOTHING = 0.01  # s: half-width of the parabola that gives the motion
LEAST_REACH = 3  # samples of that half-width at least
SLOWEST_SHARE = 0.1  # of the rms speed: slowest motion that counts as sliding
SLOWEST_STEPS = 3.0  # steps of the sensor within the parabola: the same
LEAST_SECONDS = 0.06  # s: shortest stretch
# of the parabola's half-width: what is cut off both ends, where friction has not settled
TRIMMED = 2.5
SETTLING = 6  # first samples of a stretch that do not count


@dataclass(frozen=True)
class Stretches:
    """Records, one after the other, and the stretches [begin, end) of them that slide.

    `measured`, `u`, `time`, `record` (samples,): as in the records; `theta`, `v`, `a`: the smoothed
    motion.
    """

    h: float
    velocity: bool
    measured: Array
    u: Array
    time: Array
    record: NDArray[np.int_]
    theta: Array
    v: Array
    a: Array
    begin: NDArray[np.int64]
    end: NDArray[np.int64]

    @cached_property
    def counted(self) -> NDArray[np.int64]:
        """Samples whose innovations count."""
        first = self.begin + SETTLING
        return np.concatenate(
            [np.arange(a, b) for a, b in zip(first, self.end, strict=True)] or [np.empty(0, int)]
        )

    @cached_property
    def slides(self) -> Array:
        """1 for samples in a stretch (samples,), else 0."""
        inside = np.zeros(len(self.measured))
        inside[self.counted] = 1.0
        return inside

    @cached_property
    def age(self) -> NDArray[np.int64]:
        """Innovations of its stretch before each counted sample."""
        lag = SETTLING - (1 if self.velocity else 2)
        return np.concatenate(
            [lag + np.arange(b - a - SETTLING) for a, b in zip(self.begin, self.end, strict=True)]
            or [np.empty(0, int)]
        )

    @cached_property
    def longest(self) -> int:
        """Samples of the longest stretch."""
        return int((self.end - self.begin).max(initial=1))

    @cached_property
    def change(self) -> float:
        """Change of the speed from one sample to the next, rms [rad/s]."""
        return float(self.h * np.sqrt(np.mean(np.square(self.a[self.counted]))))

    @property
    def seconds(self) -> float:
        """Length of all stretches together [s]."""
        return float(self.h * len(self.counted))


def smooth(y: Array, h: float, half: float, order: int = 0) -> Array:
    """Return y or its derivative of an order, by a parabola through the samples within `half` s."""
    reach = max(2, round(half / h))
    reach = min(reach, (len(y) - 1) // 2)
    kernel = savgol_coeffs(2 * reach + 1, 2, deriv=order, delta=h)
    padded = np.concatenate([2 * y[0] - y[reach:0:-1], y, 2 * y[-1] - y[-2 : -reach - 2 : -1]])
    return np.convolve(padded, kernel, mode="valid")


def stretches_of(
    records: Sequence[tuple[Array, Array, Array]], h: float, velocity: bool, resolution: float
) -> Stretches:
    """Return the stretches of records, each (time, input, output) of n samples."""
    half = max(SMOOTHING, LEAST_REACH * h)
    motions = [_motion(y, h, half, velocity) for _, _, y in records]
    speed = np.concatenate([v for _, v, _ in motions])
    step = resolution if velocity else resolution / (2 * half)
    slowest = max(SLOWEST_STEPS * step, SLOWEST_SHARE * float(np.sqrt(np.mean(speed**2))))
    places, offset = list[tuple[int, int]](), 0
    for _, v, _ in motions:
        places += [(offset + a, offset + b) for a, b in _sliding(v, slowest, h, half)]
        offset += len(v)
    begin, end = (np.array([each[k] for each in places], dtype=np.int64) for k in (0, 1))
    time, u, y = (np.concatenate(each).astype(float) for each in zip(*records, strict=True))
    theta, v, a = (np.concatenate(each) for each in zip(*motions, strict=True))
    record = np.repeat(np.arange(len(records)), [len(each[0]) for each in records])
    return Stretches(h, velocity, y, u, time, record, theta, v, a, begin, end)


def _motion(y: Array, h: float, half: float, velocity: bool) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of a record (n,)."""
    if not velocity:
        theta, v, a = (smooth(y, h, half, order) for order in (0, 1, 2))
        return theta, v, a
    v, a = smooth(y, h, half), smooth(y, h, half, 1)
    return np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * h / 2)]), v, a


def _sliding(v: Array, slowest: float, h: float, half: float) -> Iterator[tuple[int, int]]:
    """Give the ends of the stretches of a record with this velocity (n,)."""
    sign = np.where(np.abs(v) > slowest, np.sign(v), 0.0)
    changes = np.flatnonzero(np.diff(sign)) + 1
    cut = round(TRIMMED * half / h)
    for a, b in pairwise([0, *changes, len(v)]):
        if sign[a] and (b - a) * h >= LEAST_SECONDS and b - a - 2 * cut > 2 * SETTLING:
            yield int(a) + cut, int(b) - cut
