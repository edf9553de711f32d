"""The stepwise search: candidates, the null of the largest gain, addition and removal."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.bench import LONG, Bench, Stage, lens_of, loosened
from bristle.diagnosis.candidates import (
    ELASTIC,
    HASTY,
    PATIENT,
    RIGID,
    Candidate,
    Effort,
    Start,
    advance,
    contact,
    evidence,
    explore,
    freedom,
    idle,
    pursue,
    scanned,
    starts,
)
from bristle.diagnosis.feed import must_be_held
from bristle.diagnosis.fit import Fit, Problem, evaluate, promise, refit, rescored, resume
from bristle.diagnosis.judge import AGREED, ALONE, CLEAR, DOUBTLESS, SIZE, Verdict, judged
from bristle.diagnosis.lens import Lens
from bristle.diagnosis.null import Null, largest_gain
from bristle.diagnosis.numerics import numerical
from bristle.diagnosis.size import fall, squares
from bristle.diagnosis.views import MEASURED, Share, is_form, periods_of, shares
from bristle.plant.effect import Evidence
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects

Array = NDArray[np.float64]
Tell = Callable[[str, float], None]

MOST = 4  # effects that are added
HINT = 0.05  # p of a view that calls for another round
HOPE = 0.6  # of the null's level: a candidate that promises less after one step is not followed
MOST_REFITTED = 6  # candidates that are refitted to the end: those that promise most after the first steps,
FOLLOWED = 0.1  # and this share of what the best one promises
PLAIN = 1.6  # a further effect lowers the error so, and shows anything on segments kept from the search or is local (of effects
# that were not there, gained `CLEAR` times the level and were no wave's form, one lowered it by 1.9, the others by less than 1.5),
MORE, ALSO = 1.4, 0.4  # or so and gains this share of what the first one gained, and anything on segments kept from the search,
SURE, ASIDE = 5.0, 0.25  # or gains so many times the level and this share, and `AGREED` on segments kept from the search,
FORMED = 40.0  # nats, at least, that another form gains: where a contact is all there is, numbers alone bring 28, and 48 on another
BENT = 0.1  # processor, with a form bent 0.06 of the way to the nearest start; so much of this way a contact's form must go
MUCH, AGAIN = 1.5, 15.0  # or so, or gains this share, and gains so many nats on segments kept from the search
ALIKE = "several effects explain it alike"
STRONGER = (1.0, 1.6)  # what a linear response says of a strength is too little where the model runs away from the records


def group(name: str) -> str:
    """Return the class of an effect."""
    return all_effects()[name].group


def look(bench: Bench, stage: Stage, names: Sequence[str], tell: Tell, effort: Effort = HASTY) -> Verdict:
    """Try the named effects on top of a fitted servo."""
    fit = stage.fit
    tried, null = _tried(bench, stage, names, tell, effort)
    reached = [c for c in tried if c.fit is not None and not stage.servo.outdone(c.name, c.fit.values)]
    if not reached:
        return Verdict(tuple(tried), null, fit.total, None, 0.0, 1.0, (), "no effect can join this model")
    best = max(reached, key=lambda c: c.merit)
    times = {c.name: 1.0 if c.within(stage.servo.credible) else ALONE for c in reached}
    beyond = [c for c in reached if c.gain_over(fit) > times[c.name] * null.level(c.name)]
    if not beyond or best.merit <= Candidate("", fit).merit:
        return Verdict(tuple(tried), null, fit.total, None, best.gain_over(fit), 1.0, (), "no gain above what chance gives")
    return judged(bench, stage, tried, beyond, null)


def _tried(bench: Bench, stage: Stage, names: Sequence[str], tell: Tell, effort: Effort) -> tuple[list[Candidate], Null]:
    """Return the named effects refitted as far as they are promising, and the null of the largest gain."""
    fit, lens, far = stage.fit, lens_of(stage, bench), bench.far(stage.fit)
    e = evidence(bench.motion, lens, fit, bench.resolution, bench.turn)
    together = _together(bench, stage, e) if far else lambda name: ()

    def quiet(left: Fit) -> Problem:
        return bench.left_by(left) if far and left.weight.any() else stage.problem

    def followed(name: str, effort: Effort) -> Candidate:
        if name in bench.barred:
            return Candidate(name, None, refused=bench.barred[name])
        begun = explore(stage.problem, stage.servo, name, fit, lens, e, quiet, together(name), far, effort)
        return advance(begun, quiet, fit.total, effort) if begun.fit else begun

    tried = []
    for i, name in enumerate(names):
        tell(name, i / max(len(names), 1))
        tried.append(followed(name, effort))
    if not any(c.fit for c in tried):
        return tried, Null(np.zeros(1), {})
    if effort is HASTY and contact(max(tried, key=lambda c: c.promised).name):  # what rattles may be a shaft that hardens
        tried = [followed(c.name, PATIENT) if c.fit and find_effect(c.name).coupling and not contact(c.name) else c for c in tried]
    null = _null(stage.problem, lens, fit, tried)
    hopeful = [c for c in tried if c.fit and c.promised - fit.total > HOPE * null.level(c.name)]
    if not hopeful:
        return tried, null
    hopeful = sorted(hopeful, key=lambda c: -c.promised)[:MOST_REFITTED]
    chosen = {c.name for c in hopeful if c.promised - fit.total > FOLLOWED * (hopeful[0].promised - fit.total)}
    tried = [pursue(c, quiet, bench.left_by) if c.name in chosen else c for c in tried]
    return tried, _null(stage.problem, lens, fit, tried)


def _together(bench: Bench, stage: Stage, e: Evidence) -> Callable[[str], Sequence[Start]]:
    """Return what gives the starts of an effect together with the model, where the model's own fit is far off.

    They balance the torques along the measured motion or, where the law has a memory, start from the nominal model: one
    that was fitted without what is missing has bent its parameters to make up for it. Where it runs away, they start from
    less dry friction too, where `e`, what the fitted model leaves, says.
    """
    joint = bench.joint(stage)
    given = joint.starts if joint.models else _from_nominal(bench, stage)
    less = loosened(stage)
    if not (less and bench.away(stage.fit)):
        return given
    return lambda name: [*given(name), *_jointly(less, name, starts(name, e))]


def _from_nominal(bench: Bench, stage: Stage) -> Callable[[str], Sequence[Start]]:
    """Return what gives the starts of an effect together with the nominal model."""
    nominal = {f.name: f.usual for f in stage.servo.free if f.nominal is not None}
    values = {**stage.fit.values, **nominal}
    plain = evaluate(stage.problem, stage.fit.simulator, (), values, stage.problem.starts)  # none to make up for it
    e = evidence(bench.motion, lens_of(replace(stage, fit=plain), bench), plain, bench.resolution, bench.turn)

    def begun(name: str) -> list[Start]:
        first = find_effect(name).parameters[0].name.removeprefix(f"{name}.")
        several = [s | {first: factor * s[first]} for s in starts(name, e) for factor in STRONGER if first in s]
        return _jointly(nominal, name, several)

    return begun


def _jointly(values: Mapping[str, float], name: str, several: Sequence[Mapping[str, float]]) -> list[Start]:
    """Return starts of an effect, each together with values of the model."""
    return [({**values, **{f"{name}.{k}": v for k, v in s.items()}}, s) for s in several]


def _null(problem: Problem, lens: Lens, fit: Fit, tried: Sequence[Candidate]) -> Null:
    """Return the null of the largest gain; what the best candidate explains does not count as noise."""
    reached = [c for c in tried if c.fit is not None]
    leader = max(reached, key=lambda c: c.merit)
    assert leader.fit is not None
    rest = lens.freed(rescored(problem, leader.fit).white[:, :, None])[:, :, 0]
    return largest_gain({c.name: c.banks for c in reached}, rest, fit.weight)


def joined(stage: Stage, bench: Bench, best: Candidate) -> Stage:
    """Return the servo with an effect added as it was fitted."""
    assert best.fit is not None
    rigid = stage.servo.rigid and best.name not in ELASTIC
    servo = replace(stage.servo, effects=(*stage.servo.effects, best.name), free=best.fit.free, rigid=rigid)
    return Stage(servo, bench.left_by(best.fit), best.fit)


def extend(stage: Stage, bench: Bench, best: Candidate, level: float) -> Stage:
    """Return the servo with an effect added, its noise settled; `level` is the gain that chance gives [nats]."""
    stage = joined(stage, bench, best)
    fit = bench.settled(scanned(resume(stage.problem, stage.fit, LONG), bench.left_by, stage.servo.effects))
    problem = bench.left_by(fit)
    return bent(replace(stage, problem=problem, fit=resume(problem, fit)), bench, best.name, level)


def bent(stage: Stage, bench: Bench, name: str, level: float) -> Stage:
    """Return the servo with the form of an effect fitted too, if that gains far more than chance gives (`level`).

    What is wrong with the form of an effect hides others, and where contacts meet at other moments it hides everything.
    """
    effect, old = find_effect(name), stage.fit
    bending = {f"{name}.{short}" for short in effect.bending}
    if bending & {f.name for f in stage.servo.free}:
        return stage
    ends = []
    for start in effect.form:
        servo = replace(stage.servo, free=(*stage.servo.free, *freedom(name, start, stage.servo.limits)))
        values = {**old.values, **{f"{name}.{short}": value for short, value in start.items()}}
        begun = evaluate(stage.problem, old.simulator, servo.free, values, old.starts)
        # a coupling shows what its form is worth only when all of it has moved
        if effect.coupling or begun.total + promise(begun) > old.total + level:
            fit = scanned(resume(stage.problem, begun, LONG), bench.left_by, servo.effects)
            ends.append(Stage(servo, stage.problem, rescored(stage.problem, fit)))
    if not ends:
        return stage
    best = max(ends, key=lambda end: end.fit.total)
    fit = bench.settled(best.fit)
    problem = bench.left_by(fit)
    fit = resume(problem, fit)
    if any(f.stuck(fit.values[f.name]) for f in best.servo.free if f.name in bending):
        return stage
    usual = stood = rescored(problem, old)
    if effect.coupling:  # what a form gains by leaving a small maximum is not its own
        led = evaluate(problem, old.simulator, old.free, {**fit.values, **idle(name)}, fit.starts)
        led = scanned(resume(problem, led, LONG), lambda _: problem, stage.servo.effects)
        usual = max(stood, led, key=lambda each: each.total)
    if fit.total - usual.total > max(SURE * level, FORMED) and goes_far(name, fit.values):
        return Stage(best.servo, problem, fit)
    return stage if usual is stood else Stage(stage.servo, problem, usual)


def goes_far(name: str, values: Mapping[str, float]) -> bool:
    """False where the form of a contact is hardly another: numbers bend it so, for contacts amplify what they round."""
    effect, plain = find_effect(name), idle(name)
    ways = [(f"{name}.{short}", value) for start in effect.form for short, value in start.items()]
    return not effect.coupling or any(abs(values[k] - plain[k]) >= BENT * abs(value - plain[k]) for k, value in ways)


def pruned(stage: Stage, bench: Bench, base: Stage, gain: float, level: float) -> tuple[Stage, list[str]]:
    """Return the servo without the effects that the last one has made needless, and the names of these.

    `gain` is that of the last one [nats], which an effect of little size must not fall far behind, and `level` what chance
    gives: what is beyond doubt is not small, as in `judge`.
    """
    added = [name for name in stage.servo.effects if name not in base.servo.effects]
    spared = []
    for name in added[:-1]:
        less = _without(stage, bench, base, name)
        size, loss = fall(squares(less.fit, bench.train), squares(stage.fit, bench.train)), stage.fit.total - less.fit.total
        if (size < SIZE and loss < DOUBTLESS * level) or (size < MORE and loss < ALSO * gain):
            stage = less
            spared.append(name)
    return stage, spared


def _without(stage: Stage, bench: Bench, base: Stage, name: str) -> Stage:
    effects = tuple(each for each in stage.servo.effects if each != name)
    rigid = base.servo.rigid and not set(effects) & set(ELASTIC)
    own = [f for f in base.servo.free if rigid or not f.name.startswith(f"{RIGID}.")]
    more = [f for f in stage.servo.free if f.name.split(".")[0] in effects and f.name not in {g.name for g in own}]
    servo = replace(stage.servo, effects=effects, free=(*own, *more), rigid=rigid)
    values = {**base.fit.values, **stage.fit.values} | {f.name: base.fit.values[f.name] for f in own if rigid and RIGID in f.name}
    problem = stage.problem
    return Stage(servo, problem, refit(problem, servo.simulator(bench.segments), servo.free, values, stage.fit.starts))


def views_of(stage: Stage, bench: Bench) -> tuple[list[Share], Array]:
    """Return what each view predicts of a fitted servo's residual, and the torque behind it (samples,) [N.m]."""
    lens = lens_of(stage, bench)
    torque = lens.torque() * (stage.fit.weight > 0)[:, None]
    rough = torque.reshape(len(torque), bench.segments.bins, -1).mean(axis=2)
    factor = 2 * math.pi / bench.turn  # what repeats, repeats along what a motion begins anew after
    around = replace(bench.motion, theta=factor * bench.motion.theta)
    return shares(lens, around, bench.segments.h, factor * bench.resolution, rough), torque.ravel()


