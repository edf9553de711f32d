"""Whether the records agree on the parameters of a model: each with parameters of its own, against all with the same."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from bristle.common.table import Array
from bristle.diagnosis.conclusion import Case, Conclusion
from bristle.diagnosis.estimation.dataset import Mask, Segments
from bristle.diagnosis.estimation.likelihood import Fit
from bristle.diagnosis.estimation.optimiser import resume
from bristle.diagnosis.estimation.simulator import OWN_BRISTLES
from bristle.diagnosis.estimation.uncertainty import covariance
from bristle.diagnosis.report import result as answer
from bristle.diagnosis.report.text import disagreement_line

CHANCE = 1e-3  # probability that records which agree gain more than the level
LEVEL_FACTOR = 4.0  # times the gain that chance gives under the noise model, which is not exact


def agreement(case: Case, found: Conclusion) -> answer.Agreement | None:
    """Return whether the parts of the data are as likely with the parameters of all as with parameters of their own.

    The parts are the records, or the halves of a single one. A wrong model makes up for its error by other values where the motion
    is another, and something that was changed between two records shows in one of them. None where bounds must be widened first.

    Source: wilks1938 (distribution of the likelihood ratio).
    """
    if found.proposal:
        return None
    problem, parts = found.final.problem, dict(_parts(case.dataset.segments))
    if any(not mask.any() for mask in parts.values()):
        return None
    fits = [resume(problem.only(mask), found.fit) for mask in parts.values()]
    gain = sum(float((fit.score - found.fit.score)[mask].sum()) for fit, mask in zip(fits, parts.values(), strict=True))
    freedom = len(found.fit.free) * (len(parts) - 1)
    level = LEVEL_FACTOR * 0.5 * float(chi2.isf(CHANCE, freedom))
    own = {
        f.name: {part: float(fit.values[f.name]) for part, fit in zip(parts, fits, strict=True)}
        for f in found.fit.free
        if not f.name.startswith(f"{OWN_BRISTLES}.")
    }
    units = {name: case.model.unit(name) for name in own}
    return answer.Agreement(max(gain, 0.0), level, own, units, _most_different(fits, list(own)))


def with_agreement(diagnosis: answer.Diagnosis, found: answer.Agreement | None) -> answer.Diagnosis:
    """Return a diagnosis that says where the records do not agree."""
    if found is None or found.holds:
        return replace(diagnosis, agreement=found)
    return replace(diagnosis, agreement=found, statement=(*diagnosis.statement, disagreement_line(found)))


def _parts(segments: Segments) -> Iterator[tuple[str, Mask]]:
    """Give name and counted segments of each record, or of each half of a single one."""
    counts = [len(piece.measured) for piece in segments.pieces]
    ends = np.cumsum(counts)
    names = [piece.name for piece in segments.pieces]
    if len(counts) == 1:
        ends, names = np.array([counts[0] // 2, counts[0]]), list(answer.HALVES)
    places = np.arange(sum(counts))
    for name, begin, end in zip(names, (0, *ends[:-1]), ends, strict=True):
        yield name, segments.counted & (places >= begin) & (places < end)


def _most_different(fits: Sequence[Fit], names: Sequence[str]) -> str:
    """Return the parameter that differs most between fits, beside its standard deviations; an empty text where none is known."""
    free = fits[0].free
    values = np.array([[f.scaled(fit.values[f.name]) for f in free] for fit in fits])
    variances = np.array([np.diag(covariance(fit)) for fit in fits])
    apart = {f.name: _spread(x, v) for f, x, v in zip(free, values.T, variances.T, strict=True) if f.name in names}
    most = max(apart, key=lambda name: apart[name], default="")
    return most if most and apart[most] > 0 else ""


def _spread(values: Array, variances: Array) -> float:
    """Return the weighted sum of squares of values around their mean; 0 where some variance is not known."""
    if not (np.isfinite(variances).all() and (variances > 0).all()):
        return 0.0
    mean = np.average(values, weights=1 / variances)
    return float(np.sum((values - mean) ** 2 / variances))
