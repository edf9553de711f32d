"""How likely the measured segments are under a servo and its noise, with derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bristle.common.deadline import check_deadline
from bristle.common.table import Array
from bristle.diagnosis.estimation.dataset import Segments
from bristle.diagnosis.estimation.noise import Noise
from bristle.diagnosis.estimation.simulator import Simulator
from bristle.diagnosis.free_parameter import Free

Mask = NDArray[np.bool_]
T_DEGREES_OF_FREEDOM = 10.0  # degrees of freedom of the t distribution of a segment's misfit
LARGEST_STATE_PRICE = 50.0  # nats: largest Occam factor of the hidden initial states of a segment
# share of a parameter's effect that no other can produce, below which it is collinear with others
COLLINEAR_REST = 1e-4
COLLINEAR_PART = 0.3  # coefficient from which on a parameter is named as one of these others
FAILED_OUTPUT = 1e12  # unit of the output: a larger output or derivative marks a failed simulation
# of the output, by a change of position or velocity at the start: more is an instability, which an
# encoder's step or a thousandth of a parameter changes altogether
RUNAWAY = 1e3
FAILED_MISFIT = 1e6  # squared whitened misfit of a segment whose simulation failed
# relative increase of the curvature by each initial state, so that it can be inverted
STATE_SEPARATION = 1e-12


@dataclass(frozen=True)
class InitialStateElimination:
    """Least squares of the initial states of the segments alone, by which they are eliminated from
    the likelihood.

    Source: golub2003 (elimination of linear unknowns).
    """

    by_initial: Array  # (segments, bins, width): derivatives of the whitened averages
    # (segments, width): gradient of the log-likelihood, prior knowledge of the initial states
    # included
    gradient: Array
    inverse: Array  # (segments, width, width): inverse of their curvature

    @classmethod
    def of(
        cls, by_initial: Array, white: Array, precision: Array, offset: Array
    ) -> InitialStateElimination:
        """Return it for a whitened residual (segments, bins); the prior mean of the initial states
        lies `offset` from them.
        """
        turned = by_initial.transpose(0, 2, 1)
        normal = np.matmul(turned, by_initial)
        each = np.arange(by_initial.shape[2])
        normal[:, each, each] = normal[:, each, each] * (1 + STATE_SEPARATION) + precision
        gradient = np.matmul(turned, white[:, :, None])[:, :, 0] + precision * offset
        return cls(by_initial, gradient, np.linalg.inv(normal))

    def cross(self, columns: Array) -> Array:
        """Return the products (segments, width, k) with whitened columns (segments, bins, k)."""
        return np.asarray(np.matmul(self.by_initial.transpose(0, 2, 1), columns))

    def step(self, gradient: Array) -> Array:
        """Return the Gauss-Newton step of the initial states for a gradient, (segments, width)."""
        return np.asarray(np.matmul(self.inverse, gradient[:, :, None])[:, :, 0])

    def project(self, columns: Array) -> Array:
        """Return whitened columns (segments, bins, k) less what other initial states explain."""
        return np.asarray(
            columns - np.matmul(self.by_initial, np.matmul(self.inverse, self.cross(columns)))
        )


@dataclass(frozen=True)
class FitPoint:
    """A simulator with the values of its parameters (SI), those that are free, and initial states
    (segments, width).
    """

    simulator: Simulator
    free: tuple[Free, ...]
    values: dict[str, float]
    initial: Array

    def at(
        self, values: Mapping[str, float] | None = None, initial: Array | None = None
    ) -> FitPoint:
        """Return the point with other values, initial states, or both."""
        values, initial = (
            self.values if values is None else dict(values),
            self.initial if initial is None else initial,
        )
        return FitPoint(self.simulator, self.free, values, initial)

    def fixed(self) -> FitPoint:
        """Return the point with no parameter free."""
        return FitPoint(self.simulator, (), self.values, self.initial)


@dataclass(frozen=True)
class Linearised:
    """Residual of a simulation and its derivatives."""

    residual: Array  # (segments, bins): measured less simulated averages
    by_parameter: Array  # (segments, bins, free): derivatives of the whitened averages
    by_initial: Array  # (segments, bins, width): the same by the initial states
    # (segments, bins, width): derivatives of the averages by the initial states
    output_by_initial: Array
    good: Mask  # (segments,): False where the simulation failed


@dataclass(frozen=True)
class Fit(FitPoint):
    """A point with its likelihood and what a step from it needs, named as in `Linearised`."""

    # (segments,): log-likelihood of each segment [nats], initial states eliminated; 0 for segments
    # that do not count
    score: Array
    # (segments,): the same with the initial states as they are, for all segments
    score_at_initial: Array
    residual: Array
    white: Array  # (segments, bins): whitened residual
    by_parameter: Array
    elimination: InitialStateElimination  # of the initial states
    output_by_initial: Array
    # (segments,): weight of each segment in the least squares; 0 where it does not count
    weight: Array
    # (free, free): curvature of the log-likelihood, on the scale of each parameter's steps
    information: Array
    good: Mask
    noise: Noise  # the noise of this likelihood
    prior: float = 0.0  # log-likelihood of the parameters by prior knowledge [nats]

    @property
    def total(self) -> float:
        """Log-likelihood over the segments that count, prior knowledge included [nats]."""
        return float(self.score.sum()) + self.prior

    @property
    def penalised(self) -> float:
        """Log-likelihood less half the Bayesian information criterion's penalty [nats]. Source:
        schwarz1978.
        """
        return self.total - 0.5 * len(self.free) * float(
            np.log(np.count_nonzero(self.weight) + 1.0)
        )

    def collinear_with(self, place: int) -> tuple[str, ...]:
        """Return the parameters that together have the effect of the one at this place; empty if
        none do or it is unknown.
        """
        # derivatives of a load in its play can be mostly rounding errors
        if not (np.diag(self.information) > 0).all():
            return ()
        size = np.sqrt(np.diag(self.information))
        scaled = (self.information - np.diag(_prior(self.free, self.values)[1])) / np.outer(
            size, size
        )
        others = [k for k in range(len(size)) if k != place]
        parts = (
            np.linalg.pinv(scaled[np.ix_(others, others)], rcond=1e-9, hermitian=True)
            @ scaled[others, place]
        )
        if 1.0 - float(scaled[place, others] @ parts) > COLLINEAR_REST:
            return ()
        return tuple(
            self.free[k].name for k, x in zip(others, parts, strict=True) if abs(x) > COLLINEAR_PART
        )

    @property
    def slopes(self) -> Array:
        """Gradient of each segment's own squares (segments, free), initial states following."""
        after = self.elimination.step(self.elimination.gradient)
        own = np.matmul(self.by_parameter.transpose(0, 2, 1), self.white[:, :, None])[:, :, 0]
        return np.asarray(
            own - np.einsum("sip,si->sp", self.elimination.cross(self.by_parameter), after)
        )


