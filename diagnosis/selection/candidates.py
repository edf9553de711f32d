"""Every effect as a candidate: refitted by simulation together with the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.initial_states import REFINEMENT_STEPS, initialise_load
from bristle.diagnosis.estimation.likelihood import Fit, Problem, rescored
from bristle.diagnosis.estimation.optimiser import (
    FIT_ITERATIONS,
    ROUGH_STOP_GAIN,
    refit_nonsmooth,
    refit_rescored,
    resume,
    value_under_noise,
)
from bristle.diagnosis.estimation.simulator import has_free_play
from bristle.plant.effects import effect as find_effect

Array = NDArray[np.float64]
CLIMB_REPEATS = 4  # as often at most steps are taken, as long as they gain half of what is lacking to the model without the effect,
# whose other parameters made up for it (a dead zone: 280 nats below after two steps, 590 above in the end)
INERT_GAIN = (
    -20.0,
    2.0,
)  # nats that a start promises over the model without the effect: it does nothing there, and steps found none


CONTACT_DEFICIT = 1000.0  # nats below the model without it: a contact that promises no more at any start is none (of 16 records the


@dataclass(frozen=True)
class Effort:
    """How far candidates are followed.

    `starts` from which steps are taken, `steps` at a time; `all`: starts that promise nothing too.
    """

    starts: int
    steps: int
    all: bool


QUICK = Effort(2, 2, False)
EXHAUSTIVE = Effort(14, 25, True)  # (a compliance: 804 nats below at its start, 6 below after 12 steps, 1479 above after 20)


@dataclass(frozen=True)
class Test:
    """What a candidate is worth.

    `fall`: factor by which the mean squared error falls; `kept`: gain on segments kept from the search [nats]; `large`,
    `proven`: whether each is enough; `behind`: by how much the best one is likelier, and the standard error of that [nats].
    """

    fall: float
    kept: float
    large: bool
    proven: bool
    behind: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Candidate:
    """An effect fitted to the records: the fit of the whole model, and the directions it can explain anything in."""

    name: str
    fit: Fit | None
    banks: tuple[Array, ...] = ()
    promised: float = -np.inf  # log-likelihood that the first step promises
    rivals: tuple[Fit, ...] = ()  # other starts
    refused: str = ""
    test: Test | None = None

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.fit.free) if self.fit else 0

    @property
    def merit(self) -> float:
        """Log-likelihood less the price of the parameters [nats]. Source: schwarz1978."""
        if self.fit is None:
            return -np.inf
        return self.fit.total - 0.5 * self.size * float(np.log(np.count_nonzero(self.fit.weight) + 1.0))

    def gain_over(self, fit: Fit) -> float:
        """Return by how much it is likelier than another fit under the same noise [nats]."""
        return self.fit.total - fit.total if self.fit else -np.inf

    def inside(self, limits: Mapping[str, tuple[float, float]]) -> bool:
        """False where a parameter ends at a limit of the records: what it explains there is something else."""
        assert self.fit is not None
        free = {f.name for f in self.fit.free} & set(limits)
        ends = [(self.fit.values[name], end) for name in free for end in limits[name] if np.isfinite(end)]
        return not any(abs(value - end) <= 1e-6 * (1 + abs(end)) for value, end in ends)

    def within(self, ranges: Mapping[str, tuple[float, float]]) -> bool:
        """True if its own parameters lie in the intervals of those that have one."""
        assert self.fit is not None
        own = {name: ends for name, ends in ranges.items() if name.startswith(f"{self.name}.")}
        return all(low <= self.fit.values[name] <= high for name, (low, high) in own.items())


def _reached(fit: Fit, quiet: Callable[[Fit], Problem]) -> tuple[float, Fit]:
    """Return what steps have led to as `value_under_noise` does; a loose load is laid anew, where a step
    promises what none can keep."""
    if not fit.simulator.play:
        return value_under_noise(fit, quiet)
    fit = initialise_load(quiet(fit), fit, REFINEMENT_STEPS)
    fit = rescored(quiet(fit), fit)
    return fit.total, fit


def advance_candidate(candidate: Candidate, quiet: Callable[[Fit], Problem], least: float, effort: Effort) -> Candidate:
    """Take steps from each of the most promising starts and stand at the better end; one start does where none promises much.

    What does nothing where it starts stays there, unless it switches.
    """
    loose, beyond = has_free_play(candidate.name), candidate.promised - least
    still = INERT_GAIN[0] < beyond < INERT_GAIN[1] and not loose and not find_effect(candidate.name).nonsmooth
    if (still and not effort.all) or (loose and beyond < -CONTACT_DEFICIT):
        return replace(candidate, rivals=())
    assert candidate.fit is not None
    several = candidate.rivals if effort.all or beyond > 0 or candidate.fit.simulator.play else ()
    climbs = 1 if loose else CLIMB_REPEATS
    ends = [_reached(_climbed(t, quiet, least, effort.steps, climbs), quiet) for t in (candidate.fit, *several)]
    promised, fit = max(ends, key=lambda end: end[0])
    return replace(candidate, fit=fit, promised=promised, rivals=())


def refit_to_end(candidate: Candidate, quiet: Callable[[Fit], Problem], left_by: Callable[[Fit], Problem]) -> Candidate:
    """Refit a candidate from where it stands; what switches under the noise that it leaves (`left_by`), which matters then."""
    if candidate.fit is None:
        return candidate
    fit = refit_nonsmooth(refit_rescored(candidate.fit, quiet, FIT_ITERATIONS), left_by, (candidate.name,))
    return replace(candidate, fit=rescored(quiet(fit), fit))


def _climbed(fit: Fit, quiet: Callable[[Fit], Problem], least: float, steps: int, climbs: int) -> Fit:
    """Return where steps lead from a start, so many at a time, as far as they promise to reach `least` [nats]."""
    for _ in range(climbs):
        start, fit = fit.total, refit_rescored(fit, quiet, steps)
        if not 0 < least - fit.total < 2 * (fit.total - start):
            break
    return fit


def refit_candidate(problem: Problem, candidate: Candidate) -> Candidate:
    """Refit a candidate from where it stands, under whatever noise and judged segments the problem has."""
    return candidate if candidate.fit is None else replace(candidate, fit=resume(problem, candidate.fit, stop_gain=ROUGH_STOP_GAIN))
