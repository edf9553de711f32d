"""Whether the input was held between samples; records that are logged more slowly than the drive
works show otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.answer import Finding, Reason, finding
from bristle.diagnosis.checks.records import LEAST_DURATION, LEAST_SAMPLES
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel, refit_with_noise, under_own_noise
from bristle.diagnosis.estimation.likelihood import Fit, FitPoint, evaluate
from bristle.diagnosis.estimation.optimiser import value_under_noise
from bristle.records.input_hold import aliased, mixed
from bristle.records.record import Record

SLOW_SAMPLING = 2e-3  # s: least sampling period at which the hold is tested
# nats: least gain of an input that changes between samples over one that is held
INPUT_CHANGE_GAIN = 50.0
FIRST_INPUT_SHARE = 0.25  # share of the next sample that is tried first
# shares that are tried then; 0.5: the input changes linearly
INPUT_SHARES = tuple(k / 20 for k in range(1, 11))


@dataclass(frozen=True)
class InputShare:
    """Share of the next sample in the best constant input between two samples, and its gain over a
    held input [nats].
    """

    share: float
    gain: float

    @property
    def note(self) -> Finding:
        """What is said of it."""
        return finding(Reason.INPUT_CHANGES, share=self.share, gain=self.gain)


def estimate_input_share(dataset: Dataset, fitted: FittedModel) -> InputShare | None:
    """Return the mean input between samples if that is far likelier than a held one; None if it is
    not.

    A held input that was not held is half a sample of delay, which any similar effect would
    explain.
    """
    if not dataset.input_may_change:
        return None
    held, _ = value_under_noise(fitted.fit, partial(under_own_noise, dataset))
    if _predicted(dataset, fitted, FIRST_INPUT_SHARE)[0] < held + INPUT_CHANGE_GAIN:
        return None
    predicted = [_predicted(dataset, fitted, share)[0] for share in INPUT_SHARES]
    best = int(np.argmax(predicted))
    return InputShare(_likeliest_share(dataset, fitted, best), predicted[best] - held)


def _predicted(dataset: Dataset, fitted: FittedModel, share: float) -> tuple[float, Fit]:
    """Return the log-likelihood that a step predicts with a mixed input [nats], and the fit, under
    the noise of its residual.
    """
    segments = fitted.fit.simulator.segments
    pieces = tuple(replace(piece, u=mixed(piece.u, share)) for piece in segments.pieces)
    simulator = fitted.servo.simulator(replace(segments, pieces=pieces))
    fit = evaluate(
        fitted.problem, FitPoint(simulator, fitted.fit.free, fitted.fit.values, fitted.fit.initial)
    )
    return value_under_noise(fit, partial(under_own_noise, dataset))


def _likeliest_share(dataset: Dataset, fitted: FittedModel, best: int) -> float:
    """Return the share near that of number `best` whose refit with its noise is likeliest."""
    total: dict[int, float] = {}

    def refitted(k: int) -> float:
        if k not in total:
            total[k] = refit_with_noise(
                dataset, _predicted(dataset, fitted, INPUT_SHARES[k])[1]
            ).total
        return total[k]

    while (
        near := max(
            (k for k in (best, best + 1, best - 1) if 0 <= k < len(INPUT_SHARES)), key=refitted
        )
    ) != best:
        best = near
    return INPUT_SHARES[best]


def with_input_share(
    records: Sequence[Record], input_share: InputShare
) -> tuple[list[Record], tuple[Finding, ...]]:
    """Return the records with the mixed input, and what is said of that.

    Where samples do not show the input, the records without these parts come first, if anything is
    left: the share is to be estimated again then.
    """
    parts = [(r, aliased(r.u)) for r in records]
    pieces = [piece for r, unknown in parts for piece in _shown(r, unknown)]
    notes = tuple(_aliasing(r, unknown, bool(pieces)) for r, unknown in parts if unknown.any())
    if notes and pieces:
        return pieces, notes
    share = input_share.share
    mixes = [replace(r, u=mixed(r.u, share), ahead=share) for r in records]
    return mixes, (*notes, input_share.note)


def _shown(record: Record, unknown: NDArray[np.bool_]) -> list[Record]:
    """Return the parts of a record outside `unknown` samples (n,) that are long enough."""
    if not unknown.any():
        return [record]
    ends = [0, *(np.flatnonzero(np.diff(unknown)) + 1).tolist(), len(unknown)]
    least = max(LEAST_SAMPLES, round(LEAST_DURATION / record.h))
    kept = [slice(a, b) for a, b in pairwise(ends) if not unknown[a] and b - a >= least]
    names = [record.name, *(f"{record.name}, part {k}" for k in range(2, len(kept) + 1))]
    return [replace(record.part(k), name=name) for k, name in zip(kept, names, strict=False)]


def _aliasing(record: Record, unknown: NDArray[np.bool_], left_out: bool) -> Finding:
    """Return what is said of the `unknown` samples (n,) of a record."""
    return finding(
        Reason.ALIASED if left_out else Reason.ALIASED_THROUGHOUT,
        record=record.name,
        begin=float(record.time[int(np.argmax(unknown))]),
        rate=1 / record.h,
    )
