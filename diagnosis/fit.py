"""Refit of a servo by simulation: parameters and the start states of all segments, robust against single segments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.noise import Noise
from bristle.diagnosis.segments import Simulator

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FREEDOM = 10.0  # of the t distribution: a segment twice as bad as the others counts half as much
ENOUGH = 0.05  # nats: a fit ends when the next step promises less
ROUGH = 0.5  # the same where candidates are compared only
ITERATIONS = 15
STARTS = 5  # steps of start states alone
EASE = 2  # of them that follow each step of the parameters, where a load is loose
HALF = 0.5  # of what a step promised: less calls for these
SIDES = (-1.0, 0.0, 1.0)  # of the play, where a loose load is looked for
DEAREST = 50.0  # nats that these may cost in a segment: more is rounding, where a simulation runs away
PATIENCE = 3  # steps in a row that gain nothing
MUCH = 10.0  # nats: a step that promises this is shortened until it keeps some of it (a loose load's promises are never kept)
SAME, PART = 1e-4, 0.3  # share of what a parameter does that others cannot do; share of it by which one of these is told
WILD = 1e12  # outputs and derivatives beyond this, or none, are those of a simulation that failed
FAILED = 1e6  # squared misfit of a segment whose simulation failed
DAMPING = 1e-3
APART = 1e-12  # least difference of two start states' derivatives, of their squares: more would be rounding


@dataclass(frozen=True)
class Free:
    """A parameter that is fitted: its interval, whether it moves by factors, and (optional) what is known beforehand.

    `nominal`, `doubt`: centre and standard deviation of that knowledge, on the scale it moves on.
    """

    name: str
    low: float
    high: float
    factor: bool = False
    nominal: float | None = None
    doubt: float = 1.0

    @property
    def usual(self) -> float:
        """The value that is known beforehand, in its unit."""
        assert self.nominal is not None
        return float(np.exp(self.nominal)) if self.factor else self.nominal

    def inside(self, value: float) -> float:
        """Return the value moved into the interval."""
        return min(max(value, self.low), self.high)

    def stuck(self, value: float) -> bool:
        """True at an end of the interval."""
        near = 1e-9 * min(self.high - self.low, abs(self.low) + 1.0), 1e-9 * abs(self.high)
        return bool(value <= self.low + near[0] or value >= self.high - near[1])

    def barred(self, value: float) -> bool:
        """True at an end of the interval that holds it back; none at all, 0, is no such end."""
        return self.stuck(value) and value != 0.0

    def widened(self, factor: float) -> Free:
        """Return the same with both ends farther out by a factor; an end at 0 stays."""
        low = self.low / factor if self.low > 0 else self.low * factor
        high = self.high * factor if self.high > 0 else self.high / factor
        return replace(self, low=low, high=high)


@dataclass(frozen=True)
class Begin:
    """What the start states of the segments can do: their own least squares, so that parameters are left alone with the rest.

    Attributes
    ----------
    by_start : ndarray, shape (segments, bins, width)
        Derivatives of the whitened averages.
    pull : ndarray, shape (segments, width)
        Gradient of the log-likelihood, what is known of start states included.
    inverse : ndarray, shape (segments, width, width)
        Inverse of their curvature.

    Source: golub2003 (elimination of linear unknowns).
    """

    by_start: Array
    pull: Array
    inverse: Array

    @classmethod
    def of(cls, by_start: Array, white: Array, precision: Array, offset: Array) -> Begin:
        """Return it for a whitened residual (segments, bins); start states are known to lie `offset` from where they are."""
        turned = by_start.transpose(0, 2, 1)
        normal = np.matmul(turned, by_start)
        each = np.arange(by_start.shape[2])
        normal[:, each, each] = normal[:, each, each] * (1 + APART) + precision
        pull = np.matmul(turned, white[:, :, None])[:, :, 0] + precision * offset
        return cls(by_start, pull, np.linalg.inv(normal))

    def cross(self, columns: Array) -> Array:
        """Return the products (segments, width, k) with whitened columns (segments, bins, k)."""
        return np.asarray(np.matmul(self.by_start.transpose(0, 2, 1), columns))

    def moves(self, pull: Array) -> Array:
        """Return the step of the start states (segments, width) that a gradient (segments, width) calls for."""
        return np.asarray(np.matmul(self.inverse, pull[:, :, None])[:, :, 0])

    def freed(self, columns: Array) -> Array:
        """Return whitened columns (segments, bins, k) less what other start states could do."""
        return np.asarray(columns - np.matmul(self.by_start, np.matmul(self.inverse, self.cross(columns))))


@dataclass(frozen=True)
class Fit:
    """A servo fitted to segments.

    Attributes
    ----------
    values : dict
        All parameters that were set, SI.
    free : tuple of Free
        Those that were fitted.
    starts : ndarray, shape (segments, width)
        Start states, as many as the simulator has.
    score : ndarray, shape (segments,)
        Log-likelihood of each segment [nats], start states eliminated; 0 for segments that are not judged.
    here : ndarray, shape (segments,)
        The same with the start states as they are, for all segments.
    residual : ndarray, shape (segments, bins)
        Measured less simulated averages at the fitted start states.
    white, by_parameter : ndarray
        Whitened residual (segments, bins), and its derivatives (segments, bins, free).
    begin : Begin
        What the start states can do.
    raw_by_start : ndarray, shape (segments, bins, width)
        Derivative of the averages by the start states.
    weight : ndarray, shape (segments,)
        Weight of each segment in the least squares; 0 where it is not judged.
    information : ndarray, shape (free, free)
        Curvature of the log-likelihood, on the scale each parameter moves on.
    good : ndarray of bool, shape (segments,)
        False where the simulation failed.
    noise : Noise
        The noise under which all this holds.
    """

    values: dict[str, float]
    free: tuple[Free, ...]
    starts: Array
    score: Array
    here: Array
    residual: Array
    white: Array
    by_parameter: Array
    begin: Begin
    raw_by_start: Array
    weight: Array
    information: Array
    simulator: Simulator
    good: Mask
    noise: Noise
    prior: float = 0.0

    @property
    def total(self) -> float:
        """Log-likelihood over the judged segments, with what was known beforehand [nats]."""
        return float(self.score.sum()) + self.prior

    def alike(self, place: int) -> tuple[str, ...]:
        """Return the parameters that do together what the one at this place does; none if that is not known, or none does."""
        if not (np.diag(self.information) > 0).all():  # derivatives of a load that rattles: more rounding than number
            return ()
        size = np.sqrt(np.diag(self.information))
        told = (self.information - np.diag(_knowledge(self.free, self.values)[1])) / np.outer(size, size)
        others = [k for k in range(len(size)) if k != place]
        does = np.linalg.pinv(told[np.ix_(others, others)], rcond=1e-9, hermitian=True) @ told[others, place]
        if 1.0 - float(told[place, others] @ does) > SAME:
            return ()
        return tuple(self.free[k].name for k, x in zip(others, does, strict=True) if abs(x) > PART)

    @property
    def slopes(self) -> Array:
        """Gradient of each segment's own squares (segments, free), start states following."""
        after = self.begin.moves(self.begin.pull)
        own = np.matmul(self.by_parameter.transpose(0, 2, 1), self.white[:, :, None])[:, :, 0]
        return np.asarray(own - np.einsum("sip,si->sp", self.begin.cross(self.by_parameter), after))


