"""Start values of the effects, from data and from the balance of torques, and what each promises."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.diagnosis.estimation.dataset import Dataset, Motion
from bristle.diagnosis.estimation.initial_states import REFINEMENT_STEPS, initialise_load, refine_initial_states
from bristle.diagnosis.estimation.inverse_dynamics import (
    BALANCE_SCREENING_ITERATIONS,
    Balance,
    Balanced,
    BalancedModel,
)
from bristle.diagnosis.estimation.likelihood import Fit, Point, Problem, evaluate
from bristle.diagnosis.estimation.optimiser import value_under_noise
from bristle.diagnosis.estimation.simulator import (
    BRISTLE_EFFECTS,
    OWN_BRISTLES,
    Free,
    Servo,
    free_parameters,
    has_free_play,
    inactive_values,
)
from bristle.diagnosis.localisation.residual_response import ResidualResponse, directions
from bristle.diagnosis.selection.candidates import CONTACT_DEFICIT, QUICK, Candidate, Effort
from bristle.plant.effect import Evidence
from bristle.plant.effects import effect as find_effect

Array = NDArray[np.float64]

Start = tuple[Mapping[str, float], Mapping[str, float]]  # all parameters; those of the effect that move, by short names
# (of 396 such starts of 34 records none led to the effect that was named, and 4 beyond chance)
WAVE_STARTS = 8  # finalists among waves of several periods where the model is far off: what one step promises says little there
LOAD_STARTS_TRIED = 5  # starts of a contact whose load is laid at its best places before they are compared


def dry_level(free: tuple[Free, ...], values: Mapping[str, float], u: Array) -> float:
    """Return the dry friction of a model [N.m], or a tenth of the usual torque where it has none."""
    level = next((values[f.name] for f in free if f.name.endswith(".Fc")), 0.0)
    return level or 0.1 * float(np.mean(np.abs(values["b"] * u)))


def evidence(motion: Motion, response: ResidualResponse, fit: Fit, resolution: float, turn: float) -> Evidence:
    """Return what effects derive their starting values from; `turn` is the path after which a motion begins anew."""
    return Evidence(
        motion.theta, motion.v * motion.moving, motion.a, motion.u, motion.time, fit.simulator.segments.h, resolution,
        fit.values["J"], dry_level(fit.free, fit.values, motion.u), fit.values["b"], response.regress, turn,
    )  # fmt: skip


def start_values(name: str, e: Evidence) -> list[dict[str, float]]:
    """Return the starting values of an effect from data."""
    make = find_effect(name).starts
    assert make is not None
    return make(e)


def bristle_starts(servo: Servo, name: str, fit: Fit) -> list[dict[str, float]]:
    """Return the bristles that a servo of rigid friction has, for an effect that takes their place.

    They have bent as far as they may to make up for what is missing: no start from data is as near.
    """
    if name not in BRISTLE_EFFECTS or not servo.rigid:
        return []
    own = [p.name.removeprefix(f"{name}.") for p in find_effect(name).parameters]
    return [{short: fit.values[f"{OWN_BRISTLES}.{short}"] for short in own}]


def evaluate_starts(
    problem: Problem,
    servo: Servo,
    name: str,
    fit: Fit,
    response: ResidualResponse,
    e: Evidence,
    quiet: Callable[[Fit], Problem],
    joint: Sequence[Start] = (),
    far: bool = False,
    effort: Effort = QUICK,
) -> Candidate:
    """Try an effect from all its starts; where it stands then is the most promising one, and `refit_to_end` goes on from there.

    `quiet` gives a problem with the noise that a fit leaves: what is missing looks like noise to a model without it, and
    most of all where it changes slowly. `joint` holds further starts, of the whole model, which is `far` off without the effect.
    """
    try:
        simulator = servo.simulator(fit.simulator.segments, (name,))
    except BristleError as error:
        return Candidate(name, None, refused=str(error))
    defaults = {p.name: p.default for p in find_effect(name).parameters} | inactive_values(name)
    trials, banks, own = [], [], servo.own(name)
    ease = REFINEMENT_STEPS if fit.simulator.play else 0  # what a load did without the effect it does not do with it
    for start in (*start_values(name, e), *bristle_starts(servo, name, fit)):
        free = free_parameters(name, start, servo.limits)
        values = {**defaults, **fit.values, **{f"{name}.{k}": v for k, v in start.items()}}
        values |= {f.name: f.clip(values[f.name]) for f in free}
        first = refine_initial_states(problem, evaluate(problem, Point(simulator, (*own, *free), values, fit.initial)), ease)
        banks.append(_bank(response, fit, first, len(free)))
        trials.append(value_under_noise(first, quiet))
    for together, moving in joint:
        free = free_parameters(name, moving, servo.limits)
        alone = {key: value for key, value in together.items() if key.startswith(f"{name}.")}
        # with the parameters of the balance, and with those of the simulated model: either may be the better neighbourhood
        for others, begin in ((dict(together), problem.initial), (alone, fit.initial)):
            whole = {**defaults, **fit.values, **others}
            inside = {f.name: f.clip(whole[f.name]) for f in (*own, *free)}
            first = evaluate(problem, Point(simulator, (*own, *free), whole | inside, begin))
            trials.append(value_under_noise(refine_initial_states(problem, first, ease), quiet))
    trials.sort(key=lambda trial: -trial[0])
    if (
        has_free_play(name) and trials[0][0] > fit.total - CONTACT_DEFICIT
    ):  # which is near the truth shows only when the load lies where it may
        near = [trial for promised, trial in trials[:LOAD_STARTS_TRIED] if promised > fit.total - CONTACT_DEFICIT]
        trials = sorted((value_under_noise(initialise_load(problem, trial), quiet) for trial in near), key=lambda trial: -trial[0])
    (promised, best), *rest = trials[: max(effort.starts, WAVE_STARTS if far and find_effect(name).periods else 0)]
    return Candidate(name, best, tuple(banks), promised, tuple(fit for _, fit in rest))


def _bank(response: ResidualResponse, fit: Fit, first: Fit, count: int) -> Array:
    """Return the directions in which the residual would change: by the effect's parameters and by its mere presence."""
    present = (first.white - fit.white)[:, :, None]
    columns = np.concatenate([first.by_parameter[:, :, -count:], present], axis=2)
    usable = np.isfinite(columns).all(axis=(1, 2), keepdims=True)
    return directions(response.free_of_model(response.freed(np.where(usable, columns, 0.0))), fit.weight)


