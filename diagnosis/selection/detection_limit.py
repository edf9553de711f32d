"""How large an effect may be without being detected by a search that did not add it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bristle.diagnosis.selection.candidates import Candidate
from bristle.diagnosis.selection.null_distribution import Null
from bristle.plant.effects import effect as find_effect

# SI unit of the parameter: a limit beyond this says that the records cannot show the effect
LARGEST_LIMIT = 1e5


@dataclass(frozen=True)
class Undetected:
    """What a search says of an effect that it did not add."""

    name: str
    reason: str = ""  # why it could not be tried, or an empty text
    # gain of its log-likelihood [nats], if it is above the level that chance reaches
    gain: float | None = None
    failed: str = ""  # with a gain above that level: the condition that it does not meet
    # False if no parameter says how large it is: it does not vanish in proportion to its first one
    measurable: bool = True
    # parameters from which these records cannot distinguish its size
    confounded: tuple[str, ...] = ()
    # value of its first parameter [SI] that would have been detected; None if the records set no
    # limit
    limit: float | None = None


def detection_limits(candidates: Sequence[Candidate], null: Null, base: float) -> list[Undetected]:
    """Return what a search says of each candidate; `base` is the log-likelihood without any of them
    [nats].
    """
    return [_undetected(candidate, null, base) for candidate in candidates]


def _failed(c: Candidate) -> str:
    """Return why a candidate that gains more than chance was not added."""
    if c.assessment is None:  # it was not compared on held-out segments
        return "gains far less than another effect, or only with values that are not credible"
    if c.assessment.objection:
        return c.assessment.objection
    return (
        "explains the residual less well than another effect"
        if c.assessment.deficit[0] > 0
        else "was rejected by the search"
    )


def _undetected(c: Candidate, null: Null, base: float) -> Undetected:
    if c.fit is None:
        return Undetected(c.name, c.reason)
    if (gain := c.fit.total - base) > null.level(c.name):
        return Undetected(c.name, gain=gain, failed=_failed(c))
    effect = find_effect(c.name)
    strength = effect.strength
    free = [f.name for f in c.fit.free]
    # nothing is left of it at zero
    proportional = strength.minimum <= 0 <= strength.maximum and not effect.sparse
    if not proportional or strength.name not in free:
        return Undetected(c.name, measurable=False)
    place = free.index(strength.name)
    if others := c.fit.collinear_with(place):
        return Undetected(c.name, confounded=tuple(others))
    spread = float(np.linalg.pinv(c.fit.information, rcond=1e-12, hermitian=True)[place, place])
    limit = math.sqrt(2 * null.level(c.name) * max(spread, 0.0))
    shown = math.isfinite(limit) and 0 < limit <= min(strength.maximum, LARGEST_LIMIT)
    return Undetected(c.name, limit=limit if shown else None)
