"""What each segment tells of the disturbance at the beginning of the next one.

A slow disturbance goes on from one segment to the next, and a tight loop has already answered it
with the input: taken anew in each segment it would be mistaken for a smaller effect of the input.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.estimation.noise import Noise

__all__ = ["Carried"]


@dataclass(frozen=True)
class Carried:
    """The disturbance at the beginning of each segment, given the segment before.

    `own` of its methods: whitened columns (segments, bins, k), free of the initial states, by which
    a segment tells of the next.

    Source: rasmussen2006 eq. (2.23), (2.24) (mean and covariance of a Gaussian, given another).
    """

    noise: Noise
    # (segments,): variance that the segment before explains [N.m squared]; 0 where none tells
    told: Array

    @classmethod
    def of(cls, noise: Noise, follows: NDArray[np.bool_], own: Array) -> Carried:
        """Return it for segments of which some follow another; `own`: of `noise.end`."""
        explained = np.roll(np.einsum("n,sn->s", noise.end, own), 1)
        return cls(noise, np.where(follows, np.clip(explained, 0.0, noise.torque**2), 0.0))

    def less(self, columns: Array, own: Array) -> Array:
        """Return whitened columns (segments, bins, k) less what the segments before tell, whitened
        again.
        """
        before = np.roll(np.einsum("n,snk->sk", self.noise.end, own), 1, axis=0)
        known = (self.told > 0)[:, None] * before
        return self.whitened(columns - self.noise.begin[:, None] * known[:, None, :])

    def whitened(self, columns: Array) -> Array:
        """Return whitened columns (segments, bins, k) with the variance that is told taken away."""
        begin, size = self.noise.begin, self._size
        share = np.where(size > 0, ((1.0 - self._lost) ** -0.5 - 1.0) / max(size, 1e-300), 0.0)
        along = np.einsum("n,snk->sk", begin, columns)
        return np.asarray(columns + begin[:, None] * (share[:, None] * along)[:, None, :])

    @property
    def log_det(self) -> Array:
        """Change of the logarithm of the determinant of the covariance (segments,)."""
        return np.asarray(np.log1p(-self._lost))

    @property
    def _size(self) -> float:
        return float(self.noise.begin @ self.noise.begin)

    @property
    def _lost(self) -> Array:
        return self.told * self._size
