"""An effect added to the model, its shape fitted, and effects removed that are no longer needed."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

from bristle.diagnosis.estimation.fitted_model import (
    NOISE_FIT_ITERATIONS,
    FittedModel,
    refit_with_noise,
)
from bristle.diagnosis.estimation.likelihood import Fit, FitPoint, Problem, evaluate, rescored
from bristle.diagnosis.estimation.optimiser import predicted_gain, refit, refit_nonsmooth, resume
from bristle.diagnosis.estimation.simulator import (
    BRISTLE_EFFECTS,
    OWN_BRISTLES,
)
from bristle.diagnosis.free_parameter import free_parameters
from bristle.diagnosis.selection.candidates import EffectFit
from bristle.diagnosis.selection.criterion import ReferenceModel
from bristle.diagnosis.selection.start_values import SearchContext
from bristle.diagnosis.sliding.torque import is_faint, sliding_torques
from bristle.plant.effects import effect as find_effect


def with_candidate(context: SearchContext, candidate: EffectFit) -> SearchContext:
    """Return the context with an effect added to the model as it was fitted."""
    assert candidate.fit is not None
    servo = context.fitted.servo
    rigid = servo.rigid and candidate.name not in BRISTLE_EFFECTS
    servo = replace(
        servo, effects=(*servo.effects, candidate.name), free=candidate.fit.free, rigid=rigid
    )
    return replace(
        context, fitted=FittedModel(servo, context.own_noise(candidate.fit), candidate.fit)
    )


def add_effect(context: SearchContext, candidate: EffectFit, level: float) -> FittedModel:
    """Return the model with an effect added, refitted with its noise; `level` is the gain that
    chance reaches [nats].
    """
    context = with_candidate(context, candidate)
    fitted = context.fitted
    fit = resume(fitted.problem, fitted.fit, NOISE_FIT_ITERATIONS)
    fit = refit_with_noise(
        context.dataset, refit_nonsmooth(fit, context.own_noise, fitted.servo.effects)
    )
    problem = context.own_noise(fit)
    fitted = FittedModel(fitted.servo, problem, resume(problem, fit))
    return refit_shape(replace(context, fitted=fitted), candidate.name, level)


# -- shape -----------------------------------------------------------------------------------------
def refit_shape(context: SearchContext, name: str, level: float) -> FittedModel:
    """Return the model with the shape of an effect fitted too, if that meets the criterion; chance
    gains `level` [nats].

    A wrong shape masks other effects and, where it changes the moments of contact, everything.
    """
    fitted = context.fitted
    shape = {f"{name}.{short}" for short in find_effect(name).shape_parameters}
    if shape & {f.name for f in fitted.servo.free}:
        return fitted
    best = _best_shape(context, name, level)
    if best is None:
        return fitted
    fit = refit_with_noise(context.dataset, best.fit)
    problem = context.own_noise(fit)
    fit = resume(problem, fit)
    if any(f.at_bound(fit.values[f.name]) for f in best.servo.free if f.name in shape):
        return fitted
    before = rescored(problem, fitted.fit)
    usual = _usual_shape(context, problem, before, fit, name)
    if (
        ReferenceModel.of(context.dataset, problem, usual).assess(fit, level).accepted
        and fit.penalised > usual.penalised
    ):
        return FittedModel(best.servo, problem, fit)
    return fitted if usual is before else FittedModel(fitted.servo, problem, usual)


def _best_shape(context: SearchContext, name: str, level: float) -> FittedModel | None:
    """Return the likeliest model with the shape of an effect fitted from its start values; None if
    no gain is predicted.
    """
    fitted, effect, ends = context.fitted, find_effect(name), []
    for start in effect.shape_starts:
        servo = replace(
            fitted.servo,
            free=(*fitted.servo.free, *free_parameters(name, start, fitted.servo.limits)),
        )
        values = {
            **fitted.fit.values,
            **{f"{name}.{short}": value for short, value in start.items()},
        }
        first = evaluate(
            fitted.problem, FitPoint(fitted.fit.simulator, servo.free, values, fitted.fit.initial)
        )
        # the gain of a coupling's shape shows only after all of its parameters have moved
        if effect.coupling or first.total + predicted_gain(first) > fitted.fit.total + level:
            fit = refit_nonsmooth(
                resume(fitted.problem, first, NOISE_FIT_ITERATIONS),
                context.own_noise,
                servo.effects,
            )
            ends.append(FittedModel(servo, fitted.problem, rescored(fitted.problem, fit)))
    return max(ends, key=lambda end: end.fit.total) if ends else None


def _usual_shape(context: SearchContext, problem: Problem, before: Fit, fit: Fit, name: str) -> Fit:
    """Return the fit with the usual shape, of a coupling also from the parameters beside the other
    shape.

    Another shape must not gain by leaving a small maximum of the likelihood.
    """
    if not find_effect(name).coupling:
        return before
    other = evaluate(
        problem, context.fit.at({**fit.values, **find_effect(name).inactive_values}, fit.initial)
    )
    other = refit_nonsmooth(
        resume(problem, other, NOISE_FIT_ITERATIONS),
        lambda _: problem,
        context.fitted.servo.effects,
    )
    return max(before, other, key=lambda each: each.total)


# -- removal ---------------------------------------------------------------------------------------
def backward_elimination(
    context: SearchContext, base: FittedModel, level: float, certain: Collection[str] = ()
) -> tuple[FittedModel, list[str]]:
    """Return the model without the effects that are faint or do not meet the criterion beside the
    last one, and their names; those that are `certain` need not meet it.

    `level` is the gain that chance reaches [nats].
    """
    fitted, removed = context.fitted, []
    added = [name for name in fitted.servo.effects if name not in base.servo.effects]
    faint = set(faint_effects(context, added[:-1]))
    for name in (each for each in added[:-1] if each in faint or each not in certain):
        less = _without(fitted, base, name)
        if (
            name in faint
            or not ReferenceModel.of(context.dataset, less.problem, less.fit)
            .assess(fitted.fit, level)
            .accepted
        ):
            fitted = less
            removed.append(name)
    return fitted, removed


def faint_effects(context: SearchContext, names: Collection[str]) -> Iterator[str]:
    """Give those of some effects whose torque is small beside others at every sample."""
    servo, over = context.fitted.servo, context.dataset.stretches
    values = {**servo.fixed, **context.fit.values}
    torques = sliding_torques(servo.law, servo.effects, values, over)
    yield from (name for name in names if is_faint(torques, servo.law, name))


def _without(fitted: FittedModel, base: FittedModel, name: str) -> FittedModel:
    """Return a model refitted without one of its effects; without effects of bristles with those of
    the base model.
    """
    effects = tuple(each for each in fitted.servo.effects if each != name)
    rigid = base.servo.rigid and not set(effects) & set(BRISTLE_EFFECTS)
    own = [f for f in base.servo.free if rigid or not f.name.startswith(f"{OWN_BRISTLES}.")]
    more = [
        f
        for f in fitted.servo.free
        if f.name.split(".")[0] in effects and f.name not in {g.name for g in own}
    ]
    servo = replace(fitted.servo, effects=effects, free=(*own, *more), rigid=rigid)
    bristles = {f.name: base.fit.values[f.name] for f in own if rigid and OWN_BRISTLES in f.name}
    values = {**base.fit.values, **fitted.fit.values} | bristles
    start = FitPoint(
        servo.simulator(fitted.fit.simulator.segments), servo.free, values, fitted.fit.initial
    )
    return FittedModel(servo, fitted.problem, refit(fitted.problem, start))