@dataclass(frozen=True)
class Problem:
    """What all models of a dataset share: noise, the segments that count (`counted`), measured
    averages and initial states.
    """

    noise: Noise
    counted: Mask
    measured: Array
    initial: Array
    initial_sd: Array

    @classmethod
    def of(cls, segments: Segments, noise: Noise, counted: Mask) -> Problem:
        """Return the problem of these segments."""
        return cls(noise, counted, segments.measured, segments.initial, segments.initial_sd)

    def only(self, mask: Mask) -> Problem:
        """Return the same with other segments that count."""
        return replace(self, counted=mask)

    def prior_states(
        self, simulator: Simulator, values: Mapping[str, float]
    ) -> tuple[Array, Array]:
        """Return mean and standard deviation of all initial states of a simulator by prior
        knowledge (segments, width).
        """
        hidden = np.tile(simulator.hidden_spread(values), (len(self.initial), 1))
        return np.hstack([self.initial, np.zeros_like(hidden)]), np.hstack(
            [self.initial_sd, hidden]
        )


def evaluate(problem: Problem, point: FitPoint) -> Fit:
    """Simulate at a point: its likelihood with derivatives, or `OutOfTime` after the deadline."""
    check_deadline()
    simulator, values = point.simulator, point.values
    simulated, sens, good, initial = simulator.run(values, point.initial, jacobian=True)
    assert sens is not None
    largest = np.abs(sens).max(axis=1)
    good = (
        good
        & (np.abs(simulated).max(axis=1) < FAILED_OUTPUT)
        & (largest.max(axis=1) < FAILED_OUTPUT)
    )
    # what runs away from where it began tells nothing of the parameters
    steady = largest[:, -simulator.width :].max(axis=1) < RUNAWAY
    # a stretch may be longer than what was measured
    known = good[:, None] & np.isfinite(problem.measured)
    residual = np.where(known, problem.measured - simulated, 0.0)
    sens = np.where((known & steady[:, None])[:, :, None], sens, 0.0)
    index = [simulator.names.index(f.name) for f in point.free]
    scale = np.array([values[f.name] if f.factor else 1.0 for f in point.free])
    both = np.matmul(problem.noise.whiten, sens)
    by_parameter, by_initial, raw = (
        both[:, :, index] * scale,
        both[:, :, -simulator.width :],
        sens[:, :, -simulator.width :],
    )
    return scored(
        problem,
        point.at(initial=initial),
        Linearised(residual, by_parameter, by_initial, raw, good),
    )


def rescored(problem: Problem, fit: Fit) -> Fit:
    """Return a fit under a problem with other noise or segments, without simulating again."""
    turn = problem.noise.whiten @ np.linalg.inv(fit.noise.whiten)
    by_parameter, by_initial = (
        np.matmul(turn, fit.by_parameter),
        np.matmul(turn, fit.elimination.by_initial),
    )
    return scored(
        problem,
        fit,
        Linearised(fit.residual, by_parameter, by_initial, fit.output_by_initial, fit.good),
    )


