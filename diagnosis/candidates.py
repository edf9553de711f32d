"""Every effect as a candidate: tried from its starting values, refitted by simulation together with the model."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.fit import (
    EASE,
    ITERATIONS,
    ROUGH,
    STARTS,
    Fit,
    Free,
    Problem,
    eased,
    evaluate,
    laid,
    promise,
    rescored,
    resume,
)
from bristle.diagnosis.lens import Lens, Motion
from bristle.diagnosis.null import directions
from bristle.diagnosis.segments import Segments, Simulator
from bristle.model.errors import BristleError
from bristle.plant.effect import Evidence
from bristle.plant.effects import effect as find_effect

Array = NDArray[np.float64]

Start = tuple[Mapping[str, float], Mapping[str, float]]  # all parameters; those of the effect that move, by short names

FACTOR = 300.0  # a parameter that is never zero may move away from its start by this factor
CLIMBS = 4  # as often at most steps are taken, as long as they gain half of what is lacking to the model without the effect,
# whose other parameters made up for it (a dead zone: 280 nats below after two steps, 590 above in the end)
STILL = (-20.0, 2.0)  # nats that a start promises over the model without the effect: it does nothing there, and steps found none
# (of 396 such starts of 34 records none led to the effect that was named, and 4 beyond chance)
WAVES = 8  # finalists among waves of several periods where the model is far off: what one step promises says little there
LAID = 5  # starts of a contact whose load is laid at its best places before they are compared
TRIES = 6  # values for each parameter of a rugged effect that are tried around where it stands,
SPREADS = (0.2, 0.2, 0.1, 0.05)  # spread by such factors, round by round,
BETTER = 5.0  # if that gains so many nats
NEAR = 1000.0  # nats below the model without it: a contact that promises no more at any start is none (of 16 records the
# contacts that were there promised -510 at least, and where there was none 390 less, mostly 1000 to 2000)
LAYINGS = 6  # times at most that a loose load is laid anew and all parameters refitted in turn
LIMITS = {  # closer than what can be simulated: what a servo may have
    "stribeck.excess": (0.0, 100.0),
    "compliance.share": (0.02, 0.9),
    "backlash.share": (0.02, 0.9),
    "backlash.dissipation": (1e-3, 1e3),
}


@dataclass(frozen=True)
class Effort:
    """How far candidates are followed.

    `starts` from which steps are taken, `steps` at a time; `all`: starts that promise nothing too.
    """

    starts: int
    steps: int
    all: bool


HASTY = Effort(2, 2, False)
PATIENT = Effort(14, 25, True)  # (a compliance: 804 nats below at its start, 6 below after 12 steps, 1479 above after 20)

RIGID = "bristle_damping"  # friction of a real servo bends a little before it slides: part of every model here
ELASTIC = ("presliding", "bristle_damping")  # effects that bend more than the sensor can overlook


@dataclass(frozen=True)
class Servo:
    """The model that candidates join: its law, effects, free parameters and everything that stays.

    `rigid`: the set-valued friction has bristles that bend by less than the sensor's step; no model of rigid friction
    agrees with another more closely than that, and without them each effect would be asked to explain it.
    `limits`: how far parameters of effects may move on this axis, where that is less than anywhere; `credible`: beyond these
    intervals an effect must be beyond doubt.
    """

    law: str
    effects: tuple[str, ...]
    base: tuple[str, ...]
    free: tuple[Free, ...]
    fixed: Mapping[str, float]
    rigid: bool
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    credible: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def simulator(self, segments: Segments, more: tuple[str, ...] = ()) -> Simulator:
        """Return a simulator of the servo with more effects added."""
        effects = (*self.effects, *more)
        bent = self.rigid and not set(effects) & set(ELASTIC)
        return Simulator(self.law, (*effects, RIGID) if bent else effects, segments, self.base, self.fixed)

    def own(self, name: str) -> tuple[Free, ...]:
        """Return the free parameters that stay when an effect joins."""
        return tuple(f for f in self.free if name not in ELASTIC or not f.name.startswith(f"{RIGID}."))

    def outdone(self, name: str, values: Mapping[str, float]) -> bool:
        """True if an effect brings bristles that are as stiff as the servo's own: what bends no more is no effect."""
        if name not in ELASTIC or not self.rigid:
            return False
        return values[f"{name}.stiffness"] >= next(f.usual for f in self.free if f.name == f"{RIGID}.stiffness")