def joint_starts(dataset: Dataset, model: BalancedModel, name: str) -> list[Start]:
    """Return the parameters with which an effect explains most in the balance of torques; nothing where that does not show it."""
    law, effects = model.servo.law, (*model.servo.effects, name)
    defaults = {p.name: p.default for p in find_effect(name).parameters} | inactive_values(name)
    found: list[tuple[float, Start]] = []
    try:
        for balance, base in model.fits:
            trials = []
            for start in start_values(name, _balance_evidence(dataset, model, balance, base)):
                free = (*model.free, *free_parameters(name, start, model.servo.limits))
                values = {**defaults, **base.values, **{f"{name}.{k}": v for k, v in start.items()}}
                trials.append((balance.fit(law, effects, free, values, BALANCE_SCREENING_ITERATIONS), free, start))
            trials.sort(key=lambda trial: -trial[0].total)
            for best, free, start in trials[: QUICK.starts]:
                _, best = model.refit_with_noise(balance, effects, free, best)
                found.append((best.total, (best.values, {key: best.values[f"{name}.{key}"] for key in start})))
    except BristleError:
        return []
    return [max(found, key=lambda each: each[0])[1]] if found else []


def _balance_evidence(dataset: Dataset, model: BalancedModel, balance: Balance, found: Balanced) -> Evidence:
    m, values = balance.motion, found.values
    _, own = balance.evaluate(model.servo.law, model.servo.effects, model.free, values)
    return Evidence(
        m.theta, m.v * m.moving, m.a, m.u, m.time, balance.step, dataset.resolution, values["J"],
        dry_level(model.free, values, m.u), values["b"],
        lambda torques: balance.regress(found, own, values["J"], torques), dataset.turn,
    )  # fmt: skip
