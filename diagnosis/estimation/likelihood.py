"""How likely the measured segments are under a servo and its noise, with derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.noise import Noise
from bristle.diagnosis.estimation.simulator import Free, Simulator

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
T_DEGREES_OF_FREEDOM = 10.0  # of the t distribution: a segment twice as bad as the others counts half as much
LARGEST_STATE_PRICE = 50.0  # nats that these may cost in a segment: more is rounding, where a simulation runs away
COLLINEAR_REST, COLLINEAR_PART = (
    1e-4,
    0.3,
)  # share of what a parameter does that others cannot do; share of it by which one of these is told
FAILED_OUTPUT = 1e12  # outputs and derivatives beyond this, or none, are those of a simulation that failed
FAILED_MISFIT = 1e6  # squared misfit of a segment whose simulation failed
STATE_SEPARATION = 1e-12  # least difference of two start states' derivatives, of their squares: more would be rounding


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
        normal[:, each, each] = normal[:, each, each] * (1 + STATE_SEPARATION) + precision
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
        if 1.0 - float(told[place, others] @ does) > COLLINEAR_REST:
            return ()
        return tuple(self.free[k].name for k, x in zip(others, does, strict=True) if abs(x) > COLLINEAR_PART)

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
    good = good & (np.abs(seen).max(axis=1) < FAILED_OUTPUT) & (np.abs(sens).max(axis=(1, 2)) < FAILED_OUTPUT)
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
    misfit = np.where(good, left, FAILED_MISFIT)
    n = white.shape[1] - 2
    cost = 0.5 * problem.noise.log_det + initial_state_price(begin, precision) * good
    score, here = (
        -0.5 * (T_DEGREES_OF_FREEDOM + n) * np.log1p(each / T_DEGREES_OF_FREEDOM) - cost
        for each in (misfit, np.where(good, whole, FAILED_MISFIT))
    )
    score = np.where(problem.judged, score, 0.0)
    weight = np.where(problem.judged & good, (T_DEGREES_OF_FREEDOM + n) / (T_DEGREES_OF_FREEDOM + misfit), 0.0)
    information = np.tensordot(weight, np.matmul(by_parameter.transpose(0, 2, 1), begin.freed(by_parameter)), 1)
    prior, curve = _knowledge(free, values)
    return Fit(
        values, free, starts, score, here, residual, white, by_parameter, begin, raw_by_start, weight,
        information + np.diag(curve), simulator, good, problem.noise, prior,
    )  # fmt: skip


def initial_state_price(begin: Begin, precision: Array) -> Array:
    """Return what a segment pays for start states that no sensor shows (segments,) [nats]: they explain something by chance.

    Source: mackay1992 (Occam factor: the doubt after over the doubt before, of a Gaussian).
    """
    hidden = slice(2, None)
    after, before = np.linalg.slogdet(begin.inverse[:, hidden, hidden])[1], -np.log(precision[:, hidden]).sum(axis=1)
    return np.asarray(np.clip(0.5 * (before - after), 0.0, LARGEST_STATE_PRICE))


def _place(free: Free, value: float) -> float:
    return float(np.log(value)) if free.factor else value


def _knowledge(free: tuple[Free, ...], values: Mapping[str, float]) -> tuple[float, Array]:
    known = [0.0 if f.nominal is None else (_place(f, values[f.name]) - f.nominal) / f.doubt for f in free]
    curve = np.array([0.0 if f.nominal is None else f.doubt**-2 for f in free])
    return -0.5 * float(np.square(known).sum()), curve


def moved(free: tuple[Free, ...], values: Mapping[str, float], step: Array) -> dict[str, float]:
    """Return the values after a step (free,), each parameter on the scale it moves on and inside its interval."""
    after = dict(values)
    for f, d in zip(free, step, strict=True):
        value = values[f.name] * float(np.exp(np.clip(d, -1.0, 1.0))) if f.factor else values[f.name] + d
        after[f.name] = f.inside(value)
    return after


def errors(fit: Fit, mask: NDArray[np.bool_]) -> list[Array]:
    """Return the error of each segment, an array (bins,) each, start states at their best [output].

    Where the simulation failed it is that of a servo that stands still: no model may gain by failing.
    """
    seen = fit.simulator.segments.seen
    lost = np.where(fit.good[:, None], fit.residual, seen - seen.mean(axis=1, keepdims=True))
    pairs = zip(lost[mask], fit.raw_by_start[mask], strict=True)  # segments are few and short
    return [r - c @ np.linalg.lstsq(c, r, rcond=1e-9)[0] for r, c in pairs]


def squares(fit: Fit, mask: NDArray[np.bool_]) -> Array:
    """Return the mean squared error of each segment (segments,), start states at their best [output squared]."""
    return np.array([np.mean(np.square(error)) for error in errors(fit, mask)])


def mean_square(fit: Fit, mask: NDArray[np.bool_]) -> float:
    """Return the mean squared error over segments, start states at their best [output squared]."""
    return float(np.mean(squares(fit, mask)))
