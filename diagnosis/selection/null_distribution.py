"""How large the largest gain becomes when nothing is missing: a score bootstrap over segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.localisation.residual_response import chance

Array = NDArray[np.float64]
REPLICATES = 1999
USUAL_QUANTILE = 0.95  # quantile of a candidate's own chance gain to which it is compared
SCORE_CLIP = 3.0  # standard deviations that a segment's score may count for
FALSE_ALARM_RATE = (
    0.002  # one-sided: a search of several rounds shall name something by chance in fewer than one record of a hundred
)


@dataclass(frozen=True)
class Null:
    """Distribution of the largest gain over all candidates [nats] where nothing is missing.

    `draws` (replicates,): the largest gain above what each candidate `usual`ly gains by chance, so that one with many
    parameters or a frequency to choose does not hide the others.
    """

    draws: Array
    usual: Mapping[str, float]

    def level(self, name: str) -> float:
        """Return the gain of a candidate from which no more than one search in `1/LEVEL` shows one as large by chance."""
        return float(np.quantile(self.draws, 1 - FALSE_ALARM_RATE)) + self.usual.get(name, 0.0)

    def p(self, name: str, gain: float) -> float:
        """Return how often chance brings any candidate as far above its usual gain; never below 1/(replicates + 1)."""
        return chance(self.draws, gain - self.usual.get(name, 0.0))


def largest_gain(
    banks: Mapping[str, Sequence[Array]], rest: Array, weight: Array, seed: int = 1, replicates: int = REPLICATES
) -> Null:
    """Return the null distribution of the largest score gain.

    Parameters
    ----------
    banks : mapping of name to a sequence of ndarray, shape (segments, bins, k)
        Directions in which each start of a candidate could explain something, orthonormal, free of the model's own
        parameters.
    rest : ndarray, shape (segments, bins)
        Whitened residual of the best model at hand, so that what is missing does not count as noise.
    weight : ndarray, shape (segments,)
        Weight of each segment; 0 where it is not judged.

    The score of each segment gets a random sign, the same for all candidates: a wild bootstrap that keeps each
    segment's own spread and colour. No score counts for more than some standard deviations of its own, or a direction
    that lives in one segment would find its own observation again in every replicate.

    Source: liu1988, kline2012 (score form), huber1981 (bounded influence).
    """
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=(replicates, len(weight)))
    largest, usual = np.zeros(replicates), {}
    for name, several in banks.items():
        draws = np.max([_draws(bank, rest, weight, signs) for bank in several], axis=0)
        usual[name] = float(np.quantile(draws, USUAL_QUANTILE))
        largest = np.maximum(largest, draws - usual[name])
    return Null(largest, usual)


def _draws(bank: Array, rest: Array, weight: Array, signs: Array) -> Array:
    """Return what one set of directions gains under each set of signs (replicates,) [nats]."""
    scores = np.einsum("s,snk,sn->sk", weight, bank, rest, optimize=True)
    most = SCORE_CLIP * np.sqrt(np.einsum("s,snk,snk->sk", weight, bank, bank, optimize=True))
    return np.asarray(0.5 * np.square(signs @ np.clip(scores, -most, most)).sum(axis=1))
