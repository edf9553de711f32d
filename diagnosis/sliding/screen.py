"""Effects beside a servo that slides: each fitted from start values of its own, and those that
explain much found one after the other, before anything is simulated.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.diagnosis.free_parameter import Free, free_parameters
from bristle.diagnosis.sliding.fit import (
    ITERATIONS,
    SCREENING_ITERATIONS,
    SlidingFit,
    at_guess,
    fit_beside,
)
from bristle.diagnosis.sliding.torque import driving_input, sliding_torque
from bristle.plant.effect import Evidence
from bristle.plant.effects import effect as find_effect

# of the mean torque of the input: stands for the dry friction of a model without any
NO_FRICTION_SHARE = 0.1
# torques that position or nothing gives, and that can be most of the input
POSITION_TORQUES = ("bias", "gravity", "return_spring")
GROSS_GAIN = 15.0  # nats: least gain of an effect without which a model is far off

Start = Mapping[str, float]  # start values of an effect's free parameters, by their short names
Limits = Mapping[str, tuple[float, float]]


def dry_friction(free: tuple[Free, ...], values: Mapping[str, float], u: Array) -> float:
    """Return a model's dry friction [N.m], or `NO_FRICTION_SHARE` of the mean torque."""
    friction = next((values[f.name] for f in free if f.name.endswith(".Fc")), 0.0)
    return friction or NO_FRICTION_SHARE * float(np.mean(np.abs(values["b"] * u)))


def sliding_evidence(fit: SlidingFit, turn: float) -> Evidence:
    """Return what effects derive start values from, by what a model leaves of the sliding motion;
    `turn` as of `Evidence`.
    """
    s, values = fit.model.over, fit.values
    u = driving_input(fit.model.effects, values, s)
    return Evidence(
        s.theta,
        s.v * s.slides,
        s.a,
        u,
        s.time,
        s.h,
        fit.model.resolution,
        values["J"],
        dry_friction(fit.model.free, values, u),
        values["b"],
        fit.regress,
        turn,
    )


def best_start(fit: SlidingFit, name: str, starts: Sequence[Start]) -> tuple[float, Start] | None:
    """Return the gain [nats] that the torque of an effect at a start value predicts, at any size,
    and that start value: of all, the one with the largest gain beyond the price of its parameters;
    None if the sliding motion does not show the effect.

    Source: rao1948 (score test).
    """
    model, effect = fit.model, find_effect(name)
    defaults = {p.name: p.default for p in effect.parameters} | effect.inactive_values
    before, _ = model.torque(fit.values)
    gains = []
    for start in starts:
        values = fit.values | defaults | {f"{name}.{k}": v for k, v in start.items()}
        try:
            effects = (*model.effects, name)
            torque, _ = sliding_torque(model.law, effects, (), values, model.over)
        except BristleError:
            return None
        gains.append((fit.regress((torque - before)[:, None])[1], start))
    return max(gains, key=lambda each: each[0] - fit.price * len(each[1]), default=None)


def likeliest_beside(
    fit: SlidingFit,
    name: str,
    starts: Sequence[Start],
    limits: Limits,
    iterations: int = SCREENING_ITERATIONS,
) -> tuple[SlidingFit, Start] | None:
    """Return the likeliest fit with an effect more after some steps, and the start value that leads
    there; None if the sliding motion does not show the effect.
    """
    effect = find_effect(name)
    defaults = {p.name: p.default for p in effect.parameters} | effect.inactive_values
    fits = []
    for start in starts:
        free = free_parameters(name, start, limits)
        values = {**defaults, **{f"{name}.{k}": v for k, v in start.items()}}
        try:
            fits.append((fit_beside(fit, name, free, values, iterations), start))
        except BristleError:
            return None
    return max(fits, key=lambda each: each[0].total, default=None)


def each_beside(
    fit: SlidingFit, names: Collection[str], turn: float, limits: Limits
) -> Iterator[tuple[str, SlidingFit, Start]]:
    """Give the likeliest fit with each of the named effects, and the start value that leads there;
    those that the sliding motion does not show are left out.
    """
    evidence = sliding_evidence(fit, turn)
    for name in names:
        derive = find_effect(name).starts
        starts = derive(evidence) if derive else []
        beside = likeliest_beside(fit, name, starts, limits, ITERATIONS)
        if beside is not None:
            yield name, *beside


def with_gross_effects(
    fit: SlidingFit, names: Sequence[str], turn: float, guess: Mapping[str, float] | None = None
) -> SlidingFit:
    """Return a fit with those of the named effects that gain much, the one that gains most first.

    Each is fitted to the end: a slow disturbance that stood in for a large torque gives way to it
    only after many steps, and an inertia that did so from a `guess` of the parameters alone.
    """
    while left := [name for name in names if name not in fit.model.effects]:
        bases = [fit] if guess is None else [fit, at_guess(fit, guess)]
        found = [each for base in bases for _, each, _ in each_beside(base, left, turn, {})]
        best = max(found, key=lambda each: each.worth, default=fit)
        if best.worth < fit.worth + GROSS_GAIN:
            break
        fit = best
    return fit


def with_position_torques(
    fit: SlidingFit, turn: float, linear: bool, guess: Mapping[str, float] | None = None
) -> SlidingFit:
    """Return a fit with the torques of a position that gain much; `guess` as above."""
    names = [e for e in POSITION_TORQUES if not (linear and find_effect(e).once_per_turn)]
    return with_gross_effects(fit, names, turn, guess)
