"""The stepwise search: base refit, candidates, the null of the largest gain, ties, addition and removal."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.balance import Balance, Joint
from bristle.diagnosis.candidates import (
    ELASTIC,
    RIGID,
    Candidate,
    Servo,
    Start,
    Test,
    advance,
    evidence,
    explore,
    follow,
    pursue,
    scanned,
    starts,
)
from bristle.diagnosis.fit import ROUGH, Fit, Free, Problem, begun_well, evaluate, refit, rescored, resume
from bristle.diagnosis.lens import Lens, Motion
from bristle.diagnosis.noise import Noise, estimate, response
from bristle.diagnosis.null import Null, largest_gain
from bristle.diagnosis.numerics import finer_gain, steady
from bristle.diagnosis.segments import Segments
from bristle.diagnosis.size import fall, mean_square, squares, typical_fall
from bristle.diagnosis.views import MEASURED, Share, shares
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects
from bristle.plant.friction import law as find_law

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Tell = Callable[[str, float], None]

LONG = 40  # steps of the first fit, which may be far from its end
SETTLE = 2  # times that noise and parameters are estimated in turn
MOST = 4  # effects that are added
HINT = 0.05  # p of a view that calls for another round
HOPE = 0.6  # of the null's level: a candidate that promises less after one step is not followed
MOST_REFITTED = 6  # candidates that are refitted to the end: those that promise most after the first steps
CONTENDER = 0.2  # share of the best gain from which a candidate is refitted under the best one's noise
SIZE = 1.15  # the mean squared error must fall by this factor: what is smaller is of no use to anyone
ODDS = 6.0  # nats between two candidates that keep them apart
PLAIN, PLAIN_LOCAL = 3.0, 1.8  # a further effect lowers the error so, or so if it shows in few segments only,
MORE, ALSO = 1.4, 0.4  # or so and gains this share of the first one,
MUCH, AGAIN = 1.5, 15.0  # or so and gains so many nats on segments kept from the search
BEND = 0.25  # of the sensor's step: bristles that bend less are no effect
FAR = 0.03  # share of the motion's square: beyond it, starts are sought along the measured motion too
STRONGER = (1.0, 1.6)  # what a linear response says of a strength is too little where the model runs away from the records
FEWEST = 10  # segments in motion that tell the noise
RIVAL = 0.6  # share of the best gain that makes a rival: where the best one is too small, or the motion is uniform
DOUBTLESS = 10.0  # times the null's level
MARK = 3.0  # nats: what one segment may say about it
RATIO = 3.3  # nats that a further parameter must gain
WIDE_MARK = 8.0  # the same where it is to prove that the best candidate holds on segments kept from the search:
SHOWN, LOSS = 0.25, 10.0  # it must show this share of what they would gain if they were like the others, less so many nats,
ENOUGH, RATTLE = 16.0, 4.0  # of which so many are enough, or so many where contacts go another way in each run
CEDED = 0.1  # share of the gain that they may lose to an effect that lives elsewhere
HELD = 4  # every fourth segment is kept from the search


@dataclass(frozen=True)
class Bench:
    """Everything that stays the same over a search.

    `barred` says why an effect is no candidate; `turn` is the path after which a motion begins anew: one turn of a shaft.
    """

    segments: Segments
    motion: Motion
    resolution: float
    least: float
    narrow: str = ""  # why the motion is too uniform to tell effects apart by their form
    barred: Mapping[str, str] = field(default_factory=dict)
    linear: bool = False  # the axis does not turn
    turn: float = 2 * math.pi

    @property
    def train(self) -> Mask:
        """Segments that the search may see."""
        return np.asarray(self.segments.judged & (self.segments.block % HELD != HELD - 1))

    @property
    def held(self) -> Mask:
        """Segments kept from the search."""
        return np.asarray(self.segments.judged & (self.segments.block % HELD == HELD - 1))

    def problem(self, noise: Noise, judged: Mask) -> Problem:
        """Return a problem over these segments."""
        return Problem(noise, judged, self.segments.seen, self.segments.starts, self.segments.spread)

    def noise(self, residual: Array, weight: Array, values: Mapping[str, float]) -> Noise:
        """Return the noise of a residual (segments, bins), from the segments in motion.

        At rest friction takes the disturbance and the sensor repeats its last step: that says nothing of their size.
        """
        s = self.segments
        share = self.motion.moving.reshape(len(residual), -1).mean(axis=1)
        in_motion = weight * share
        weight = in_motion if np.count_nonzero(in_motion > 0.5) >= FEWEST else weight
        pulses = response(values["J"], values["a2"], s.h, s.width, s.bins, s.velocity)
        return estimate(residual, weight, pulses, s.h, self.least)

    def left_by(self, fit: Fit) -> Problem:
        """Return the problem of the segments that the search may see, under the noise that a fit leaves."""
        return self.problem(self.noise(fit.residual, fit.weight, fit.values), self.train)

    def missed(self, fit: Fit) -> float:
        """Return the squared error over that of the motion within segments, less a straight line each."""
        s = self.segments
        ramp = np.linalg.qr(np.column_stack([np.ones(s.bins), np.linspace(-1.0, 1.0, s.bins)]))[0]
        moved = (s.seen - (s.seen @ ramp) @ ramp.T)[self.train]
        return mean_square(fit, self.train) / float(np.mean(np.square(moved)))

    def far(self, fit: Fit) -> bool:
        """True if a model misses so much of the motion that steps from where it stands may lead nowhere."""
        return self.missed(fit) > FAR

    def joint(self, stage: Stage) -> Joint:
        """Return where a model and an effect may start together."""
        balance = Balance(self.segments, self.motion, stage.problem.judged, stage.servo.fixed)
        return Joint(balance, stage.servo, stage.fit.values, self.noise, self.resolution, self.turn)


@dataclass(frozen=True)
class Stage:
    """A servo fitted, with the problem it was fitted under."""

    servo: Servo
    problem: Problem
    fit: Fit


@dataclass(frozen=True)
class Verdict:
    """What one round found."""

    candidates: tuple[Candidate, ...]
    null: Null
    base: float
    best: Candidate | None
    gain: float
    size: float
    ties: tuple[str, ...]
    decision: str
    named: bool = False
    finer: float | None = None  # gain with finer steps of the simulation
    kept: float = 0.0  # gain on segments kept from the search
    large: bool = False  # enough to matter
    proven: bool = False  # on segments kept from the search
    withdrawn: bool = False  # named, but something remained on records of a uniform motion


def settle(bench: Bench, servo: Servo, values: Mapping[str, float]) -> Stage:
    """Fit a servo and its noise in turn, from given values."""
    simulator, starts, judged = servo.simulator(bench.segments), bench.segments.starts, bench.train
    seen, _, good = simulator.run(values, starts)
    residual = np.where(good[:, None], bench.segments.seen - seen, 0.0)
    noise = bench.noise(residual, (judged & good).astype(float), values)
    fit = refit(bench.problem(noise, judged), simulator, servo.free, values, starts, LONG, enough=ROUGH)
    for _ in range(SETTLE):
        fit = resume(bench.left_by(fit), fit, enough=ROUGH)
    problem = bench.left_by(fit)
    return Stage(servo, problem, resume(problem, fit))


def settle_well(bench: Bench, servo: Servo, values: Mapping[str, float]) -> Stage:
    """Fit a servo and its noise from given values and, if that ends far off, from what balances the torques."""
    first = settle(bench, servo, values)
    if not bench.far(first.fit):
        return first
    others = [settle(bench, servo, {**values, **found}) for found in bench.joint(first).models]
    return max((first, *others), key=lambda stage: stage.fit.total)


def group(name: str) -> str:
    """Return the class of an effect."""
    return all_effects()[name].group


def lens_of(stage: Stage, bench: Bench) -> Lens:
    """Return the lens of a fitted servo."""
    return Lens(stage.problem, stage.fit, bench.motion.moving, stage.fit.values["J"], stage.fit.values["a2"])


def look(bench: Bench, stage: Stage, names: Sequence[str], tell: Tell) -> Verdict:
    """Try the named effects on top of a fitted servo."""
    fit = stage.fit
    tried, null = _tried(bench, stage, names, tell)
    reached = [c for c in tried if c.fit is not None]
    if not reached:
        return Verdict(tuple(tried), null, fit.total, None, 0.0, 1.0, (), "no effect can join this model")
    best = max(reached, key=lambda c: c.merit)
    beyond = [c for c in reached if c.gain_over(fit) > null.level(c.name)]
    if not beyond or best.merit <= Candidate("", fit).merit:
        return Verdict(tuple(tried), null, fit.total, None, best.gain_over(fit), 1.0, (), "no gain above what chance gives")
    return _judged(bench, stage, tried, beyond, null)


def _tried(bench: Bench, stage: Stage, names: Sequence[str], tell: Tell) -> tuple[list[Candidate], Null]:
    """Return the named effects refitted as far as they are promising, and the null of the largest gain."""
    fit, lens, far = stage.fit, lens_of(stage, bench), bench.far(stage.fit)
    e = evidence(bench.motion, lens, fit, bench.resolution, bench.turn)
    together = _together(bench, stage) if far else lambda name: ()

    def quiet(left: Fit) -> Problem:
        return bench.left_by(left) if far and left.weight.any() else stage.problem

    tried = []
    for i, name in enumerate(names):
        tell(name, i / max(len(names), 1))
        barred = bench.barred.get(name, "")
        tried.append(
            Candidate(name, None, refused=barred) if barred
            else explore(stage.problem, stage.servo, name, fit, lens, e, quiet, together(name))
        )  # fmt: skip
    if not any(c.fit for c in tried):
        return tried, Null(np.zeros(1), {})
    tried = [advance(c, quiet, bench.left_by, fit.total) if c.fit else c for c in tried]
    null = _null(stage.problem, lens, fit, tried)
    hopeful = [c for c in tried if c.fit and c.promised - fit.total > HOPE * null.level(c.name)]
    if not hopeful:
        return tried, null
    chosen = {c.name for c in sorted(hopeful, key=lambda c: -c.promised)[:MOST_REFITTED]}
    tried = [pursue(c, quiet, bench.left_by) if c.name in chosen else c for c in tried]
    return tried, _null(stage.problem, lens, fit, tried)


def _together(bench: Bench, stage: Stage) -> Callable[[str], Sequence[Start]]:
    """Return what gives the starts of an effect together with the model, where the model's own fit is far off.

    They balance the torques along the measured motion or, where the law has a memory, start from the nominal model: one
    that was fitted without what is missing has bent its parameters to make up for it.
    """
    joint = bench.joint(stage)
    if joint.models:
        return joint.starts
    nominal = {f.name: f.usual for f in stage.servo.free if f.nominal is not None}
    values = {**stage.fit.values, **nominal}
    plain = evaluate(stage.problem, stage.fit.simulator, (), values, stage.problem.starts)  # none to make up for it
    e = evidence(bench.motion, lens_of(replace(stage, fit=plain), bench), plain, bench.resolution, bench.turn)

    def begun(name: str) -> list[Start]:
        first = find_effect(name).parameters[0].name.removeprefix(f"{name}.")
        several = [s | {first: factor * s[first]} for s in starts(name, e) for factor in STRONGER if first in s]
        return [({**nominal, **{f"{name}.{k}": v for k, v in s.items()}}, s) for s in several]

    return begun


def _judged(bench: Bench, stage: Stage, tried: Sequence[Candidate], beyond: Sequence[Candidate], null: Null) -> Verdict:
    """Return what the candidates beyond the null are worth beside each other, under the noise that the best one leaves."""
    beyond = _inside(stage, beyond)
    best = max(beyond, key=lambda c: c.merit)
    contenders = [c for c in beyond if c.gain_over(stage.fit) > CONTENDER * best.gain_over(stage.fit)]
    problem, contenders = _under_best_noise(bench, stage, best, contenders)
    contenders = _inside(stage, contenders)
    best = max(contenders, key=lambda c: c.merit)
    plain = _plain(problem, stage, best)
    held = problem.only(bench.held)
    tests = {c.name: _tested(bench, held, plain, c, null.level(c.name)) for c in contenders}
    rivals = [c for c in contenders if tests[c.name].large and c.gain_over(plain) > RIVAL * best.gain_over(plain)]
    leader = max(rivals or contenders, key=lambda c: c.merit)
    sound = [c for c in contenders if tests[c.name].large and tests[c.name].proven]
    leader = max([c for c in sound if leader in sound and _spares(c, leader)] or [leader], key=lambda c: c.merit)
    gain, test = leader.gain_over(plain), tests[leader.name]
    ties = tuple(c.name for c in sound if c.name != leader.name and _alike(leader, c, bool(bench.narrow), gain))
    told = {c.name: replace(c, test=replace(tests[c.name], behind=apart(leader, c))) for c in contenders}
    assert leader.fit is not None
    return Verdict(
        tuple(({c.name: c for c in tried} | told).values()), null, plain.total, leader, gain, test.fall, ties, "",
        kept=test.kept, large=test.large, proven=test.proven, finer=finer_gain(problem, plain, leader.fit),
    )  # fmt: skip


def _plain(problem: Problem, stage: Stage, best: Candidate) -> Fit:
    """Return the servo without anything more, from where it stood and from where the best candidate has led it.

    Where a servo sticks and slips the likelihood has small maxima: what a candidate gains by leaving one is not its own.
    """
    assert best.fit is not None
    old = stage.fit
    values = {name: best.fit.values.get(name, value) for name, value in old.values.items()}
    led = refit(problem, old.simulator, old.free, values, best.fit.starts, enough=ROUGH)
    return max((resume(problem, old, enough=ROUGH), led), key=lambda each: each.total)


def _inside(stage: Stage, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that end within the limits of the records; all of them if none does."""
    return [c for c in candidates if c.inside(stage.servo.limits)] or list(candidates)


