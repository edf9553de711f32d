"""Whether the records agree on the parameters of a model: each with parameters of its own, against
all with the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from bristle.common.table import Array
from bristle.diagnosis.answer import HALVES, Diagnosis, RecordAgreement
from bristle.diagnosis.estimation.dataset import (
    Mask,
    Segments,
)
from bristle.diagnosis.estimation.fitted_model import sliding_fit
from bristle.diagnosis.estimation.likelihood import Fit
from bristle.diagnosis.estimation.optimiser import predicted_gain, resume
from bristle.diagnosis.estimation.simulator import OWN_BRISTLES
from bristle.diagnosis.estimation.uncertainty import covariance
from bristle.diagnosis.sliding.fit import LEAST_COUNTED, refit_over
from bristle.diagnosis.sliding.stretches import Stretches
from bristle.diagnosis.stages.case import Budget, SearchedCase

CHANCE = 1e-3  # probability that records which agree gain more than the level
LEVEL_FACTOR = 4.0  # times the gain that chance gives under the noise model, which is not exact


def agreement(case: SearchedCase, answer: Diagnosis, _: Budget) -> Diagnosis:
    """Return an answer that says whether the records agree on the parameters; as it is where bounds
    must be widened first.
    """
    return with_agreement(answer, None if answer.corrections else agreement_of(case))


def with_agreement(answer: Diagnosis, agrees: RecordAgreement | None) -> Diagnosis:
    """Return an answer with whether the records agree; where they do not, without a noise floor:
    what differs between them is in it.
    """
    gap = answer.gap if agrees is None or agrees.holds else replace(answer.gap, noise_floor=None)
    return replace(answer, agreement=agrees, gap=gap)


def agreement_of(case: SearchedCase) -> RecordAgreement | None:
    """Return whether the parts of the data are as likely with the parameters of all as with
    parameters of their own; None where refits end on the way.

    The parts are the records, or the halves of a single one. A wrong model makes up for its error
    by other values where the motion is another, and something that was changed between two records
    shows in one of them.

    Source: wilks1938 (distribution of the likelihood ratio).
    """
    common, parts = case.fit, dict(_parts(case.dataset.segments))
    if any(not mask.any() for mask in parts.values()):
        return None
    # the gain of parameters of its own for each part, and what chance gives
    fits = [resume(case.final.problem.only(mask), common) for mask in parts.values()]
    gain = sum(
        float((fit.score - common.score)[mask].sum())
        for fit, mask in zip(fits, parts.values(), strict=True)
    )
    freedom = len(common.free) * (len(parts) - 1)
    level = LEVEL_FACTOR * 0.5 * float(chi2.isf(CHANCE, freedom))
    if gain <= level < gain + sum(map(predicted_gain, fits)):
        return None  # the refits ended on the way, as those of contacts may
    # the values of each part
    shown = [k for k, f in enumerate(common.free) if not f.name.startswith(f"{OWN_BRISTLES}.")]
    known = np.array([np.diag(fit.information)[shown] > 0 for fit in fits])
    own = _own_values(
        [common.free[k].name for k in shown], dict(zip(parts, fits, strict=True)), known
    )
    units = {name: case.model.unit(name) for name in own}
    differs = _most_different(fits, known, shown)
    agree = gain > level and _slides_agree(case)
    return RecordAgreement(max(gain, 0.0), level, own, units, differs, agree)


def _slides_agree(case: SearchedCase) -> bool:
    """Return whether the parts of the sliding motion are as likely with the parameters of all as
    with their own: where a servo sticks, segments differ by more than their noise model knows.
    """
    whole = sliding_fit(case.dataset, case.final.servo, case.fit.values)
    if whole is None:
        return False
    free, parts = whole.model.free, list(_stretches(whole.model.over))
    if any(len(part.counted) < LEAST_COUNTED for part in parts):
        return False
    gain = sum(
        refit_over(whole, part, free).total - refit_over(whole, part, ()).total for part in parts
    )
    return gain <= 0.5 * float(chi2.isf(CHANCE, len(free) * (len(parts) - 1)))


def _stretches(over: Stretches) -> Iterator[Stretches]:
    """Give the stretches of each record, or of each half of a single one."""
    part = over.record[over.begin]
    if over.record[-1] == 0:
        part = (over.begin > len(over.record) // 2).astype(int)
    for k in range(max(int(over.record[-1]), 1) + 1):
        yield replace(over, begin=over.begin[part == k], end=over.end[part == k])


def _own_values(
    names: Sequence[str], fits: Mapping[str, Fit], known: Mask
) -> dict[str, dict[str, float | None]]:
    """Return each parameter's value in each part of the data; None where nothing is said of it."""
    return {
        name: {
            part: float(fit.values[name]) if seen else None
            for (part, fit), seen in zip(fits.items(), column, strict=True)
        }
        for name, column in zip(names, known.T, strict=True)
    }


def _parts(segments: Segments) -> Iterator[tuple[str, Mask]]:
    """Give name and counted segments of each record, or of each half of a single one."""
    names, places = [piece.name for piece in segments.pieces], segments.places
    if len(places) == 1:
        middle = places[0].stop // 2
        names, places = list(HALVES), [slice(middle), slice(middle, None)]
    for name, place in zip(names, places, strict=True):
        mask = np.zeros_like(segments.counted)
        mask[place] = segments.counted[place]
        yield name, mask


def _most_different(fits: Sequence[Fit], known: Mask, shown: Sequence[int]) -> str:
    """Return the parameter that differs most between fits, beside its standard deviations; an empty
    text where none does.

    `known` (fits, parameters): whether a part of the data says anything of a parameter; `shown`:
    the places of the parameters.
    """
    free = fits[0].free
    variances = np.array([np.diag(covariance(fit))[shown] for fit in fits])
    values = np.array([[free[k].scaled(fit.values[free[k].name]) for k in shown] for fit in fits])
    usable = known & np.isfinite(variances) & (variances > 0)
    apart = [
        _spread(x[use], v[use]) for x, v, use in zip(values.T, variances.T, usable.T, strict=True)
    ]
    most = int(np.argmax(apart)) if apart else 0
    return free[shown[most]].name if apart and apart[most] > 0 else ""


def _spread(values: Array, variances: Array) -> float:
    """Return the weighted sum of squares of values around their mean; 0 of less than two."""
    if len(values) < 2:
        return 0.0
    mean = np.average(values, weights=1 / variances)
    return float(np.sum((values - mean) ** 2 / variances))