def scored(problem: Problem, point: FitPoint, linearised: Linearised) -> Fit:
    """Return the likelihood of what a simulation at a point has given."""
    white = linearised.residual @ problem.noise.whiten.T
    mean, deviation = problem.prior_states(point.simulator, point.values)
    # the initial states are eliminated, so that the misfit is the least they leave
    precision, offset = deviation**-2, mean - point.initial
    elimination = InitialStateElimination.of(linearised.by_initial, white, precision, offset)
    misfit_at_initial = np.einsum("sn,sn->s", white, white) + (precision * offset**2).sum(axis=1)
    eliminated = misfit_at_initial - np.einsum(
        "si,si->s", elimination.gradient, elimination.step(elimination.gradient)
    )
    # a t distribution for each segment; the cost is what does not depend on the misfit
    misfit = np.where(linearised.good, np.maximum(eliminated, 0.0), FAILED_MISFIT)
    n = white.shape[1] - 2
    cost = (
        0.5 * problem.noise.log_det + initial_state_price(elimination, precision) * linearised.good
    )
    score, score_at_initial = (
        -0.5 * (T_DEGREES_OF_FREEDOM + n) * np.log1p(each / T_DEGREES_OF_FREEDOM) - cost
        for each in (misfit, np.where(linearised.good, misfit_at_initial, FAILED_MISFIT))
    )
    score = np.where(problem.counted, score, 0.0)
    # outliers weigh less in the information of the parameters
    weight = np.where(
        problem.counted & linearised.good,
        (T_DEGREES_OF_FREEDOM + n) / (T_DEGREES_OF_FREEDOM + misfit),
        0.0,
    )
    by_parameter = linearised.by_parameter
    information = np.tensordot(
        weight, np.matmul(by_parameter.transpose(0, 2, 1), elimination.project(by_parameter)), 1
    )
    prior, curve = _prior(point.free, point.values)
    return Fit(
        point.simulator,
        point.free,
        point.values,
        point.initial,
        score,
        score_at_initial,
        linearised.residual,
        white,
        by_parameter,
        elimination,
        linearised.output_by_initial,
        weight,
        information + np.diag(curve),
        linearised.good,
        problem.noise,
        prior,
    )


def initial_state_price(elimination: InitialStateElimination, precision: Array) -> Array:
    """Return the Occam factor of each segment's initial states that no sensor shows (segments,)
    [nats].

    They explain part of a residual by chance. Source: mackay1992 (posterior over prior standard
    deviation of a Gaussian).
    """
    hidden = slice(2, None)
    after, before = (
        np.linalg.slogdet(elimination.inverse[:, hidden, hidden])[1],
        -np.log(precision[:, hidden]).sum(axis=1),
    )
    return np.asarray(np.clip(0.5 * (before - after), 0.0, LARGEST_STATE_PRICE))


def _prior(free: tuple[Free, ...], values: Mapping[str, float]) -> tuple[float, Array]:
    """Return the log-likelihood of values by prior knowledge [nats], and its curvature (free,)."""
    known = [
        0.0 if f.nominal is None else (f.scaled(values[f.name]) - f.nominal) / f.prior_sd
        for f in free
    ]
    curve = np.array([0.0 if f.nominal is None else f.prior_sd**-2 for f in free])
    return -0.5 * float(np.square(known).sum()), curve


def moved(free: tuple[Free, ...], values: Mapping[str, float], step: Array) -> dict[str, float]:
    """Return the values after a step (free,) on each parameter's scale, within its interval."""
    after = dict(values)
    for f, d in zip(free, step, strict=True):
        value = (
            values[f.name] * float(np.exp(np.clip(d, -1.0, 1.0)))
            if f.factor
            else values[f.name] + d
        )
        after[f.name] = f.clip(value)
    return after


def errors(fit: Fit, mask: Mask) -> list[Array]:
    """Return the error (bins,) of each segment of a mask, initial states optimal [unit of the
    output].

    Where the simulation failed it is that of a servo at rest, so that no model gains by failing.
    """
    measured = fit.simulator.segments.measured
    residual = np.where(
        fit.good[:, None], fit.residual, measured - measured.mean(axis=1, keepdims=True)
    )
    pairs = zip(residual[mask], fit.output_by_initial[mask], strict=True)
    return [r - c @ np.linalg.lstsq(c, r, rcond=1e-9)[0] for r, c in pairs]


def squares(fit: Fit, mask: Mask) -> Array:
    """Return the mean squared error of each segment, initial states optimal [output squared]."""
    return np.array([np.mean(np.square(error)) for error in errors(fit, mask)])


def mean_square(fit: Fit, mask: Mask) -> float:
    """Return the mean squared error over segments, initial states optimal [output squared]."""
    return float(np.mean(squares(fit, mask)))