def _null(problem: Problem, lens: Lens, fit: Fit, tried: Sequence[Candidate]) -> Null:
    """Return the null of the largest gain; what the best candidate explains does not count as noise."""
    reached = [c for c in tried if c.fit is not None]
    leader = max(reached, key=lambda c: c.merit)
    assert leader.fit is not None
    rest = lens.freed(rescored(problem, leader.fit).white[:, :, None])[:, :, 0]
    return largest_gain({c.name: c.banks for c in reached}, rest, fit.weight)


def _under_best_noise(
    bench: Bench, stage: Stage, leader: Candidate, contenders: list[Candidate]
) -> tuple[Problem, list[Candidate]]:
    """Refit the contenders under the noise that the best of them leaves, until the best one stays the best."""
    problem = stage.problem
    for _ in range(3):
        assert leader.fit is not None
        problem = bench.left_by(leader.fit)
        contenders = [follow(problem, c) for c in contenders]
        best = max(contenders, key=lambda c: c.merit)
        same, leader = best.name == leader.name, best
        if same:
            break
    return problem, contenders


def apart(best: Candidate, other: Candidate) -> tuple[float, float]:
    """Return by how much the best candidate is likelier than another [nats] and the standard error of that.

    Source: vuong1989 (test of non-nested models).
    """
    assert best.fit is not None
    assert other.fit is not None
    difference = (best.fit.score - other.fit.score)[best.fit.weight > 0]
    return best.merit - other.merit, float(np.std(difference) * np.sqrt(len(difference)))


