"""Whether a gain is numerical: both models compared again with finer steps of simulation."""

from __future__ import annotations

from bristle.diagnosis.estimation.likelihood import Fit, FitPoint, Problem, evaluate
from bristle.diagnosis.estimation.optimiser import maximise

STEP_SHARE = 0.2  # of a gain: largest change with the step of the simulation
LASTING_SHARE = 0.5  # of a gain: least that is left with finer steps
FINE_REFIT_STEPS = 4  # steps of the refit where finer steps of the simulation move the optimum


def finer_gain(problem: Problem, plain: Fit, best: Fit) -> float:
    """Return by how much `best` is likelier than `plain` at half the step of friction and a tenth
    of the tolerance [nats].

    Both are evaluated at the same parameters, and refitted only if the gain changes by more than
    `STEP_SHARE`.
    """
    known = best.total - plain.total
    fine = [
        evaluate(problem, FitPoint(fit.simulator.finer(), fit.free, fit.values, fit.initial))
        for fit in (plain, best)
    ]
    gain = fine[1].total - fine[0].total
    if steady(known, gain):
        return gain
    fine = [maximise(problem, fit, FINE_REFIT_STEPS) for fit in fine]
    return fine[1].total - fine[0].total


def steady(gain: float, finer: float) -> bool:
    """True if a gain is the same with finer steps."""
    return abs(finer - gain) <= STEP_SHARE * abs(gain)


def numerical(gain: float, finer: float, level: float) -> bool:
    """True if a gain falls with finer steps of the simulation to less than half, or below the
    null's `level` (all in nats).

    Contacts occur at other moments with each step size, which changes a gain but does not take most
    of it away.
    """
    return finer < (1 - STEP_SHARE) * gain and (finer < level or finer < LASTING_SHARE * gain)
