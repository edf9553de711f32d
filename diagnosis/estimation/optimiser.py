"""Refit by simulation: parameters and all initial states, robust against outliers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from bristle.common.table import Array
from bristle.diagnosis.estimation.initial_states import (
    REFINEMENT_STEPS,
    gain_of_trial,
    initialise_load,
    merge_fits,
    refine_initial_states,
    stepped_states,
)
from bristle.diagnosis.estimation.likelihood import (
    Fit,
    FitPoint,
    Problem,
    evaluate,
    moved,
    rescored,
)
from bristle.diagnosis.free_parameter import Free
from bristle.plant.effects import effect as find_effect

# the problem under which a fit is compared, such as that of its own noise
NoiseProblem = Callable[[Fit], Problem]

STOP_GAIN = 0.05  # nats: a fit ends when the next step predicts less
ROUGH_STOP_GAIN = 0.5  # nats: the same for fits that are only compared
FIT_ITERATIONS = 15  # steps of a fit
INITIAL_STATE_STEPS = 5  # steps of the initial states alone
# of the predicted gain: a step that gains less refines the initial states of a load with free play
KEPT_SHARE = 0.5
FAILED_STEPS = 3  # steps in a row that gain nothing, after which a fit ends
# nats: with such a predicted gain a fit does not end after failed steps
LARGE_PREDICTED_GAIN = 10.0
FIT_DAMPING = 1e-3  # Levenberg-Marquardt damping at the start, relative to the curvature
NONSMOOTH_TRIALS = 6  # random values tried for each parameter of a nonsmooth effect in a round
NONSMOOTH_SPREADS = (0.2, 0.2, 0.1, 0.05)  # spread of these values, relative, one a round
TIME_SPREAD = 5.0  # s: spread of the values of a time, over that of other parameters
NONSMOOTH_GAIN = 5.0  # nats: least gain for which a result of these rounds is taken
LOAD_PASSES = 6  # most alternations of the load's initial place and all parameters


def gradient_of(fit: Fit) -> Array:
    """Return the gradient of the log-likelihood, prior knowledge included (free,), on the scale of
    each parameter's steps.
    """
    gradient = np.asarray(fit.weight @ fit.slopes)
    for i, f in enumerate(fit.free):
        if f.nominal is not None:
            gradient[i] += (f.nominal - f.scaled(fit.values[f.name])) / f.prior_sd**2
    return gradient


def damped(information: Array, damping: float) -> Array:
    """Return an information (k, k) with each curvature enlarged by a share, and by enough to be
    inverted where there is none.
    """
    diagonal = np.diag(information)
    return np.asarray(
        information + np.diag(damping * diagonal + 1e-12 * (1 + diagonal.max(initial=0.0)))
    )


def _direction(fit: Fit, damping: float) -> tuple[Array, Array, float]:
    """Return the step of the parameters (free,), of the initial states (segments, width), and the
    predicted gain [nats].
    """
    gradient = gradient_of(fit)
    active = np.ones(len(fit.free), dtype=bool)
    step = np.zeros(len(fit.free))
    for _ in range(len(fit.free) + 1):  # parameters that would leave their interval stay
        h = damped(fit.information[np.ix_(active, active)], damping)
        step = np.zeros(len(fit.free))
        step[active] = np.linalg.solve(h, gradient[active])
        leaving = [
            i for i, f in enumerate(fit.free) if active[i] and f.leaves(fit.values[f.name], step[i])
        ]
        if not leaving:
            break
        active[leaving] = False
    gain = float(gradient @ step - 0.5 * step @ fit.information @ step)
    elimination = fit.elimination
    back = elimination.step(elimination.gradient - elimination.cross(fit.by_parameter) @ step)
    return step, back, gain


def predicted_gain(fit: Fit) -> float:
    """Return the gain that the next step predicts [nats]."""
    return _direction(fit, FIT_DAMPING)[2]


def pressed_bounds(fit: Fit, prefix: str) -> dict[str, float]:
    """Return the parameters of one name's beginning that end at a bound other than 0, each with the
    gain beyond it [nats].

    The gain is that predicted where the bound is taken away and all parameters within their
    intervals follow.
    """
    gradient, inside = (
        gradient_of(fit),
        [i for i, f in enumerate(fit.free) if not f.at_bound(fit.values[f.name])],
    )
    gains = {}
    for i, f in enumerate(fit.free):
        if not (f.name.startswith(prefix) and f.at_binding_bound(fit.values[f.name])):
            continue
        active = [*inside, i]
        curvature = fit.information[np.ix_(active, active)]
        step = np.linalg.lstsq(curvature, gradient[active], rcond=1e-12)[0]
        if f.leaves(fit.values[f.name], float(step[-1])):
            gains[f.name] = 0.5 * float(gradient[active] @ step)
    return gains


def refit(
    problem: Problem,
    start: FitPoint,
    iterations: int = FIT_ITERATIONS,
    stop_gain: float = STOP_GAIN,
) -> Fit:
    """Maximise the likelihood from a start value of parameters and initial states, moved into the
    intervals of the parameters.
    """
    values = {**start.values, **{f.name: f.clip(start.values[f.name]) for f in start.free}}
    return maximise(problem, evaluate(problem, start.at(values)), iterations, stop_gain)


def resume(
    problem: Problem, fit: Fit, iterations: int = FIT_ITERATIONS, stop_gain: float = STOP_GAIN
) -> Fit:
    """Maximise the likelihood from a fit, under the noise and the segments of another problem."""
    return maximise(problem, rescored(problem, fit), iterations, stop_gain)


def maximise(
    problem: Problem, fit: Fit, iterations: int = FIT_ITERATIONS, stop_gain: float = STOP_GAIN
) -> Fit:
    """Maximise the likelihood from a fit under the same problem.

    Levenberg-Marquardt with the exact derivatives of the simulated steps; the misfit of a segment
    has a t distribution, so that outliers do not decide. In a segment that gets worse the next step
    of the initial state is shorter: where a servo sticks and slips, an initial state cannot be
    improved by its derivatives alone.

    Source: lange1989 (robust regression by the t distribution), golub2003 (elimination of the
    initial states).
    """
    damping, trust, failed = FIT_DAMPING, np.ones(len(fit.initial)), 0
    for _ in range(iterations):
        step, back, predicted = _direction(fit, damping)
        around = stepped_states(problem, fit, trust[:, None] * back)
        trial = evaluate(problem, fit.at(moved(fit.free, fit.values, step), around))
        if fit.simulator.play and gain_of_trial(problem, fit, trial) < max(
            KEPT_SHARE * predicted, stop_gain
        ):
            still = evaluate(problem, trial.at(initial=fit.initial))
            better = (trial.score_at_initial > still.score_at_initial).astype(int)
            trial = refine_initial_states(
                problem, merge_fits(problem, [still, trial], better), REFINEMENT_STEPS
            )
        gain = gain_of_trial(problem, fit, trial)
        trust = np.where(
            trial.score_at_initial < fit.score_at_initial, 0.25 * trust, np.minimum(2 * trust, 1.0)
        )
        # predicted of initial states
        by_states = fit.total - fit.prior - float(fit.score_at_initial[problem.counted].sum())
        failed = 0 if gain >= stop_gain else failed + 1
        if gain > 0:
            fit, damping = trial, damping / 5
        else:
            damping = max(damping, 1e-4) * 8
        converged = predicted + min(by_states, stop_gain) < stop_gain
        if converged or (
            failed > FAILED_STEPS and (fit.simulator.play or predicted < LARGE_PREDICTED_GAIN)
        ):
            break
    return fit


def refit_initial_states(problem: Problem, fit: FitPoint) -> Fit:
    """Return a fit with the initial states of the problem's segments refitted, parameters kept."""
    return maximise(problem, evaluate(problem, fit.fixed()), INITIAL_STATE_STEPS)