def _tested(bench: Bench, held: Problem, plain: Fit, candidate: Candidate, level: float) -> Test:
    """Return what a candidate is worth: size on the segments of the search, and whether those kept from it agree.

    Where a servo sticks and slips, a few segments may go another way by chance and hide all others in a mean; what is
    beyond doubt is judged by the typical segment then, if the segments kept from the search fall as much.
    """
    assert candidate.fit is not None
    effect = find_effect(candidate.name)
    new, old = (begun_well(held, f) for f in (candidate.fit, plain))
    gains = (new.score - old.score)[held.judged]
    found = max(candidate.gain_over(plain), 0.0)
    before, after = squares(plain, bench.train), squares(candidate.fit, bench.train)
    size = whole = fall(before, after, effect.local)
    if found > DOUBTLESS * level:
        kept_too = typical_fall(squares(old, held.judged), squares(new, held.judged))
        size = max(size, min(typical_fall(before, after), kept_too))
    like = found * len(gains) / max(int(np.count_nonzero(bench.train)), 1)
    least = min(SHOWN * like - LOSS, RATTLE if effect.coupling else ENOUGH)
    proven = bool(_clipped(gains, WIDE_MARK) > (-LOSS - CEDED * found if effect.local else least))
    return Test(whole, _clipped(gains, MARK), size >= SIZE, proven)


