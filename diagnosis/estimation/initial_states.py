"""Initial states of segments: refined with the parameters as they are, and where a load in its play lies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.likelihood import Fit, Problem, _scored, evaluate, rescored

Array = NDArray[np.float64]

REFINEMENT_STEPS = 2  # of them that follow each step of the parameters, where a load is loose
PLAY_SIDES = (-1.0, 0.0, 1.0)  # of the play, where a loose load is looked for


def _stepped_states(problem: Problem, fit: Fit, step: Array) -> Array:
    """Return the start states (segments, width) after a step, no further from what is known of them than four times its doubt."""
    known, doubt = problem.known(fit.simulator, fit.values)
    return np.asarray(np.clip(fit.starts + step, known - 4 * doubt, known + 4 * doubt))


def gain_of_trial(problem: Problem, fit: Fit, trial: Fit) -> float:
    """Return by how much a trial is likelier, each with its start states as they are [nats]."""
    return float((trial.here - fit.here)[problem.judged].sum()) + trial.prior - fit.prior


def initialise_load(problem: Problem, fit: Fit, steps: int = 0) -> Fit:
    """Return a fit whose loose load lies, when a segment starts, where that segment is likeliest: here or at either side.

    Each place is tried in all segments at once, after so many steps of the start states, or by what these promise;
    parameters stay as they are.
    """
    if not fit.simulator.loose:
        return fit
    ends = [refine_initial_states(problem, fit, steps)]
    for side in PLAY_SIDES:
        starts = fit.starts.copy()
        starts[:, 2:] = side, 0.0
        ends.append(refine_initial_states(problem, evaluate(problem, fit.simulator, fit.free, fit.values, starts), steps))
    whole = problem.only(np.ones_like(problem.judged))
    worth = [end.here if steps else rescored(whole, end).score for end in ends]
    return merge_fits(problem, ends, np.argmax(worth, axis=0))


def refine_initial_states(problem: Problem, fit: Fit, steps: int) -> Fit:
    """Return a fit after so many steps of the start states of all segments, each taken where it helps."""
    trust = np.ones(len(fit.starts))
    for _ in range(steps):
        around = _stepped_states(problem, fit, trust[:, None] * fit.begin.moves(fit.begin.pull))
        trial = evaluate(problem, fit.simulator, fit.free, fit.values, around)
        better = trial.here > fit.here
        trust = np.where(better, np.minimum(2 * trust, 1.0), 0.25 * trust)
        fit = merge_fits(problem, [fit, trial], better.astype(int))
    return fit


def merge_fits(problem: Problem, fits: Sequence[Fit], which: NDArray[np.int_]) -> Fit:
    """Return the fit that each segment has in one of several with the same parameters."""

    def picked(of: Callable[[Fit], NDArray[Any]]) -> NDArray[Any]:
        return np.stack([of(fit) for fit in fits])[which, np.arange(len(which))]

    first = fits[0]
    return _scored(
        problem, first.simulator, first.free, first.values, picked(lambda f: f.starts), picked(lambda f: f.residual),
        picked(lambda f: f.by_parameter), picked(lambda f: f.begin.by_start), picked(lambda f: f.raw_by_start),
        picked(lambda f: f.good),
    )  # fmt: skip
