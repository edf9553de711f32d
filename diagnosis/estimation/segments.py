"""Records cut into short segments, and the smoothed motion over them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
SEGMENT_SECONDS = 0.4  # s: long enough for friction and inertia to show, short enough for a disturbance not to drift away
SEGMENT_BINS = 50  # averages a segment: what is faster than 60 Hz in 0.4 s is the resolution's
STATE_SMOOTHING = 0.02  # s: half-width of the parabola that gives position and velocity at the start of a segment


@dataclass(frozen=True)
class Piece:
    """One record as consecutive segments: time of the first sample [s], inputs (segments * bins * width,), measured
    averages (segments, bins), states at the starts (segments, 2) with their standard deviations."""

    name: str
    time: float
    u: Array
    seen: Array
    starts: Array
    spread: Array


@dataclass(frozen=True)
class Segments:
    """All records as segments of `bins` averages over `width` samples of length h; `velocity` says what was measured.

    The first segment of each record only brings the hidden states to life: it is simulated, not judged.
    """

    pieces: tuple[Piece, ...]
    h: float
    width: int
    bins: int
    velocity: bool

    @property
    def seen(self) -> Array:
        """Measured averages (segments, bins)."""
        return np.concatenate([piece.seen for piece in self.pieces])

    @property
    def starts(self) -> Array:
        """Measured states at the starts of the segments (segments, 2)."""
        return np.concatenate([piece.starts for piece in self.pieces])

    @property
    def spread(self) -> Array:
        """Standard deviations of `starts`."""
        return np.concatenate([piece.spread for piece in self.pieces])

    @property
    def seconds(self) -> float:
        """How long each lasts [s]."""
        return self.bins * self.width * self.h

    @property
    def judged(self) -> Mask:
        """False for the first segment of each record."""
        return np.concatenate([np.arange(len(piece.seen)) > 0 for piece in self.pieces])

    @property
    def block(self) -> NDArray[np.int_]:
        """Number of each segment within its record."""
        return np.concatenate([np.arange(len(piece.seen)) for piece in self.pieces])


def smooth(y: Array, h: float, half: float, order: int = 0) -> Array:
    """Return y or its derivative of an order, from a parabola through the samples within `half` seconds."""
    reach = max(2, round(half / h))
    reach = min(reach, (len(y) - 1) // 2)
    kernel = savgol_coeffs(2 * reach + 1, 2, deriv=order, delta=h)
    padded = np.concatenate([2 * y[0] - y[reach:0:-1], y, 2 * y[-1] - y[-2 : -reach - 2 : -1]])
    return np.convolve(padded, kernel, mode="valid")


def cut(name: str, time: float, h: float, u: Array, y: Array, velocity: bool, resolution: float, width: int, bins: int) -> Piece:
    """Return one record as segments; what is left at the end is dropped."""
    length = width * bins
    n = len(u) // length
    first = np.arange(n) * length
    reach = max(2, round(STATE_SMOOTHING / h))
    noise = max(resolution / np.sqrt(12), float(np.std(y - smooth(y, h, STATE_SMOOTHING))), 1e-12)
    if velocity:
        starts = np.column_stack([np.zeros(n), smooth(y, h, STATE_SMOOTHING)[first]])
        spread = np.column_stack([np.ones(n), np.full(n, 10 * noise)])
    else:
        v = smooth(y, h, STATE_SMOOTHING, 1)
        starts = np.column_stack([smooth(y, h, STATE_SMOOTHING)[first], v[first]])
        doubt = 10 * noise / (h * reach**1.5) + 0.05 * np.abs(v[first])
        spread = np.column_stack([np.full(n, 10 * noise), doubt])
    seen = y[: n * length].reshape(n, bins, width).mean(axis=2)
    return Piece(name, time, np.ascontiguousarray(u[: n * length]), seen, starts, spread)


REST_STEPS = 3.0  # a speed below this many steps of the sensor in the smoothing window is rest


@dataclass(frozen=True)
class Motion:
    """The measured motion over all segments, one sample after the other, arrays (segments * bins * width,)."""

    theta: Array
    v: Array
    a: Array
    u: Array
    time: Array
    moving: NDArray[np.bool_]
    record: NDArray[np.int_]


def motion(segments: Segments, outputs: list[Array], resolution: float, half: float) -> Motion:
    """Return the smoothed motion of the records whose measured outputs (n,) are given, cut to their segments."""
    h, parts = segments.h, []
    for i, (piece, y) in enumerate(zip(segments.pieces, outputs, strict=True)):
        n = len(piece.u)
        if segments.velocity:
            v, a = smooth(y, h, half)[:n], smooth(y, h, half, 1)[:n]
            theta = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * h / 2)])
            still = REST_STEPS * resolution
        else:
            theta, v, a = (smooth(y, h, half, order)[:n] for order in (0, 1, 2))
            still = REST_STEPS * resolution / (2 * half)
        time = piece.time + h * np.arange(n)
        parts.append((theta, v, a, piece.u, time, np.abs(v) > still, np.full(n, i)))
    return Motion(*(np.concatenate(column) for column in zip(*parts, strict=True)))