def _clipped(gains: Array, most: float) -> float:
    return float(np.clip(gains, -most, most).sum())


def _spares(plain: Candidate, rich: Candidate) -> bool:
    """True if a candidate does with fewer parameters what another does no better than by chance.

    Source: wilks1938 (likelihood ratio of a model within another, 1 %).
    """
    assert plain.fit is not None
    assert rich.fit is not None
    return plain.size < rich.size and rich.fit.total - plain.fit.total < RATIO * (rich.size - plain.size)


def _alike(best: Candidate, other: Candidate, narrow: bool, gain: float) -> bool:
    """True if the records do not tell two candidates apart; where the motion is uniform, any strong one is a rival."""
    assert best.fit is not None
    assert other.fit is not None
    if narrow and best.fit.total - other.fit.total < (1 - RIVAL) * gain:
        return True
    return apart(best, other)[0] < ODDS and not _spares(best, other)


def extend(stage: Stage, bench: Bench, best: Candidate) -> Stage:
    """Return the servo with an effect added, its noise settled."""
    assert best.fit is not None
    rigid = stage.servo.rigid and best.name not in ELASTIC
    servo = replace(stage.servo, effects=(*stage.servo.effects, best.name), free=best.fit.free, rigid=rigid)
    problem = bench.left_by(best.fit)
    fit = scanned(resume(problem, best.fit, LONG), bench.left_by, servo.effects)
    problem = bench.left_by(fit)
    return Stage(servo, problem, resume(problem, fit))


