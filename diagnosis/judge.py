"""What candidates beyond the null are worth beside each other: size, proof on segments kept from the search, ties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.bench import EVEN, Bench, Stage
from bristle.diagnosis.candidates import Candidate, Test, follow, scanned
from bristle.diagnosis.fit import ROUGH, Fit, Problem, begun_well, refit, resume
from bristle.diagnosis.null import Null
from bristle.diagnosis.numerics import finer_gain
from bristle.diagnosis.size import acting_fall, fall, squares, typical_fall
from bristle.plant.effects import effect as find_effect

Array = NDArray[np.float64]

CONTENDER = 0.2  # share of the best gain from which a candidate is refitted under the best one's noise
SIZE = 1.2  # the mean squared error must fall by this factor: what is smaller is of no use to anyone
RIVAL = 0.6  # share of the best gain that makes a rival: where the best one is too small, or the motion is uniform
DOUBTLESS, AGREED = 10.0, 6.0  # times the null's level and nats on segments kept from the search, two of them at least:
# a gain beyond doubt, whatever a few segments make of the mean square (of 240 controls none gained 4.4 times the level, and
# none of those beyond 1.8 times any nat on segments kept from the search)
ALONE = 30.0  # times the level: beyond doubt whatever those segments say, where a second effect decides it (of 65 gains as
# large that were refused in the first round of 1540 records, 63 were those of an effect that was there and 2 were in ties; of 14
# that were 20 to 30 times the level, 5 were not)
CLEAR = 3.0  # times the null's level: from there on the segments where a local effect acts say how large it is (controls: 2.2)
CLOSE, CLOSER = 2.0, 1.0  # standard errors that a candidate may be behind to take the place of a best one that does not hold,
# if it gains `CLEAR` times the level, and otherwise, or where it is only plainer (of the single effects of 1540 records four
# wrong ones that took that place were 1.1 to 1.5 behind, and the right ones 0.7 at most)
NEARLY = 0.95  # of the fall that another one brings: no less to anyone who uses it
RATIO = 3.3  # nats that a further parameter must gain
MARK = 3.0  # nats: what one segment may say about it
WIDE_MARK = 8.0  # the same where it is to prove that the best candidate holds on segments kept from the search:
SHOWN, LOSS = 0.25, 10.0  # it must show this share of what they would gain if they were like the others, less so many nats,
ENOUGH, RATTLE = 16.0, 4.0  # of which so many are enough, or so many where contacts go another way in each run
HELP = 1.1  # and their squared error must fall by this factor, unless it only shows in a few, or contacts differ in each run
CEDED = 0.1  # share of the gain that they may lose to an effect that lives elsewhere


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


def judged(bench: Bench, stage: Stage, tried: Sequence[Candidate], beyond: Sequence[Candidate], null: Null) -> Verdict:
    """Return what the candidates beyond the null are worth beside each other, under the noise that the best one leaves."""
    beyond = _inside(stage, beyond)
    best = max(beyond, key=lambda c: c.merit)
    contenders = [c for c in beyond if c.gain_over(stage.fit) > CONTENDER * best.gain_over(stage.fit)]
    contenders = [replace(c, fit=bench.settled(c.fit)) for c in contenders if c.fit]
    best = max(contenders, key=lambda c: c.merit)
    problem, contenders = _under_best_noise(bench, stage, best, contenders)
    contenders = _inside(stage, contenders)
    best = max(contenders, key=lambda c: c.merit)
    plain = _plain(problem, stage, best)
    without = _Without(plain, begun_well(problem.only(bench.held), plain), squares(plain, bench.train))
    tests = {c.name: _tested(bench, problem.only(bench.held), without, c, null.level(c.name)) for c in contenders}
    rivals = [c for c in contenders if tests[c.name].large and c.gain_over(plain) > RIVAL * best.gain_over(plain)]
    leader = max(rivals or contenders, key=lambda c: c.merit)
    sound = [c for c in contenders if tests[c.name].large and tests[c.name].proven]
    if leader in sound:
        others = [c for c in sound if _spares(c, leader, tests)]
    else:
        far = {c.name: CLOSE if c.gain_over(plain) > CLEAR * null.level(c.name) else CLOSER for c in sound}
        others = [c for c in sound if _close(leader, c, far[c.name])]
    leader = max(others or [leader], key=lambda c: c.merit)
    gain, test = leader.gain_over(plain), tests[leader.name]
    ties = tuple(c.name for c in sound if c.name != leader.name and _alike(leader, c, bool(bench.narrow), gain, tests))
    told = {c.name: replace(c, test=replace(tests[c.name], behind=apart(leader, c))) for c in contenders}
    assert leader.fit is not None
    return Verdict(
        tuple(({c.name: c for c in tried} | told).values()), null, plain.total, leader, gain, test.fall, ties, "",
        kept=test.kept, large=test.large, proven=test.proven, finer=finer_gain(problem, plain, leader.fit),
    )  # fmt: skip


def _plain(problem: Problem, stage: Stage, best: Candidate) -> Fit:
    """Return the servo without anything more, from where it stood and from where the best candidate has led it.

    Where a servo sticks and slips the likelihood has small maxima: what a candidate gains by leaving one is not its own. A
    load that can move by itself makes so many that it is laid anew as well.
    """
    assert best.fit is not None
    old = stage.fit
    values = {name: best.fit.values.get(name, value) for name, value in old.values.items()}
    led = refit(problem, old.simulator, old.free, values, best.fit.starts, enough=ROUGH)
    better = max((resume(problem, old, enough=ROUGH), led), key=lambda each: each.total)
    return scanned(better, lambda fit: problem, old.simulator.effects)


def _inside(stage: Stage, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that end within the limits of the records; all of them if none does."""
    return [c for c in candidates if c.inside(stage.servo.limits)] or list(candidates)


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