def suspicious(stage: Stage, bench: Bench, verdict: Verdict, taken: set[str]) -> bool:
    """True if a view shows something in the residual, or the directions of an effect that was tried before."""
    if any(share.p <= HINT and share.view not in MEASURED for share in views_of(stage, bench)[0]):
        return True
    lens, classes = lens_of(stage, bench), {group(name) for name in taken}
    for c in verdict.candidates:
        for bank in c.banks if group(c.name) not in classes else ():
            score = np.einsum("s,snk,sn->k", lens.weight, bank, lens.rest, optimize=True)
            if 0.5 * float(score @ score) > HOPE * verdict.null.level(c.name):
                return True
    return False


def mends_form(bench: Bench, stage: Stage, best: Candidate) -> bool:
    """True if a candidate repeats as a small multiple of a wave that the servo has, and shows where that does."""
    assert best.fit is not None
    views, periods = set(find_effect(best.name).residual), periods_of(best.name, best.fit.values, bench.turn)
    kin = [name for name in stage.servo.effects if views & set(find_effect(name).residual)]
    waves = [periods_of(name, stage.fit.values, bench.turn) for name in kin]
    return any(is_form(periods, wave) for wave in waves if wave is not None)


def worth_adding(verdict: Verdict, first: float) -> bool:
    """True if a further effect is more than a mend of the form of what was added; `first` is the gain of the first [nats].

    Another effect lowers much of what is left, on segments kept from the search too; what mends a form does so in places.
    """
    assert verdict.best is not None
    level = verdict.null.level(verdict.best.name)
    if verdict.size >= PLAIN and verdict.gain > CLEAR * level and (verdict.kept > 0 or find_effect(verdict.best.name).local):
        return True
    if verdict.gain >= max(SURE * level, ASIDE * first) and verdict.kept >= AGREED:
        return True
    strong, holds = verdict.gain >= ALSO * first, verdict.kept >= AGAIN
    return (strong and (holds or (verdict.size >= MORE and verdict.kept > 0))) or (holds and verdict.size >= MUCH)