@dataclass(frozen=True)
class Problem:
    """What all candidates share: noise, which segments count, and start states with their doubt."""

    noise: Noise
    judged: Mask
    seen: Array
    starts: Array
    spread: Array

    def only(self, mask: Mask) -> Problem:
        """Return the same with other segments judged."""
        return replace(self, judged=mask)

    def known(self, simulator: Simulator, values: Mapping[str, float]) -> tuple[Array, Array]:
        """Return what is known of all start states of a simulator (segments, width), and their doubt."""
        unknown = np.tile(simulator.unknown(values), (len(self.starts), 1))
        return np.hstack([self.starts, np.zeros_like(unknown)]), np.hstack([self.spread, unknown])


def evaluate(problem: Problem, simulator: Simulator, free: tuple[Free, ...], values: dict[str, float], starts: Array) -> Fit:
    """Simulate and return where it stands, without moving anything."""
    seen, sens, good, starts = simulator.run(values, starts, jacobian=True)
    assert sens is not None
    good = good & (np.abs(seen).max(axis=1) < WILD) & (np.abs(sens).max(axis=(1, 2)) < WILD)
    residual = np.where(good[:, None], problem.seen - seen, 0.0)
    sens = np.where(good[:, None, None], sens, 0.0)
    index = [simulator.names.index(f.name) for f in free]
    scale = np.array([values[f.name] if f.factor else 1.0 for f in free])
    both = np.matmul(problem.noise.whiten, sens)
    by_parameter, by_start, raw = both[:, :, index] * scale, both[:, :, -simulator.width :], sens[:, :, -simulator.width :]
    return _scored(problem, simulator, free, values, starts, residual, by_parameter, by_start, raw, good)