@dataclass(frozen=True)
class _Without:
    """The model that candidates are compared with: its fit, that on the segments kept from the search, squares of the others."""

    fit: Fit
    held: Fit
    squares: Array


def _tested(bench: Bench, held: Problem, without: _Without, candidate: Candidate, level: float) -> Test:
    """Return what a candidate is worth: size on the segments of the search, and whether those kept from it agree.

    Where a servo sticks and slips, a few segments go another way by chance and hide all others in a mean square; what is
    beyond doubt is not judged by it, if the segments kept from the search agree.
    """
    assert candidate.fit is not None
    effect = find_effect(candidate.name)
    new, old = begun_well(held, candidate.fit), without.held
    gains = (new.score - old.score)[held.judged]
    found = max(candidate.gain_over(without.fit), 0.0)
    before, after = without.squares, squares(candidate.fit, bench.train)
    size = fall(before, after, effect.local)
    if effect.local and found > CLEAR * level:
        size = max(size, acting_fall(before, after))
    kept = squares(old, held.judged), squares(new, held.judged)
    agreed = _clipped(gains, MARK)
    sure = beyond_doubt(found, level, agreed)
    like = found * len(gains) / max(int(np.count_nonzero(bench.train)), 1)
    least = min(SHOWN * like - LOSS, RATTLE if effect.coupling else ENOUGH)
    proven = bool(_clipped(gains, WIDE_MARK) > (-LOSS - CEDED * found if effect.local else least))
    helps = effect.local or bool(effect.coupling) or max(fall(*kept), typical_fall(*kept)) > HELP
    return Test(size, agreed, matters(size, sure, bool(effect.coupling)), sure or (proven and helps))


def matters(size: float, sure: bool, coupling: bool) -> bool:
    """True if the error falls by a factor that is enough, or by whatever where the gain is beyond doubt.

    What a second inertia gains by calling the rest a disturbance is none: it lowers the error, or is not there.
    """
    return size >= SIZE or (sure and (size >= 1 or not coupling))


def beyond_doubt(gain: float, level: float, agreed: float) -> bool:
    """True if a gain is so far above what chance gives (`level`) that it needs no more proof than this (all in nats).

    `agreed` is what segments kept from the search say of it; of the largest gains even that is not asked.
    """
    return gain > ALONE * level or (gain > DOUBTLESS * level and agreed > AGREED)


def _clipped(gains: Array, most: float) -> float:
    return float(np.clip(gains, -most, most).sum())


def _spares(plain: Candidate, rich: Candidate, tests: Mapping[str, Test]) -> bool:
    """True if a candidate does with fewer parameters what another does no better than by chance.

    Or if it leaves hardly a larger error, and the records hardly tell them apart: a step soon after the start is nearly a constant
    torque, and can always be moved to where it gains a few nats more.

    Source: wilks1938 (likelihood ratio of a model within another, 1 %).
    """
    assert plain.fit is not None
    assert rich.fit is not None
    if plain.size >= rich.size:
        return False
    chance = rich.fit.total - plain.fit.total < RATIO * (rich.size - plain.size)
    comparable = not find_effect(plain.name).local  # whose fall may be that of a few segments alone
    return chance or (comparable and tests[plain.name].fall >= NEARLY * tests[rich.name].fall and _close(rich, plain, CLOSER))


def _close(best: Candidate, other: Candidate, errors: float) -> bool:
    """True if another candidate is no more than so many standard errors behind the best one."""
    behind, doubt = apart(best, other)
    return behind < errors * doubt


def _alike(best: Candidate, other: Candidate, narrow: bool, gain: float, tests: Mapping[str, Test]) -> bool:
    """True if the records do not tell two candidates apart; where the motion is uniform, any strong one is a rival."""
    assert best.fit is not None
    assert other.fit is not None
    if narrow and best.fit.total - other.fit.total < (1 - RIVAL) * gain:
        return True
    return apart(best, other)[0] < EVEN and not _spares(best, other, tests)