def amiss(bench: Bench, stage: Stage) -> bool:
    """True if a servo is far off, and not because a contact rattles: that is worth patience, if the motion tells effects apart."""
    return bench.odd(stage.fit) and not bench.narrow and not any(contact(name) for name in stage.servo.effects)


def considered(
    bench: Bench, stage: Stage, names: Sequence[str], first: float | None, tell: Tell, effort: Effort
) -> tuple[Verdict, str]:
    """Look for a further effect, and return what was found and why it is not added, if it is not.

    `first` is the gain of the first effect [nats], None where this would be the first.
    """
    verdict = look(bench, stage, names, tell, effort)
    best = verdict.best
    if best is None or verdict.decision:
        return verdict, verdict.decision
    if not (verdict.large and verdict.proven):
        verdict = reconsidered(bench, stage, verdict)
        best = verdict.best or best
    if not (verdict.large and verdict.proven):
        return replace(verdict, ties=()), f"'{best.name}' {_short(verdict, best)}"
    if first is not None and (mends_form(bench, stage, best) or not worth_adding(verdict, first)):
        return replace(verdict, ties=()), f"'{best.name}' may only mend the form of what was added"
    if any(group(name) != group(best.name) for name in verdict.ties):
        return verdict, ALIKE
    if verdict.finer is not None and numerical(verdict.gain, verdict.finer, verdict.null.level(best.name)):
        return verdict, f"'{best.name}' is numerical: its gain vanishes with finer steps of the simulation"
    return verdict, ""