def rescored(problem: Problem, fit: Fit) -> Fit:
    """Return a fit as it is under a problem with another noise, without simulating anew; `fit.noise` is what it was under."""
    turn = problem.noise.whiten @ np.linalg.inv(fit.noise.whiten)
    return _scored(
        problem, fit.simulator, fit.free, fit.values, fit.starts, fit.residual, np.matmul(turn, fit.by_parameter),
        np.matmul(turn, fit.begin.by_start), fit.raw_by_start, fit.good,
    )  # fmt: skip


def _scored(
    problem: Problem,
    simulator: Simulator,
    free: tuple[Free, ...],
    values: dict[str, float],
    starts: Array,
    residual: Array,
    by_parameter: Array,
    by_start: Array,
    raw_by_start: Array,
    good: Mask,
) -> Fit:
    white = residual @ problem.noise.whiten.T
    known, doubt = problem.known(simulator, values)
    precision, offset = doubt**-2, known - starts
    begin = Begin.of(by_start, white, precision, offset)
    whole = np.einsum("sn,sn->s", white, white) + (precision * offset**2).sum(axis=1)
    left = np.maximum(whole - np.einsum("si,si->s", begin.pull, begin.moves(begin.pull)), 0.0)
    misfit = np.where(good, left, FAILED)
    n = white.shape[1] - 2
    cost = 0.5 * problem.noise.log_det + paid_for_starts(begin, precision) * good
    score, here = (
        -0.5 * (FREEDOM + n) * np.log1p(each / FREEDOM) - cost
        for each in (misfit, np.where(good, whole, FAILED))
    )
    score = np.where(problem.judged, score, 0.0)
    weight = np.where(problem.judged & good, (FREEDOM + n) / (FREEDOM + misfit), 0.0)
    information = np.tensordot(weight, np.matmul(by_parameter.transpose(0, 2, 1), begin.freed(by_parameter)), 1)
    prior, curve = _knowledge(free, values)
    return Fit(
        values, free, starts, score, here, residual, white, by_parameter, begin, raw_by_start, weight,
        information + np.diag(curve), simulator, good, problem.noise, prior,
    )  # fmt: skip


def paid_for_starts(begin: Begin, precision: Array) -> Array:
    """Return what a segment pays for start states that no sensor shows (segments,) [nats]: they explain something by chance.

    Source: mackay1992 (Occam factor: the doubt after over the doubt before, of a Gaussian).
    """
    hidden = slice(2, None)
    after, before = np.linalg.slogdet(begin.inverse[:, hidden, hidden])[1], -np.log(precision[:, hidden]).sum(axis=1)
    return np.asarray(np.clip(0.5 * (before - after), 0.0, DEAREST))


def _place(free: Free, value: float) -> float:
    return float(np.log(value)) if free.factor else value


def _knowledge(free: tuple[Free, ...], values: Mapping[str, float]) -> tuple[float, Array]:
    known = [0.0 if f.nominal is None else (_place(f, values[f.name]) - f.nominal) / f.doubt for f in free]
    curve = np.array([0.0 if f.nominal is None else f.doubt**-2 for f in free])
    return -0.5 * float(np.square(known).sum()), curve


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
    promise = float(gradient @ step - 0.5 * step @ fit.information @ step)
    back = fit.begin.moves(fit.begin.pull - fit.begin.cross(fit.by_parameter) @ step)
    return step, back, promise


def promise(fit: Fit) -> float:
    """Return the gain that a step from here promises [nats]."""
    return _direction(fit, DAMPING)[2]


def moved(free: tuple[Free, ...], values: Mapping[str, float], step: Array) -> dict[str, float]:
    """Return the values after a step (free,), each parameter on the scale it moves on and inside its interval."""
    after = dict(values)
    for f, d in zip(free, step, strict=True):
        value = values[f.name] * float(np.exp(np.clip(d, -1.0, 1.0))) if f.factor else values[f.name] + d
        after[f.name] = f.inside(value)
    return after


