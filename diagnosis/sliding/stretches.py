"""Where records slide: stretches of samples in which the sign of the velocity is certain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs, savgol_filter

from bristle.common.table import Array

SMOOTHING = 0.01  # s: half-width of the parabola that gives the motion
LEAST_REACH = 3  # samples of that half-width at least
SLOWEST_SHARE = 0.1  # of the rms speed: slowest motion that counts as sliding
SLOWEST_STEPS = 3.0  # steps of the sensor within the parabola: the same
# of the parabola's half-width: what is cut off the beginning, where friction has not settled
TRIMMED = 2.5
SETTLING = 6  # first samples of a stretch that do not count


@dataclass(frozen=True)
class Stretches:
    """Records, one after the other, and the stretches [begin, end) of them that slide.

    `measured`, `u`, `time`, `record`, `known` (samples,): as in the records; `theta`, `v`, `a`: the
    smoothed motion.
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
    known: Mapping[str, Array] = field(default_factory=dict)

    @cached_property
    def counted(self) -> NDArray[np.int64]:
        """Samples whose innovations count."""
        parts = [np.arange(a + SETTLING, b) for a, b in zip(self.begin, self.end, strict=True)]
        return np.concatenate([np.empty(0, dtype=np.int64), *parts])

    @cached_property
    def slides(self) -> Array:
        """1 for samples in a stretch (samples,), else 0."""
        inside = np.zeros(len(self.measured))
        inside[self.counted] = 1.0
        return inside

    @cached_property
    def u_before(self) -> Array:
        """Input of the sample before, in the same record."""
        before = np.roll(self.u, 1)
        first = np.flatnonzero(np.diff(self.record, prepend=-1))
        before[first] = self.u[first]
        return before

    @cached_property
    def u_first(self) -> Array:
        """Input of the first sample of the same record."""
        return self.u[np.searchsorted(self.record, self.record)]

    @cached_property
    def halfway(self) -> tuple[Array, Array]:
        """Position and velocity between each sample and the next (samples,): what acts in between
        is known by its mean.
        """
        v = (self.v + self.after(self.v)) / 2
        return self.theta + self.h / 2 * v, v

    def after(self, x: Array) -> Array:
        """Return samples (samples,) one later, in each record; its last one stays."""
        last = np.diff(self.record, append=-1) != 0
        return np.where(last, x, np.roll(x, -1))

    @cached_property
    def error_sum(self) -> Array:
        """Integral of input less position since the start of the record [rad.s]."""
        error = self.u - self.measured
        parts = [error[self.record == k] for k in range(int(self.record[-1]) + 1)]
        return np.concatenate([integral(each, self.h) for each in parts])

    @cached_property
    def age(self) -> NDArray[np.int64]:
        """Innovations of its stretch before each counted sample."""
        lag, lengths = SETTLING - (1 if self.velocity else 2), self.end - self.begin - SETTLING
        parts = [lag + np.arange(max(0, length)) for length in lengths]
        return np.concatenate([np.empty(0, dtype=np.int64), *parts])

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


def integral(x: Array, h: float) -> Array:
    """Return the integral of samples (n,) from the first up to each, held between them."""
    return np.asarray(h * (np.cumsum(x) - x))


def smooth(y: Array, h: float, half: float, order: int = 0) -> Array:
    """Return y or its derivative of an order, by a parabola through the samples within `half` s."""
    reach = max(2, round(half / h))
    reach = min(reach, (len(y) - 1) // 2)
    return np.asarray(savgol_filter(y, 2 * reach + 1, 2, deriv=order, delta=h))


def stretches_of(
    records: Sequence[tuple[Array, Array, Array]],
    h: float,
    velocity: bool,
    resolution: float,
    known: Mapping[str, Array] | None = None,
) -> Stretches:
    """Return the stretches of records, each (time, input, output) of n samples; `known`: other
    inputs of all records, one after the other.
    """
    half = max(SMOOTHING, LEAST_REACH * h)
    motions = [_motion(y, h, half, velocity) for _, _, y in records]
    speed = np.concatenate([v for _, v, _ in motions])
    step = resolution if velocity else resolution / (2 * half)
    slowest = max(SLOWEST_STEPS * step, SLOWEST_SHARE * float(np.sqrt(np.mean(speed**2))))
    places, offset = list[tuple[int, int]](), 0
    for _, _, y in records:
        found = _sliding(y, velocity, h, half, slowest)
        places += [(offset + begin, offset + end) for begin, end in found]
        offset += len(y)
    begin, end = (np.array([each[k] for each in places], dtype=np.int64) for k in (0, 1))
    time, u, y = (np.concatenate(each).astype(float) for each in zip(*records, strict=True))
    theta, v, a = (np.concatenate(each) for each in zip(*motions, strict=True))
    record = np.repeat(np.arange(len(records)), [len(each[0]) for each in records])
    return Stretches(h, velocity, y, u, time, record, theta, v, a, begin, end, known or {})


def _motion(y: Array, h: float, half: float, velocity: bool) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of a record (n,)."""
    if not velocity:
        theta, v, a = (smooth(y, h, half, order) for order in (0, 1, 2))
        return theta, v, a
    v, a = smooth(y, h, half), smooth(y, h, half, 1)
    return np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * h / 2)]), v, a


def _sliding(
    y: Array, velocity: bool, h: float, half: float, slowest: float
) -> Iterator[tuple[int, int]]:
    """Give the ends of the stretches of a record with this output (n,).

    Whether a sample belongs to one depends on samples up to it alone: to choose by what comes after
    would choose among the disturbances, and bias friction (kept are those that went on).
    """
    reach = max(2, round(half / h))
    n, order = 2 * reach + 1, 0 if velocity else 1
    kernels = [savgol_coeffs(n, 2, order + k, h, n - 1) for k in (0, 1)]
    none = np.zeros(n - 1)
    v, a = (np.concatenate([none, np.convolve(y, each, mode="valid")]) for each in kernels)
    # fast now, and after as long again
    sign = np.sign(v)
    fast = (np.abs(v) > slowest) & (sign * (v + a * half) > slowest)
    changes = np.flatnonzero(np.diff(sign * fast)) + 1
    cut = round(TRIMMED * half / h)
    for begin, end in pairwise([0, *changes, len(y)]):
        if fast[begin] and end - begin - cut > SETTLING:
            yield int(begin) + cut, int(end)