def _short(verdict: Verdict, best: Candidate) -> str:
    """Return what an effect lacks that is not large or not proven."""
    if verdict.gain <= verdict.null.level(best.name):
        return "gains no more than chance gives, under the noise that it leaves"
    return "is of no help on segments kept from the search" if verdict.large else "is certain but small"


def reconsidered(bench: Bench, stage: Stage, verdict: Verdict) -> Verdict:
    """Return what is found if the best candidate may take another form than its usual one; the same if that gains too little.

    A form that is not quite right does good here and harm there.
    """
    best = verdict.best
    assert best is not None
    level = verdict.null.level(best.name)
    begun = joined(stage, bench, best)
    end = bent(begun, bench, best.name, level)
    if end is begun:
        return verdict
    tried = [replace(c, fit=end.fit) if c.name == best.name else c for c in verdict.candidates]
    return judged(bench, stage, tried, [c for c in tried if c.test is not None], verdict.null)


def search(bench: Bench, base: Stage, tell: Tell) -> tuple[Stage, list[Verdict]]:
    """Add effects one after the other as long as one is found that is certain and large enough.

    Raises `NotHeldError` where the input that was not held would have to be explained by effects.
    """
    stage = base
    rounds: list[Verdict] = []
    taken = set(base.servo.effects)
    while True:
        must_be_held(bench, stage)
        classes = {group(name) for name in taken}
        names = [name for name in all_effects() if group(name) not in classes]
        first = rounds[0].gain if rounds else None
        verdict, why = considered(bench, stage, names, first, tell, HASTY)
        if why and why != ALIKE and verdict.candidates and amiss(bench, stage):
            verdict, why = considered(bench, stage, names, first, tell, PATIENT)
        best = verdict.best
        if why or best is None:
            rounds.append(replace(verdict, decision=why))
            break
        level = verdict.null.level(best.name)
        stage = extend(stage, bench, best, level)
        taken.add(best.name)
        stage, spared = pruned(stage, bench, base, verdict.gain, level)
        dropped = f"; {', '.join(spared)} dropped: not needed any more" if spared else ""
        rounds.append(replace(verdict, decision=f"'{best.name}' added{dropped}", named=True))
        if len(taken) - len(base.servo.effects) >= MOST or bench.narrow:
            break
        if not suspicious(stage, bench, rounds[-1], taken):
            rounds[-1] = replace(rounds[-1], decision=f"{rounds[-1].decision}; no view and no effect shows anything beside")
            break
    return stage, rounds
