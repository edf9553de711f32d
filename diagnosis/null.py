"""How large the largest gain becomes when nothing is missing: a score bootstrap over segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REPLICATES = 1999
LEVEL = 0.002  # one-sided: a search of several rounds shall name something by chance in fewer than one record of a hundred


@dataclass(frozen=True)
class Null:
    """Distribution of the largest gain over all candidates [nats] where nothing is missing; `draws` (replicates,)."""

    draws: Array

    @property
    def level(self) -> float:
        """What chance exceeds in one search of `1/LEVEL` [nats]."""
        return float(np.quantile(self.draws, 1 - LEVEL))

    def p(self, gain: float) -> float:
        """Return how often chance reaches a gain; never below 1/(replicates + 1)."""
        return float((1 + np.count_nonzero(self.draws >= gain)) / (1 + len(self.draws)))


def directions(columns: Array, weight: Array) -> Array:
    """Return columns (segments, bins, k) made orthonormal in the weighted scalar product; what is dependent is dropped."""
    normal = np.einsum("s,snk,snl->kl", weight, columns, columns, optimize=True)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    keep = values > 1e-6
    return np.asarray(columns @ (vectors[:, keep] / size[:, None] / np.sqrt(values[keep])))


def largest_gain(banks: Sequence[Array], rest: Array, weight: Array, seed: int = 1, replicates: int = REPLICATES) -> Null:
    """Return the null distribution of the largest score gain.

    Parameters
    ----------
    banks : sequence of ndarray, shape (segments, bins, k)
        Directions in which each candidate could explain something, orthonormal, free of the model's own parameters.
    rest : ndarray, shape (segments, bins)
        Whitened residual of the best model at hand, so that what is missing does not count as noise.
    weight : ndarray, shape (segments,)
        Weight of each segment; 0 where it is not judged.

    The score of each segment gets a random sign, the same for all candidates: a wild bootstrap that keeps each
    segment's own spread and colour. Source: liu1988, kline2012 (score form).
    """
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=(replicates, len(weight)))
    draws = np.zeros(replicates)
    for bank in banks:
        scores = np.einsum("s,snk,sn->sk", weight, bank, rest, optimize=True)
        draws = np.maximum(draws, 0.5 * np.square(signs @ scores).sum(axis=1))
    return Null(draws)