def pruned(stage: Stage, bench: Bench, base: Stage, gain: float) -> tuple[Stage, list[str]]:
    """Return the servo without the effects that the last one has made needless, and the names of these.

    `gain` is that of the last one [nats], which an effect of little size must not fall far behind.
    """
    added = [name for name in stage.servo.effects if name not in base.servo.effects]
    spared = []
    for name in added[:-1]:
        less = _without(stage, bench, base, name)
        size, loss = fall(squares(less.fit, bench.train), squares(stage.fit, bench.train)), stage.fit.total - less.fit.total
        if size < SIZE or (size < MORE and loss < ALSO * gain):
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
    torque = lens.torque(stage.fit) * (stage.fit.weight > 0)[:, None]
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


def _worth_adding(verdict: Verdict, first: float) -> bool:
    """True if a further effect is more than a mend of the form of what was added; `first` is the gain of the first [nats].

    Another effect lowers much of what is left, on segments kept from the search too; what mends a form does so in places.
    """
    if verdict.size >= PLAIN or (verdict.size >= PLAIN_LOCAL and verdict.best and find_effect(verdict.best.name).local):
        return True
    large = verdict.size >= MORE and verdict.gain >= ALSO * first
    return large or (verdict.size >= MUCH and verdict.kept >= AGAIN)


def search(bench: Bench, base: Stage, tell: Tell) -> tuple[Stage, list[Verdict]]:
    """Add effects one after the other as long as one is found that is certain and large enough."""
    stage, rounds = base, []
    taken = set(base.servo.effects)
    while True:
        classes = {group(name) for name in taken}
        names = [name for name in all_effects() if group(name) not in classes]
        verdict = look(bench, stage, names, tell)
        rounds.append(verdict)
        if verdict.best is None:
            break
        if not (verdict.large and verdict.proven):
            small = "of no help on segments kept from the search" if verdict.large else "certain but small"
            rounds[-1] = replace(verdict, decision=f"'{verdict.best.name}' is {small}", ties=())
            break
        if stage is not base and not _worth_adding(verdict, rounds[0].gain):
            mends = f"'{verdict.best.name}' may only mend the form of what was added"
            rounds[-1] = replace(verdict, decision=mends, ties=())
            break
        if any(group(name) != group(verdict.best.name) for name in verdict.ties):
            rounds[-1] = replace(verdict, decision="several effects explain it alike")
            break
        if verdict.finer is not None and not steady(verdict.gain, verdict.finer):
            why = f"'{verdict.best.name}' is numerical: its gain changes with the step of the simulation"
            rounds[-1] = replace(verdict, decision=why)
            break
        rounds[-1] = replace(verdict, decision=f"'{verdict.best.name}' added", named=True)
        stage = extend(stage, bench, verdict.best)
        taken.add(verdict.best.name)
        stage, spared = pruned(stage, bench, base, verdict.gain)
        if spared:
            text = f"'{verdict.best.name}' added; {', '.join(spared)} dropped: not needed any more"
            rounds[-1] = replace(rounds[-1], decision=text)
        if len(taken) - len(base.servo.effects) >= MOST or bench.narrow:
            break
        if not suspicious(stage, bench, rounds[-1], taken):
            rounds[-1] = replace(rounds[-1], decision=f"{rounds[-1].decision}; no view and no effect shows anything beside")
            break
    return stage, rounds


def base_servo(
    law: str, nominal: Mapping[str, float], bounds: Mapping[str, tuple[float, float]], fixed: Mapping[str, float], step: float
) -> tuple[Servo, dict[str, float]]:
    """Return a servo whose bounded parameters are free, loosely held by their nominal values, and where to start.

    `step` is the sensor's, in position: set-valued friction bends by at most a quarter of it.
    """
    free = []
    for name, (low, high) in bounds.items():
        doubt = max(2.0 * abs(nominal[name]), 0.5 * (high - low), 1e-12)
        free.append(Free(name, low, high, nominal=nominal[name], doubt=doubt))
    rigid = f"{law}.Fc" in nominal and not find_law(law).states
    values = dict(nominal)
    if rigid:
        least = max(nominal[f"{law}.Fc"], 1e-9) / (BEND * step)
        values[f"{RIGID}.stiffness"] = 3 * least
        values[f"{RIGID}.damping"] = damping = (3 * least * nominal["J"]) ** 0.5
        free.append(Free(f"{RIGID}.stiffness", least, 100 * least, True, math.log(3 * least), 1.0))
        free.append(Free(f"{RIGID}.damping", 0.0, 30 * damping, False, damping, 2 * damping))
    return Servo(law, (), tuple(bounds), tuple(free), fixed, rigid), values