def value_under_noise(fit: Fit, noise_problem: NoiseProblem) -> tuple[float, Fit]:
    """Return the log-likelihood that the next step predicts [nats] and the fit, under its noise."""
    fit = rescored(noise_problem(fit), fit)
    return fit.total + predicted_gain(fit), fit


def refit_rescored(fit: Fit, noise_problem: NoiseProblem, iterations: int) -> Fit:
    """Refit under the noise of a fit, and return the result under its own."""
    done = resume(noise_problem(fit), fit, iterations, ROUGH_STOP_GAIN)
    return rescored(noise_problem(done), done)


def nonsmooth_parameters(fit: Fit, effects: Collection[str]) -> list[Free]:
    """Return the free parameters of effects that switch, contacts among them."""
    own = [(f, f.name.split(".")[0]) for f in fit.free]
    return [
        f
        for f, name in own
        if name in effects and (find_effect(name).nonsmooth or find_effect(name).free_play)
    ]


def refit_load(fit: Fit, noise_problem: NoiseProblem) -> Fit:
    """Refit with the load's initial place in its play found anew in each segment, as long as that
    helps.

    The likeliest place jumps with the other parameters, so that derivatives do not lead there.
    Without such a load it is the same fit.
    """
    for _ in range(LOAD_PASSES if fit.simulator.play else 0):
        problem = noise_problem(fit)
        fit = rescored(problem, fit)
        placed = initialise_load(problem, fit, INITIAL_STATE_STEPS)
        new = rescored(problem, refit_rescored(placed, noise_problem, FIT_ITERATIONS))
        if new.total < fit.total + NONSMOOTH_GAIN:
            break
        fit = new
    return fit


