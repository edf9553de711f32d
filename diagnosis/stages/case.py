"""What the stages after the search work on: the case with its fits, and the time that is left."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from bristle.common.deadline import within
from bristle.diagnosis.answer import Diagnosis
from bristle.diagnosis.checks.preparation import PreparedCase
from bristle.diagnosis.estimation.fitted_model import FittedModel
from bristle.diagnosis.estimation.likelihood import Fit
from bristle.diagnosis.selection.criterion import TrialRound
from bristle.diagnosis.selection.start_values import SearchOptions

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class SearchedCase(PreparedCase):
    """A case after the search: the model with all effects that are named, as the training segments
    gave it and refitted to all segments (`fit`), and the rounds with their fits.
    """

    final: FittedModel
    fit: Fit
    rounds: tuple[TrialRound, ...]


@dataclass(frozen=True)
class Budget:
    """The time that a diagnosis may take, and what its caller set for it."""

    options: SearchOptions
    started: float  # s, of `time.perf_counter`

    def until(self, share: float) -> float:
        """Return when a share of it is used up [s, of `time.perf_counter`]."""
        return self.started + share * self.options.budget

    def within(self, begin: float, result: Callable[[], T]) -> T | None:
        """Return a result, None where a share of the budget is gone before it is begun, or all of
        it before it is there.
        """
        return None if time.perf_counter() > self.until(begin) else within(self.until(1.0), result)


Stage = Callable[[SearchedCase, Diagnosis, Budget], Diagnosis]