@dataclass(frozen=True)
class Test:
    """What a candidate is worth.

    `fall`: factor by which the mean squared error falls; `kept`: gain on segments kept from the search [nats]; `large`,
    `proven`: whether each is enough; `behind`: by how much the best one is likelier, and the standard error of that [nats].
    """

    fall: float
    kept: float
    large: bool
    proven: bool
    behind: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Candidate:
    """An effect fitted to the records: the fit of the whole model, and the directions it can explain anything in."""

    name: str
    fit: Fit | None
    banks: tuple[Array, ...] = ()
    promised: float = -np.inf  # log-likelihood that the first step promises
    rivals: tuple[Fit, ...] = ()  # other starts
    refused: str = ""
    test: Test | None = None

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.fit.free) if self.fit else 0

    @property
    def merit(self) -> float:
        """Log-likelihood less the price of the parameters [nats]. Source: schwarz1978."""
        if self.fit is None:
            return -np.inf
        return self.fit.total - 0.5 * self.size * float(np.log(np.count_nonzero(self.fit.weight) + 1.0))

    def gain_over(self, fit: Fit) -> float:
        """Return by how much it is likelier than another fit under the same noise [nats]."""
        return self.fit.total - fit.total if self.fit else -np.inf

    def inside(self, limits: Mapping[str, tuple[float, float]]) -> bool:
        """False where a parameter ends at a limit of the records: what it explains there is something else."""
        assert self.fit is not None
        free = {f.name for f in self.fit.free} & set(limits)
        ends = [(self.fit.values[name], end) for name in free for end in limits[name] if np.isfinite(end)]
        return not any(abs(value - end) <= 1e-6 * (1 + abs(end)) for value, end in ends)

    def within(self, ranges: Mapping[str, tuple[float, float]]) -> bool:
        """True if its own parameters lie in the intervals of those that have one."""
        assert self.fit is not None
        own = {name: ends for name, ends in ranges.items() if name.startswith(f"{self.name}.")}
        return all(low <= self.fit.values[name] <= high for name, (low, high) in own.items())


def dry_level(free: tuple[Free, ...], values: Mapping[str, float], u: Array) -> float:
    """Return the dry friction of a model [N.m], or a tenth of the usual torque where it has none."""
    level = next((values[f.name] for f in free if f.name.endswith(".Fc")), 0.0)
    return level or 0.1 * float(np.mean(np.abs(values["b"] * u)))


def evidence(motion: Motion, lens: Lens, fit: Fit, resolution: float, turn: float) -> Evidence:
    """Return what effects derive their starting values from; `turn` is the path after which a motion begins anew."""
    return Evidence(
        motion.theta, motion.v * motion.moving, motion.a, motion.u, motion.time, fit.simulator.segments.h, resolution,
        fit.values["J"], dry_level(fit.free, fit.values, motion.u), fit.values["b"], lens.regress, turn,
    )  # fmt: skip


def freedom(name: str, start: Mapping[str, float], limits: Mapping[str, tuple[float, float]]) -> tuple[Free, ...]:
    """Return the free parameters of an effect: those a start gives, in their intervals and in `limits`."""
    found = []
    for p in find_effect(name).parameters:
        short = p.name.removeprefix(f"{name}.")
        if short not in start:
            continue
        low, high = LIMITS.get(p.name, (p.minimum, p.maximum))
        factor = p.minimum > 0
        if factor:
            low, high = max(low, start[short] / FACTOR), min(high, start[short] * FACTOR)
        low, high = max(low, limits.get(p.name, (low, high))[0]), min(high, limits.get(p.name, (low, high))[1])
        found.append(Free(p.name, low, high, factor))
    return tuple(found)


def contact(name: str) -> bool:
    """True for a coupling with a load that can move by itself: no two runs of it are the same."""
    return bool(find_effect(name).loose)


def starts(name: str, e: Evidence) -> list[dict[str, float]]:
    """Return the starting values of an effect from data."""
    make = find_effect(name).starts
    assert make is not None
    return make(e)


def standing(servo: Servo, name: str, fit: Fit) -> list[dict[str, float]]:
    """Return the bristles that a servo of rigid friction has, for an effect that takes their place.

    They have bent as far as they may to make up for what is missing: no start from data is as near.
    """
    if name not in ELASTIC or not servo.rigid:
        return []
    own = [p.name.removeprefix(f"{name}.") for p in find_effect(name).parameters]
    return [{short: fit.values[f"{RIGID}.{short}"] for short in own}]