def refit_nonsmooth(fit: Fit, noise_problem: NoiseProblem, effects: Sequence[str]) -> Fit:
    """Refit from the best of random values around a fit, as long as that helps, for those effects
    that switch.

    The moments at which an effect switches change with each parameter: the likelihood has many
    small maxima, at which steps along derivatives end.
    """
    fit = refit_load(fit, noise_problem)
    own = [
        f
        for f in nonsmooth_parameters(fit, effects)
        if not find_effect(f.name.split(".")[0]).free_play
    ]
    if not own:
        return fit
    rng, wide = (
        np.random.default_rng(1),
        np.array([TIME_SPREAD if is_time(f.name) else 1.0 for f in own]),
    )
    for spread in NONSMOOTH_SPREADS:
        problem = noise_problem(fit)
        fit = best = rescored(problem, fit)
        # the best of random values around the fit so far
        for step in spread * wide * rng.standard_normal((NONSMOOTH_TRIALS * len(own), len(own))):
            trial = evaluate(
                problem, fit.at(perturbed_values(best.values, own, step), best.initial)
            )
            best = max((best, trial), key=lambda each: each.total)
        # from there along derivatives, which counts only if it gains enough
        new = max(
            (best, rescored(problem, refit_rescored(best, noise_problem, FIT_ITERATIONS))),
            key=lambda each: each.total,
        )
        if new.total >= fit.total + NONSMOOTH_GAIN:
            fit = new
    return rescored(noise_problem(fit), fit)


def perturbed_values(
    values: Mapping[str, float], own: Sequence[Free], step: Array
) -> dict[str, float]:
    """Return values with some parameters `perturbed` by a step (own,), within their intervals."""
    near = {
        f.name: f.clip(perturbed(f.name, values[f.name], d)) for f, d in zip(own, step, strict=True)
    }
    return {**values, **near}


def perturbed(name: str, value: float, step: float) -> float:
    """Return the value of an effect's parameter after a step: a time moves by so many seconds,
    anything else by a factor.
    """
    return value + step if is_time(name) else value * float(np.exp(step))


def is_time(name: str) -> bool:
    """True if a parameter of an effect is a moment in time."""
    return any(
        p.name == name and p.unit == "s" and p.minimum < 0
        for p in find_effect(name.split(".")[0]).parameters
    )
