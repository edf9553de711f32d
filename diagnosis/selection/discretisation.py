"""Whether a gain is one of the effect or one of the numbers: both models once more with finer steps."""

from __future__ import annotations

from bristle.diagnosis.estimation.likelihood import Fit, Point, Problem, evaluate
from bristle.diagnosis.estimation.optimiser import maximise

STEP_SHARE = 0.2  # of a gain: what falls more with the step of the simulation is not named
LASTING_LEVELS, VANISHED_SHARE = 3.0, 0.5  # unless so many times the null's level is left, and this share of the gain
FINE_REFIT_STEPS = 4  # of a refit, where finer steps move the optimum


def finer_gain(problem: Problem, plain: Fit, best: Fit) -> float:
    """Return by how much `best` is likelier than `plain` at half the step of friction and a tenth of the tolerance [nats].

    Both are evaluated where they stand, and refitted only if that moves the gain by more than `STEP_SHARE`.
    """
    known = best.total - plain.total
    fine = [evaluate(problem, Point(fit.simulator.finer(), fit.free, fit.values, fit.initial)) for fit in (plain, best)]
    gain = fine[1].total - fine[0].total
    if steady(known, gain):
        return gain
    fine = [maximise(problem, fit, FINE_REFIT_STEPS) for fit in fine]
    return fine[1].total - fine[0].total


def steady(gain: float, finer: float) -> bool:
    """True if a gain is the same with finer steps."""
    return abs(finer - gain) <= STEP_SHARE * abs(gain)


def numerical(gain: float, finer: float, level: float) -> bool:
    """True if a gain vanishes with finer steps: it falls, to where chance comes near (`level`, all in nats), or by half.

    Contacts go another way with each step size, which changes a gain but does not take most of it away.
    """
    return finer < (1 - STEP_SHARE) * gain and (finer < LASTING_LEVELS * level or finer < VANISHED_SHARE * gain)
