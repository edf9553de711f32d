"""Refit of a servo by simulation: parameters and the initial states of all segments, robust against single segments."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.initial_states import (
    REFINEMENT_STEPS,
    _stepped_states,
    gain_of_trial,
    initialise_load,
    merge_fits,
    refine_initial_states,
)
from bristle.diagnosis.estimation.likelihood import Fit, Problem, _place, evaluate, moved, rescored
from bristle.diagnosis.estimation.simulator import Free, Simulator, has_free_play
from bristle.plant.effects import effect as find_effect

Array = NDArray[np.float64]

STOP_GAIN = 0.05  # nats: a fit ends when the next step promises less
ROUGH_STOP_GAIN = 0.5  # the same where candidates are compared only
FIT_ITERATIONS = 15
INITIAL_STATE_STEPS = 5  # steps of start states alone
KEPT_SHARE = 0.5  # of what a step promised: less calls for these
FAILED_STEPS = 3  # steps in a row that gain nothing
LARGE_PREDICTED_GAIN = (
    10.0  # nats: a step that promises this is shortened until it keeps some of it (a loose load's promises are never kept)
)
FIT_DAMPING = 1e-3


def _direction(fit: Fit, damping: float) -> tuple[Array, Array, float]:
    """Return the step of the parameters, of the start states, and the gain it promises."""
    gradient = fit.weight @ fit.slopes
    for i, f in enumerate(fit.free):
        if f.nominal is not None:
            gradient[i] += (f.nominal - _place(f, fit.values[f.name])) / f.doubt**2
    active = np.ones(len(fit.free), dtype=bool)
    step = np.zeros(len(fit.free))
    for _ in range(len(fit.free) + 1):  # what would leave its interval stays
        h = fit.information[np.ix_(active, active)]
        h = h + np.diag(damping * np.diag(h) + 1e-12 * (1 + np.diag(h).max(initial=0.0)))
        step = np.zeros(len(fit.free))
        step[active] = np.linalg.solve(h, gradient[active])
        leaving = [
            i for i, f in enumerate(fit.free)
            if active[i] and ((fit.values[f.name] <= f.low and step[i] < 0) or (fit.values[f.name] >= f.high and step[i] > 0))
        ]  # fmt: skip
        if not leaving:
            break
        active[leaving] = False
    predicted_gain = float(gradient @ step - 0.5 * step @ fit.information @ step)
    back = fit.begin.moves(fit.begin.pull - fit.begin.cross(fit.by_parameter) @ step)
    return step, back, predicted_gain


def predicted_gain(fit: Fit) -> float:
    """Return the gain that a step from here promises [nats]."""
    return _direction(fit, FIT_DAMPING)[2]


def refit(
    problem: Problem,
    simulator: Simulator,
    free: tuple[Free, ...],
    values: Mapping[str, float],
    starts: Array,
    iterations: int = FIT_ITERATIONS,
    first: Fit | None = None,
    enough: float = STOP_GAIN,
) -> Fit:
    """Maximise the likelihood of the judged segments from the given values and start states.

    Levenberg-Marquardt with the exact derivatives of the simulated steps; each segment has a t distribution, so that a
    few segments that the model cannot follow do not decide. A segment that gets worse moves its start state less next time:
    where a servo sticks and slips, a start state cannot be improved by its derivatives alone.

    Source: lange1989 (robust regression by the t distribution), golub2003 (elimination of start states).
    """
    begin = {**values, **{f.name: f.inside(values[f.name]) for f in free}}
    fit, damping = first or evaluate(problem, simulator, free, begin, starts), FIT_DAMPING
    trust, failed = np.ones(len(starts)), 0
    for _ in range(iterations):
        step, back, predicted_gain = _direction(fit, damping)
        around = _stepped_states(problem, fit, trust[:, None] * back)
        values = moved(free, fit.values, step)
        trial = evaluate(problem, simulator, free, values, around)
        if simulator.loose and gain_of_trial(problem, fit, trial) < max(KEPT_SHARE * predicted_gain, enough):
            still = evaluate(problem, simulator, free, values, fit.starts)
            trial = refine_initial_states(
                problem, merge_fits(problem, [still, trial], (trial.here > still.here).astype(int)), REFINEMENT_STEPS
            )
        gain = gain_of_trial(problem, fit, trial)
        trust = np.where(trial.here < fit.here, 0.25 * trust, np.minimum(2 * trust, 1.0))
        open_ = fit.total - fit.prior - float(fit.here[problem.judged].sum())  # what the start states promise beside
        failed = 0 if gain >= enough else failed + 1
        if gain > 0:
            fit, damping = trial, damping / 5
        else:
            damping = max(damping, 1e-4) * 8
        if predicted_gain + min(open_, enough) < enough or (
            failed > FAILED_STEPS and (simulator.loose or predicted_gain < LARGE_PREDICTED_GAIN)
        ):
            break
    return fit


def refit_initial_states(problem: Problem, fit: Fit) -> Fit:
    """Return a fit with the start states of the judged segments refitted and all parameters as they are."""
    still = evaluate(problem, fit.simulator, (), fit.values, fit.starts)
    return refit(problem, fit.simulator, (), fit.values, fit.starts, INITIAL_STATE_STEPS, still)


def resume(problem: Problem, fit: Fit, iterations: int = FIT_ITERATIONS, enough: float = STOP_GAIN) -> Fit:
    """Refit from where a fit stands, under whatever noise and judged segments the problem has."""
    return refit(problem, fit.simulator, fit.free, fit.values, fit.starts, iterations, rescored(problem, fit), enough)


NONSMOOTH_TRIALS = 6  # values for each parameter of a rugged effect that are tried around where it stands,
NONSMOOTH_SPREADS = (0.2, 0.2, 0.1, 0.05)  # spread by such factors, round by round,
NONSMOOTH_GAIN = 5.0  # if that gains so many nats
# contacts that were there promised -510 at least, and where there was none 390 less, mostly 1000 to 2000)
LOAD_PASSES = 6  # times at most that a loose load is laid anew and all parameters refitted in turn


def value_under_noise(fit: Fit, quiet: Callable[[Fit], Problem]) -> tuple[float, Fit]:
    """Return the log-likelihood that a step from here promises, and the fit, under the noise that it leaves."""
    problem = quiet(fit)
    fit = rescored(problem, fit)
    return fit.total + predicted_gain(fit), fit


def nonsmooth_parameters(fit: Fit, effects: Collection[str]) -> list[Free]:
    """Return the free parameters of effects that switch, contacts among them."""
    own = [(f, f.name.split(".")[0]) for f in fit.free]
    return [f for f, name in own if name in effects and (find_effect(name).rugged or has_free_play(name))]


def refit_load(fit: Fit, quiet: Callable[[Fit], Problem]) -> Fit:
    """Refit with a loose load laid anew at the start of each segment, as long as that helps; the same fit without such a load.

    Where it lies is another thing for other parameters, and there is no way between either side by derivatives.
    """
    for _ in range(LOAD_PASSES if fit.simulator.loose else 0):
        problem = quiet(fit)
        fit = rescored(problem, fit)
        new = rescored(problem, _refitted(initialise_load(problem, fit, INITIAL_STATE_STEPS), quiet, FIT_ITERATIONS))
        if new.total < fit.total + NONSMOOTH_GAIN:
            break
        fit = new
    return fit


def refit_nonsmooth(fit: Fit, quiet: Callable[[Fit], Problem], effects: Sequence[str]) -> Fit:
    """Refit from the best of values around where a fit stands, as long as that helps, for the effects that need it.

    What switches does so at other times as soon as a parameter moves: the likelihood has many small maxima, at which
    steps along derivatives end.
    """
    fit = refit_load(fit, quiet)
    own = [f for f in nonsmooth_parameters(fit, effects) if not has_free_play(f.name.split(".")[0])]
    if not own:
        return fit
    rng = np.random.default_rng(1)
    for spread in NONSMOOTH_SPREADS:
        problem = quiet(fit)
        fit = best = rescored(problem, fit)
        for step in spread * rng.standard_normal((NONSMOOTH_TRIALS * len(own), len(own))):
            near = {f.name: f.inside(perturbed(f.name, best.values[f.name], d)) for f, d in zip(own, step, strict=True)}
            trial = evaluate(problem, fit.simulator, fit.free, {**best.values, **near}, best.starts)
            best = max((best, trial), key=lambda each: each.total)
        new = max((best, rescored(problem, _refitted(best, quiet, FIT_ITERATIONS))), key=lambda each: each.total)
        if new.total >= fit.total + NONSMOOTH_GAIN:
            fit = new
    return rescored(quiet(fit), fit)


def _refitted(fit: Fit, quiet: Callable[[Fit], Problem], iterations: int) -> Fit:
    done = resume(quiet(fit), fit, iterations, ROUGH_STOP_GAIN)
    return rescored(quiet(done), done)


def perturbed(name: str, value: float, step: float) -> float:
    """Return the value of an effect's parameter some way off: a moment by so many seconds, anything else by a factor."""
    return value + step if _is_time(name) else value * float(np.exp(step))


def _is_time(name: str) -> bool:
    return any(p.name == name and p.unit == "s" and p.minimum < 0 for p in find_effect(name.split(".")[0]).parameters)
