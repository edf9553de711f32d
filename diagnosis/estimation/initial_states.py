"""Initial states of segments, refined with the parameters as they are; and the side of its play on
which a load lies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.estimation.likelihood import (
    Fit,
    Linearised,
    Problem,
    evaluate,
    rescored,
    scored,
)

# steps of the initial states after each step of the parameters, for a load with free play
REFINEMENT_STEPS = 2
PLAY_SIDES = (-1.0, 0.0, 1.0)  # half plays: places at which a load with free play is tried


def stepped_states(problem: Problem, fit: Fit, step: Array) -> Array:
    """Return the initial states (segments, width) after a step, at most four standard deviations
    from their prior means.
    """
    mean, deviation = problem.prior_states(fit.simulator, fit.values)
    return np.asarray(np.clip(fit.initial + step, mean - 4 * deviation, mean + 4 * deviation))


def gain_of_trial(problem: Problem, fit: Fit, trial: Fit) -> float:
    """Return by how much a trial is likelier, each with its initial states as they are [nats]."""
    return (
        float((trial.score_at_initial - fit.score_at_initial)[problem.counted].sum())
        + trial.prior
        - fit.prior
    )


def initialise_load(problem: Problem, fit: Fit, steps: int = 0) -> Fit:
    """Return a fit whose load with free play begins each segment where that segment is likeliest:
    as it is, or at a side.

    Each place is tried in all segments at once, and compared after so many steps of the initial
    states or, with none, by the likelihood that they predict; parameters stay as they are. Without
    such a load it is the same fit.
    """
    if not fit.simulator.play:
        return fit
    ends = [refine_initial_states(problem, fit, steps)]
    for side in PLAY_SIDES:
        initial = fit.initial.copy()
        initial[:, 2:] = side, 0.0
        ends.append(
            refine_initial_states(problem, evaluate(problem, fit.at(initial=initial)), steps)
        )
    whole = problem.only(np.ones_like(problem.counted))
    worth = [end.score_at_initial if steps else rescored(whole, end).score for end in ends]
    return merge_fits(problem, ends, np.argmax(worth, axis=0))


def refine_initial_states(problem: Problem, fit: Fit, steps: int) -> Fit:
    """Return a fit after so many steps of all initial states, each kept where it helps."""
    trust = np.ones(len(fit.initial))
    for _ in range(steps):
        around = stepped_states(
            problem, fit, trust[:, None] * fit.elimination.step(fit.elimination.gradient)
        )
        trial = evaluate(problem, fit.at(initial=around))
        better = trial.score_at_initial > fit.score_at_initial
        trust = np.where(better, np.minimum(2 * trust, 1.0), 0.25 * trust)
        fit = merge_fits(problem, [fit, trial], better.astype(int))
    return fit


def merge_fits(problem: Problem, fits: Sequence[Fit], which: NDArray[np.int_]) -> Fit:
    """Return for each segment the one of several fits with the same parameters that `which`
    (segments,) names.
    """

    def picked(of: Callable[[Fit], NDArray[Any]]) -> NDArray[Any]:
        return np.stack([of(fit) for fit in fits])[which, np.arange(len(which))]

    linearised = Linearised(
        picked(lambda f: f.residual),
        picked(lambda f: f.by_parameter),
        picked(lambda f: f.elimination.by_initial),
        picked(lambda f: f.output_by_initial),
        picked(lambda f: f.good),
    )
    return scored(problem, fits[0].at(initial=picked(lambda f: f.initial)), linearised)