def refit(
    problem: Problem,
    simulator: Simulator,
    free: tuple[Free, ...],
    values: Mapping[str, float],
    starts: Array,
    iterations: int = ITERATIONS,
    first: Fit | None = None,
    enough: float = ENOUGH,
) -> Fit:
    """Maximise the likelihood of the judged segments from the given values and start states.

    Levenberg-Marquardt with the exact derivatives of the simulated steps; each segment has a t distribution, so that a
    few segments that the model cannot follow do not decide. A segment that gets worse moves its start state less next time:
    where a servo sticks and slips, a start state cannot be improved by its derivatives alone.

    Source: lange1989 (robust regression by the t distribution), golub2003 (elimination of start states).
    """
    begin = {**values, **{f.name: f.inside(values[f.name]) for f in free}}
    fit, damping = first or evaluate(problem, simulator, free, begin, starts), DAMPING
    trust, failed = np.ones(len(starts)), 0
    for _ in range(iterations):
        step, back, promise = _direction(fit, damping)
        around = _begun_at(problem, fit, trust[:, None] * back)
        values = moved(free, fit.values, step)
        trial = evaluate(problem, simulator, free, values, around)
        if simulator.loose and _gained(problem, fit, trial) < max(HALF * promise, enough):
            still = evaluate(problem, simulator, free, values, fit.starts)
            trial = eased(problem, _merged(problem, [still, trial], (trial.here > still.here).astype(int)), EASE)
        gain = _gained(problem, fit, trial)
        trust = np.where(trial.here < fit.here, 0.25 * trust, np.minimum(2 * trust, 1.0))
        open_ = fit.total - fit.prior - float(fit.here[problem.judged].sum())  # what the start states promise beside
        failed = 0 if gain >= enough else failed + 1
        if gain > 0:
            fit, damping = trial, damping / 5
        else:
            damping = max(damping, 1e-4) * 8
        if promise + min(open_, enough) < enough or (failed > PATIENCE and (simulator.loose or promise < MUCH)):
            break
    return fit


def _begun_at(problem: Problem, fit: Fit, step: Array) -> Array:
    """Return the start states (segments, width) after a step, no further from what is known of them than four times its doubt."""
    known, doubt = problem.known(fit.simulator, fit.values)
    return np.asarray(np.clip(fit.starts + step, known - 4 * doubt, known + 4 * doubt))


def _gained(problem: Problem, fit: Fit, trial: Fit) -> float:
    """Return by how much a trial is likelier, each with its start states as they are [nats]."""
    return float((trial.here - fit.here)[problem.judged].sum()) + trial.prior - fit.prior


def begun_well(problem: Problem, fit: Fit) -> Fit:
    """Return a fit with the start states of the judged segments refitted and all parameters as they are."""
    still = evaluate(problem, fit.simulator, (), fit.values, fit.starts)
    return refit(problem, fit.simulator, (), fit.values, fit.starts, STARTS, still)


def laid(problem: Problem, fit: Fit, steps: int = 0) -> Fit:
    """Return a fit whose loose load lies, when a segment starts, where that segment is likeliest: here or at either side.

    Each place is tried in all segments at once, after so many steps of the start states, or by what these promise;
    parameters stay as they are.
    """
    if not fit.simulator.loose:
        return fit
    ends = [eased(problem, fit, steps)]
    for side in SIDES:
        starts = fit.starts.copy()
        starts[:, 2:] = side, 0.0
        ends.append(eased(problem, evaluate(problem, fit.simulator, fit.free, fit.values, starts), steps))
    whole = problem.only(np.ones_like(problem.judged))
    worth = [end.here if steps else rescored(whole, end).score for end in ends]
    return _merged(problem, ends, np.argmax(worth, axis=0))


def eased(problem: Problem, fit: Fit, steps: int) -> Fit:
    """Return a fit after so many steps of the start states of all segments, each taken where it helps."""
    trust = np.ones(len(fit.starts))
    for _ in range(steps):
        around = _begun_at(problem, fit, trust[:, None] * fit.begin.moves(fit.begin.pull))
        trial = evaluate(problem, fit.simulator, fit.free, fit.values, around)
        better = trial.here > fit.here
        trust = np.where(better, np.minimum(2 * trust, 1.0), 0.25 * trust)
        fit = _merged(problem, [fit, trial], better.astype(int))
    return fit


def _merged(problem: Problem, fits: Sequence[Fit], which: NDArray[np.int_]) -> Fit:
    """Return the fit that each segment has in one of several with the same parameters."""

    def picked(of: Callable[[Fit], NDArray[Any]]) -> NDArray[Any]:
        return np.stack([of(fit) for fit in fits])[which, np.arange(len(which))]

    first = fits[0]
    return _scored(
        problem, first.simulator, first.free, first.values, picked(lambda f: f.starts), picked(lambda f: f.residual),
        picked(lambda f: f.by_parameter), picked(lambda f: f.begin.by_start), picked(lambda f: f.raw_by_start),
        picked(lambda f: f.good),
    )  # fmt: skip


def resume(problem: Problem, fit: Fit, iterations: int = ITERATIONS, enough: float = ENOUGH) -> Fit:
    """Refit from where a fit stands, under whatever noise and judged segments the problem has."""
    return refit(problem, fit.simulator, fit.free, fit.values, fit.starts, iterations, rescored(problem, fit), enough)
