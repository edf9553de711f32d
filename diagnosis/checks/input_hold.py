"""Whether the input was held between samples: what is logged more slowly than the drive works shows otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel, refit_with_noise, under_own_noise
from bristle.diagnosis.estimation.likelihood import Fit, Point, evaluate
from bristle.diagnosis.estimation.optimiser import value_under_noise
from bristle.records.input_hold import mixed
from bristle.records.record import Record

SLOW_SAMPLING = 2e-3  # s: drives set their input as often as that, and half a sample less hides below chance
INPUT_CHANGE_GAIN = (
    50.0  # nats that an input which changes between the samples must gain over one that is held (records of 62.5 to 250 Hz from
)
# a drive of 1 kHz: 590 to 930; of 178 held ones at 1 kHz, most with a coupling, the most was 25)
FIRST_INPUT_SHARE = 0.25  # share of the next sample with which that is tried first,
INPUT_SHARES = tuple(
    k / 20 for k in range(1, 11)
)  # and those among which the best lies: half if it changes evenly, less if in steps
INPUT_FINDING = (
    "the input seems to change between the samples: taken as {share:.2g} of the next one and the rest of the last, not as held "
    "({gain:.0f} nats); log it as often as the drive sets it"
)


class NotHeldError(Exception):
    """The input changed between the samples.

    Attributes
    ----------
    share : float
        What is best taken for it in the meantime: this share of the next sample, and the rest of the last.
    gain : float
        By how much that makes the records likelier [nats].
    """

    def __init__(self, share: float, gain: float) -> None:
        super().__init__(share, gain)
        self.share, self.gain = share, gain


def must_be_held(dataset: Dataset, fitted: FittedModel) -> None:
    """Raise `NotHeldError` if the records are far likelier with an input that changes between samples.

    Half a sample of delay that the model does not have would be explained by whatever effect comes near.
    """
    if not dataset.input_may_change:
        return
    held, _ = value_under_noise(fitted.fit, partial(under_own_noise, dataset))
    if _with(dataset, fitted, FIRST_INPUT_SHARE)[0] < held + INPUT_CHANGE_GAIN:
        return
    promised = [_with(dataset, fitted, share)[0] for share in INPUT_SHARES]
    best = int(np.argmax(promised))
    raise NotHeldError(_climbed(dataset, fitted, best), promised[best] - held)


def _with(dataset: Dataset, fitted: FittedModel, share: float) -> tuple[float, Fit]:
    """Return what a servo with another input is `value_under_noise`, and its fit, under the noise that this leaves.

    Under the noise of an input that was held, the best share of records of 100 Hz from a drive of 1 kHz seemed to be 0.38; it
    is 0.45, the mean place of the ten values that the drive held.
    """
    pieces = tuple(replace(piece, u=mixed(piece.u, share)) for piece in dataset.segments.pieces)
    simulator = fitted.servo.simulator(replace(dataset.segments, pieces=pieces))
    fit = evaluate(fitted.problem, Point(simulator, fitted.fit.free, fitted.fit.values, fitted.fit.initial))
    return value_under_noise(fit, partial(under_own_noise, dataset))


def _climbed(dataset: Dataset, fitted: FittedModel, best: int) -> float:
    """Return the share beside that of number `best` from which parameters and noise settle at the likeliest end.

    (At 62.5 Hz a step promised most at 0.4 in two of seven records; 0.45 is 35 and 43 nats likelier in the end.)
    """
    total: dict[int, float] = {}

    def settled(k: int) -> float:
        if k not in total:
            total[k] = refit_with_noise(dataset, _with(dataset, fitted, INPUT_SHARES[k])[1]).total
        return total[k]

    while (near := max((k for k in (best, best + 1, best - 1) if 0 <= k < len(INPUT_SHARES)), key=settled)) != best:
        best = near
    return INPUT_SHARES[best]


def fed(records: Sequence[Record], found: NotHeldError) -> list[Record]:
    """Return the records with the input as it was found to be, and say so in the first."""
    line = INPUT_FINDING.format(share=found.share, gain=found.gain)
    mended = [replace(r, u=mixed(r.u, found.share), ahead=found.share) for r in records]
    return [replace(mended[0], findings=(*mended[0].findings, line)), *mended[1:]]