def explore(
    problem: Problem,
    servo: Servo,
    name: str,
    fit: Fit,
    lens: Lens,
    e: Evidence,
    quiet: Callable[[Fit], Problem],
    joint: Sequence[Start] = (),
    far: bool = False,
    effort: Effort = HASTY,
) -> Candidate:
    """Try an effect from all its starts; where it stands then is the most promising one, and `pursue` goes on from there.

    `quiet` gives a problem with the noise that a fit leaves: what is missing looks like noise to a model without it, and
    most of all where it changes slowly. `joint` holds further starts, of the whole model, which is `far` off without the effect.
    """
    try:
        simulator = servo.simulator(fit.simulator.segments, (name,))
    except BristleError as error:
        return Candidate(name, None, refused=str(error))
    defaults = {p.name: p.default for p in find_effect(name).parameters} | idle(name)
    trials, banks, own = [], [], servo.own(name)
    ease = EASE if fit.simulator.loose else 0  # what a load did without the effect it does not do with it
    for start in (*starts(name, e), *standing(servo, name, fit)):
        free = freedom(name, start, servo.limits)
        values = {**defaults, **fit.values, **{f"{name}.{k}": v for k, v in start.items()}}
        values |= {f.name: f.inside(values[f.name]) for f in free}
        first = eased(problem, evaluate(problem, simulator, (*own, *free), values, fit.starts), ease)
        banks.append(_bank(lens, fit, first, len(free)))
        trials.append(worth(first, quiet))
    for together, moving in joint:
        free = freedom(name, moving, servo.limits)
        alone = {key: value for key, value in together.items() if key.startswith(f"{name}.")}
        # with the parameters of the balance, and with those of the simulated model: either may be the better neighbourhood
        for others, begin in ((dict(together), problem.starts), (alone, fit.starts)):
            whole = {**defaults, **fit.values, **others}
            inside = {f.name: f.inside(whole[f.name]) for f in (*own, *free)}
            first = evaluate(problem, simulator, (*own, *free), whole | inside, begin)
            trials.append(worth(eased(problem, first, ease), quiet))
    trials.sort(key=lambda trial: -trial[0])
    if contact(name) and trials[0][0] > fit.total - NEAR:  # which is near the truth shows only when the load lies where it may
        near = [trial for promised, trial in trials[:LAID] if promised > fit.total - NEAR]
        trials = sorted((worth(laid(problem, trial), quiet) for trial in near), key=lambda trial: -trial[0])
    (promised, best), *rest = trials[: max(effort.starts, WAVES if far and f"{name}.periods" in defaults else 0)]
    return Candidate(name, best, tuple(banks), promised, tuple(fit for _, fit in rest))


def worth(fit: Fit, quiet: Callable[[Fit], Problem]) -> tuple[float, Fit]:
    """Return the log-likelihood that a step from here promises, and the fit, under the noise that it leaves."""
    problem = quiet(fit)
    fit = rescored(problem, fit)
    return fit.total + promise(fit), fit


def _reached(fit: Fit, quiet: Callable[[Fit], Problem]) -> tuple[float, Fit]:
    """Return what steps have led to as `worth` does; a loose load is laid anew, and a step promises what none can keep there."""
    if not fit.simulator.loose:
        return worth(fit, quiet)
    fit = laid(quiet(fit), fit, EASE)
    fit = rescored(quiet(fit), fit)
    return fit.total, fit


def advance(candidate: Candidate, quiet: Callable[[Fit], Problem], least: float, effort: Effort) -> Candidate:
    """Take steps from each of the most promising starts and stand at the better end; one start does where none promises much.

    What does nothing where it starts stays there, unless it switches.
    """
    loose, beyond = contact(candidate.name), candidate.promised - least
    still = STILL[0] < beyond < STILL[1] and not loose and not find_effect(candidate.name).rugged
    if (still and not effort.all) or (loose and beyond < -NEAR):
        return replace(candidate, rivals=())
    assert candidate.fit is not None
    several = candidate.rivals if effort.all or beyond > 0 or candidate.fit.simulator.loose else ()
    climbs = 1 if loose else CLIMBS
    ends = [_reached(_climbed(t, quiet, least, effort.steps, climbs), quiet) for t in (candidate.fit, *several)]
    promised, fit = max(ends, key=lambda end: end[0])
    return replace(candidate, fit=fit, promised=promised, rivals=())


def pursue(candidate: Candidate, quiet: Callable[[Fit], Problem], left_by: Callable[[Fit], Problem]) -> Candidate:
    """Refit a candidate from where it stands; what switches under the noise that it leaves (`left_by`), which matters then."""
    if candidate.fit is None:
        return candidate
    fit = scanned(_refitted(candidate.fit, quiet, ITERATIONS), left_by, (candidate.name,))
    return replace(candidate, fit=rescored(quiet(fit), fit))


