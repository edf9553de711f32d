"""An effect added, its shape fitted, and effects that became needless taken out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import NOISE_FIT_ITERATIONS, FittedModel, refit_with_noise, under_own_noise
from bristle.diagnosis.estimation.likelihood import Point, evaluate, rescored, squares
from bristle.diagnosis.estimation.optimiser import predicted_gain, refit, refit_nonsmooth, resume
from bristle.diagnosis.estimation.simulator import BRISTLE_EFFECTS, OWN_BRISTLES, free_parameters, inactive_values
from bristle.diagnosis.localisation.views import is_form, periods_of
from bristle.diagnosis.selection.candidates import Candidate
from bristle.diagnosis.selection.criterion import DOUBTLESS_LEVELS, LEAST_FALL
from bristle.diagnosis.selection.effect_size import fall
from bristle.plant.effects import effect as find_effect

STRONG_FALL, STRONG_SHARE = (
    1.4,
    0.4,
)  # or so and gains this share of what the first one gained, and anything on segments kept from the search,
SURE_LEVELS = 5.0  # FIXME or gains so many times the level and this share, and `AGREED_NATS` on segments kept from the search,
SHAPE_NATS = (
    40.0  # nats, at least, that another form gains: where a contact is all there is, numbers alone bring 28, and 48 on another
)
SHAPE_WAY = 0.1  # processor, with a form bent 0.06 of the way to the nearest start; so much of this way a contact's form must go


def with_candidate(fitted: FittedModel, dataset: Dataset, best: Candidate) -> FittedModel:
    """Return the servo with an effect added as it was fitted."""
    assert best.fit is not None
    rigid = fitted.servo.rigid and best.name not in BRISTLE_EFFECTS
    servo = replace(fitted.servo, effects=(*fitted.servo.effects, best.name), free=best.fit.free, rigid=rigid)
    return FittedModel(servo, under_own_noise(dataset, best.fit), best.fit)


def add_effect(fitted: FittedModel, dataset: Dataset, best: Candidate, level: float) -> FittedModel:
    """Return the servo with an effect added, its noise settled; `level` is the gain that chance gives [nats]."""
    fitted = with_candidate(fitted, dataset, best)
    fit = refit_with_noise(
        dataset,
        refit_nonsmooth(
            resume(fitted.problem, fitted.fit, NOISE_FIT_ITERATIONS), partial(under_own_noise, dataset), fitted.servo.effects
        ),
    )
    problem = under_own_noise(dataset, fit)
    return refit_shape(replace(fitted, problem=problem, fit=resume(problem, fit)), dataset, best.name, level)


def refit_shape(fitted: FittedModel, dataset: Dataset, name: str, level: float) -> FittedModel:
    """Return the servo with the form of an effect fitted too, if that gains far more than chance gives (`level`).

    What is wrong with the form of an effect hides others, and where contacts meet at other moments it hides everything.
    """
    effect, old = find_effect(name), fitted.fit
    bending = {f"{name}.{short}" for short in effect.shape_parameters}
    if bending & {f.name for f in fitted.servo.free}:
        return fitted
    ends = []
    for start in effect.shape_starts:
        servo = replace(fitted.servo, free=(*fitted.servo.free, *free_parameters(name, start, fitted.servo.limits)))
        values = {**old.values, **{f"{name}.{short}": value for short, value in start.items()}}
        begun = evaluate(fitted.problem, Point(old.simulator, servo.free, values, old.initial))
        # a coupling shows what its form is worth only when all of it has moved
        if effect.coupling or begun.total + predicted_gain(begun) > old.total + level:
            fit = refit_nonsmooth(
                resume(fitted.problem, begun, NOISE_FIT_ITERATIONS), partial(under_own_noise, dataset), servo.effects
            )
            ends.append(FittedModel(servo, fitted.problem, rescored(fitted.problem, fit)))
    if not ends:
        return fitted
    best = max(ends, key=lambda end: end.fit.total)
    fit = refit_with_noise(dataset, best.fit)
    problem = under_own_noise(dataset, fit)
    fit = resume(problem, fit)
    if any(f.at_bound(fit.values[f.name]) for f in best.servo.free if f.name in bending):
        return fitted
    usual = stood = rescored(problem, old)
    if effect.coupling:  # what a form gains by leaving a small maximum is not its own
        led = evaluate(problem, old.at({**fit.values, **inactive_values(name)}, fit.initial))
        led = refit_nonsmooth(resume(problem, led, NOISE_FIT_ITERATIONS), lambda _: problem, fitted.servo.effects)
        usual = max(stood, led, key=lambda each: each.total)
    if fit.total - usual.total > max(SURE_LEVELS * level, SHAPE_NATS) and shape_is_distinct(name, fit.values):
        return FittedModel(best.servo, problem, fit)
    return fitted if usual is stood else FittedModel(fitted.servo, problem, usual)


def shape_is_distinct(name: str, values: Mapping[str, float]) -> bool:
    """False where the form of a contact is hardly another: numbers bend it so, for contacts amplify what they round."""
    effect, plain = find_effect(name), inactive_values(name)
    ways = [(f"{name}.{short}", value) for start in effect.shape_starts for short, value in start.items()]
    return not effect.coupling or any(abs(values[k] - plain[k]) >= SHAPE_WAY * abs(value - plain[k]) for k, value in ways)


def backward_elimination(
    fitted: FittedModel, dataset: Dataset, base: FittedModel, gain: float, level: float
) -> tuple[FittedModel, list[str]]:
    """Return the servo without the effects that the last one has made needless, and the names of these.

    `gain` is that of the last one [nats], which an effect of little size must not fall far behind, and `level` what chance
    gives: what is beyond doubt is not small, as in `judge`.
    """
    added = [name for name in fitted.servo.effects if name not in base.servo.effects]
    spared = []
    for name in added[:-1]:
        less = _without(fitted, dataset, base, name)
        size, loss = fall(squares(less.fit, dataset.train), squares(fitted.fit, dataset.train)), fitted.fit.total - less.fit.total
        if (size < LEAST_FALL and loss < DOUBTLESS_LEVELS * level) or (size < STRONG_FALL and loss < STRONG_SHARE * gain):
            fitted = less
            spared.append(name)
    return fitted, spared


def _without(fitted: FittedModel, dataset: Dataset, base: FittedModel, name: str) -> FittedModel:
    effects = tuple(each for each in fitted.servo.effects if each != name)
    rigid = base.servo.rigid and not set(effects) & set(BRISTLE_EFFECTS)
    own = [f for f in base.servo.free if rigid or not f.name.startswith(f"{OWN_BRISTLES}.")]
    more = [f for f in fitted.servo.free if f.name.split(".")[0] in effects and f.name not in {g.name for g in own}]
    servo = replace(fitted.servo, effects=effects, free=(*own, *more), rigid=rigid)
    values = {**base.fit.values, **fitted.fit.values} | {
        f.name: base.fit.values[f.name] for f in own if rigid and OWN_BRISTLES in f.name
    }
    problem = fitted.problem
    return FittedModel(
        servo, problem, refit(problem, Point(servo.simulator(dataset.segments), servo.free, values, fitted.fit.initial))
    )


def mends_form(dataset: Dataset, fitted: FittedModel, best: Candidate) -> bool:
    """True if a candidate repeats as a small multiple of a wave that the servo has, and shows where that does."""
    assert best.fit is not None
    views, periods = set(find_effect(best.name).residual), periods_of(best.name, best.fit.values, dataset.turn)
    kin = [name for name in fitted.servo.effects if views & set(find_effect(name).residual)]
    waves = [periods_of(name, fitted.fit.values, dataset.turn) for name in kin]
    return any(is_form(periods, wave) for wave in waves if wave is not None)
