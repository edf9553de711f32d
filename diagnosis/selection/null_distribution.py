"""Null distribution of the largest gain over all candidates, by a score bootstrap over segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bristle.common.table import Array
from bristle.diagnosis.localisation.residual_response import chance

REPLICATES = 1999  # draws of random signs
# quantile of a candidate's own chance gain that is subtracted before candidates are compared
TYPICAL_QUANTILE = 0.95
SCORE_CLIP = 3.0  # standard deviations: largest score of one segment
# share of searches in which chance alone brings some candidate above its level
FALSE_ALARM_RATE = 0.002
# refits from several starts gain so much more by chance than scores (benchmarks/results/level.md)
REFIT_FACTOR = 4.0


@dataclass(frozen=True)
class Null:
    """Distribution of the largest gain of all candidates [nats] where no effect is missing.

    `draws` (replicates,): largest excess of any candidate over its typical gain by chance. A
    candidate with many parameters or a searched frequency gains more by chance; without this it
    would mask the others.
    """

    draws: Array
    typical: Mapping[str, float]  # `TYPICAL_QUANTILE` of each candidate's gain by chance [nats]
    # share of searches in which chance alone brings some candidate above its level
    false_alarm_rate: float = FALSE_ALARM_RATE

    def after_refits(self) -> Null:
        """Return the distribution of what refits of candidates gain, from that of their scores."""
        return replace(self, draws=REFIT_FACTOR * self.draws)

    def level(self, name: str) -> float:
        """Return the gain [nats] above which a candidate is accepted."""
        return float(np.quantile(self.draws, 1 - self.false_alarm_rate)) + self.typical.get(
            name, 0.0
        )

    def p(self, name: str, gain: float) -> float:
        """Return the p of a candidate's gain over all candidates; at least 1/(replicates + 1)."""
        return chance(self.draws, gain - self.typical.get(name, 0.0))


def largest_gain(
    directions: Mapping[str, Sequence[Array]],
    residual: Array,
    weight: Array,
    seed: int = 1,
    replicates: int = REPLICATES,
) -> Null:
    """Return the null distribution of the largest score gain.

    `directions` (segments, bins, k): directions of the residual that each start value of a
    candidate can explain, orthonormal, free of the model's own parameters. `residual` (segments,
    bins): whitened residual of the best model at hand, so that a missing effect does not count as
    noise. `weight` (segments,): weight of each segment; 0 where it is not judged.

    The score of each segment gets a random sign, the same for all candidates: a wild bootstrap that
    keeps each segment's own spread and colour. Scores are clipped at some standard deviations of
    their own; otherwise a direction with only one segment would find its own observation again in
    every replicate.

    Source: liu1988, kline2012 (score form), huber1981 (bounded influence).
    """
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=(replicates, len(weight)))
    largest, typical = np.zeros(replicates), {}
    for name, several in directions.items():
        draws = np.max([_gains(each, residual, weight, signs) for each in several], axis=0)
        typical[name] = float(np.quantile(draws, TYPICAL_QUANTILE))
        largest = np.maximum(largest, draws - typical[name])
    return Null(largest, typical)


def _gains(directions: Array, residual: Array, weight: Array, signs: Array) -> Array:
    """Return the score gain of one set of directions for each set of signs (replicates,) [nats]."""
    scores = np.einsum("s,snk,sn->sk", weight, directions, residual, optimize=True)
    most = SCORE_CLIP * np.sqrt(
        np.einsum("s,snk,snk->sk", weight, directions, directions, optimize=True)
    )
    return np.asarray(0.5 * np.square(signs @ np.clip(scores, -most, most)).sum(axis=1))