def switching(fit: Fit, effects: Collection[str]) -> list[Free]:
    """Return the free parameters of effects that switch, contacts among them."""
    own = [(f, f.name.split(".")[0]) for f in fit.free]
    return [f for f, name in own if name in effects and (find_effect(name).rugged or contact(name))]


def relaid(fit: Fit, quiet: Callable[[Fit], Problem]) -> Fit:
    """Refit with a loose load laid anew at the start of each segment, as long as that helps; the same fit without such a load.

    Where it lies is another thing for other parameters, and there is no way between either side by derivatives.
    """
    for _ in range(LAYINGS if fit.simulator.loose else 0):
        problem = quiet(fit)
        fit = rescored(problem, fit)
        new = rescored(problem, _refitted(laid(problem, fit, STARTS), quiet, ITERATIONS))
        if new.total < fit.total + BETTER:
            break
        fit = new
    return fit


def scanned(fit: Fit, quiet: Callable[[Fit], Problem], effects: Sequence[str]) -> Fit:
    """Refit from the best of values around where a fit stands, as long as that helps, for the effects that need it.

    What switches does so at other times as soon as a parameter moves: the likelihood has many small maxima, at which
    steps along derivatives end.
    """
    fit = relaid(fit, quiet)
    own = [f for f in switching(fit, effects) if not contact(f.name.split(".")[0])]
    if not own:
        return fit
    rng = np.random.default_rng(1)
    for spread in SPREADS:
        problem = quiet(fit)
        fit = best = rescored(problem, fit)
        for step in spread * rng.standard_normal((TRIES * len(own), len(own))):
            near = {f.name: f.inside(beside(f.name, best.values[f.name], d)) for f, d in zip(own, step, strict=True)}
            trial = evaluate(problem, fit.simulator, fit.free, {**best.values, **near}, best.starts)
            best = max((best, trial), key=lambda each: each.total)
        new = max((best, rescored(problem, _refitted(best, quiet, ITERATIONS))), key=lambda each: each.total)
        if new.total >= fit.total + BETTER:
            fit = new
    return rescored(quiet(fit), fit)


def _climbed(fit: Fit, quiet: Callable[[Fit], Problem], least: float, steps: int, climbs: int) -> Fit:
    """Return where steps lead from a start, so many at a time, as far as they promise to reach `least` [nats]."""
    for _ in range(climbs):
        start, fit = fit.total, _refitted(fit, quiet, steps)
        if not 0 < least - fit.total < 2 * (fit.total - start):
            break
    return fit


def _refitted(fit: Fit, quiet: Callable[[Fit], Problem], iterations: int) -> Fit:
    done = resume(quiet(fit), fit, iterations, ROUGH)
    return rescored(quiet(done), done)


def beside(name: str, value: float, step: float) -> float:
    """Return the value of an effect's parameter some way off: a moment by so many seconds, anything else by a factor."""
    return value + step if _is_moment(name) else value * float(np.exp(step))


def _is_moment(name: str) -> bool:
    return any(p.name == name and p.unit == "s" and p.minimum < 0 for p in find_effect(name.split(".")[0]).parameters)


def follow(problem: Problem, candidate: Candidate) -> Candidate:
    """Refit a candidate from where it stands, under whatever noise and judged segments the problem has."""
    return candidate if candidate.fit is None else replace(candidate, fit=resume(problem, candidate.fit, enough=ROUGH))


def idle(name: str) -> dict[str, float]:
    """Return values at which optional parameters of an effect do nothing."""
    values = {"cogging.amplitude2": 0.0, "cogging.phase2": 0.0, "hard_stop.upper": 1e6, "hard_stop.lower": -1e6}
    effect = find_effect(name)
    forms = {p.name: p.default for p in effect.parameters if p.name.removeprefix(f"{name}.") in effect.bending}
    return {key: value for key, value in (values | forms).items() if key.startswith(f"{name}.")}


def _bank(lens: Lens, fit: Fit, first: Fit, count: int) -> Array:
    """Return the directions in which the residual would change: by the effect's parameters and by its mere presence."""
    present = (first.white - fit.white)[:, :, None]
    columns = np.concatenate([first.by_parameter[:, :, -count:], present], axis=2)
    usable = np.isfinite(columns).all(axis=(1, 2), keepdims=True)
    return directions(lens.free_of_model(lens.freed(np.where(usable, columns, 0.0))), fit.weight)
