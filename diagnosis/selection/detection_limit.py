"""How large an effect may be without being detected by a search that did not add it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bristle.diagnosis.answer import Finding, Reason, Undetected, finding
from bristle.diagnosis.selection.candidates import EffectFit
from bristle.diagnosis.selection.null_distribution import Null
from bristle.plant.effects import effect as find_effect

# SI unit of the parameter: a limit beyond this says that the records cannot show the effect
LARGEST_LIMIT = 1e5


def detection_limits(candidates: Sequence[EffectFit], null: Null, base: float) -> list[Undetected]:
    """Return what a search says of each candidate; `base` is the log-likelihood without any."""
    return [_undetected(candidate, null, base) for candidate in candidates]


def _failed(c: EffectFit) -> Finding:
    """Return why a candidate that gains more than chance was not added."""
    if c.assessment is None:  # it was not compared on held-out segments
        return finding(Reason.NOT_COMPARED)
    if (objection := c.assessment.objection) is not None:
        return objection
    behind = c.assessment.deficit[0]
    return finding(Reason.LESS_LIKELY, behind=behind) if behind > 0 else finding(Reason.REJECTED)


def _undetected(c: EffectFit, null: Null, base: float) -> Undetected:
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
