"""Inverse dynamics: torques along the measured motion against the measured output, for start values
of a fit.

A simulation from a bad model may stick where the rig moves, and then its derivatives vanish. Along
the measured motion this cannot happen: the acceleration of model and effect is integrated twice and
compared with the measured output. Noise of the motion makes the estimates less accurate than those
of a simulation: they serve as start values only.

Source: janot2019 (inverse dynamic model, linear in most parameters), in integral form to avoid
differentiating the output.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import NotStaticError
from bristle.common.table import Array
from bristle.diagnosis.estimation.dataset import Motion, Segments
from bristle.diagnosis.estimation.likelihood import T_DEGREES_OF_FREEDOM, moved
from bristle.diagnosis.estimation.noise import Noise, response, white_noise
from bristle.diagnosis.estimation.optimiser import STOP_GAIN
from bristle.diagnosis.estimation.simulator import OWN_BRISTLES, Free, Servo
from bristle.model.python import for_arrays
from bristle.plant.effects import effect as find_effect
from bristle.plant.friction import law as find_law
from bristle.plant.servo import servo

Names = tuple[str, ...]
Parameters = tuple[Free, ...]
Values = Mapping[str, float]
BALANCE_ITERATIONS = 12  # steps of a fit
BALANCE_SCREENING_ITERATIONS = 4  # steps of a fit that only compares start values
BALANCE_NOISE_PASSES = 2  # alternations of noise and parameters
BALANCE_DAMPING = 1e-3  # Levenberg-Marquardt damping at the start, relative to the curvature
BALANCE_INPUTS = ("theta", "v", "u", "time")  # on which alone the acceleration may depend


@lru_cache(maxsize=64)
def _acceleration(
    law: str, effects: Names, free: Names
) -> tuple[Callable[[Sequence[Array | float]], list[Array]], Names]:
    """Return acceleration and derivatives by the free parameters as a function of motion and
    parameters, and their names.
    """
    members = [find_effect(name) for name in effects]
    system = servo(find_law(law), False, members)
    # what depends on the past, or on another inertia, is no function of the motion
    hidden = set(system.states) - {"theta", "v"}
    memory = hidden or system.before or system.after or system.modes
    if memory or any(e.output or e.coupling for e in members):
        raise NotStaticError
    rate, v = system.rates["v"], system.symbols["v"]
    if (dry := system.dry) is not None:
        backward = dry.bound if dry.backward is None else dry.backward
        rate = rate - ca.if_else(v > 0, dry.bound, -backward) / dry.inertia
    # as a function of motion and parameters, without a load
    names, symbols = tuple(system.parameters), system.symbols | {"time": system.time}
    inputs = [symbols[name] for name in BALANCE_INPUTS]
    given = [symbols[name] for name in names]
    load = ca.vertcat(symbols["tau_load"], symbols["load_scale"])
    rate = ca.substitute(system.expand(rate), load, ca.DM([0.0, 1.0]))
    both = ca.vertcat(rate, *(ca.jacobian(rate, symbols[name]) for name in free))
    return for_arrays(
        ca.Function("balance", [ca.vertcat(*inputs, *given)], ca.cse([ca.densify(both)]))
    ), names


@dataclass(frozen=True)
class Balanced:
    """Parameters that balance the torques, their log-likelihood [nats, up to a constant], whitened
    residuals (segments, bins) and weights (segments,)."""

    values: dict[str, float]
    total: float
    residual: Array
    weight: Array


class Balance:
    """The measured motion of the segments that count (`counted`), an average per bin; `fixed`:
    settings of the simulation.
    """

    def __init__(
        self, segments: Segments, motion: Motion, counted: NDArray[np.bool_], fixed: Values
    ) -> None:
        s, self._counted, self._fixed = segments, counted, fixed
        self.shape, self.step = (len(s.measured), s.bins), s.h * s.width

        def mean(x: Array) -> Array:
            return np.asarray(x.reshape(-1, s.width).mean(axis=1))

        self.motion = Motion(
            mean(motion.theta),
            mean(motion.v),
            mean(motion.a),
            mean(motion.u),
            mean(motion.time),
            mean(motion.moving.astype(float)) > 0.5,
            motion.record[:: s.width],
        )
        self._moving = self.motion.moving.reshape(self.shape)
        fine = response(1.0, 0.0, s.h, s.width, s.bins, s.velocity)
        self._pulses = fine.reshape(s.bins, s.bins, s.width).sum(axis=2)
        self._measured = s.measured
        t = np.linspace(-1.0, 1.0, s.bins)
        self._start = np.ones((s.bins, 1)) if s.velocity else np.column_stack([np.ones(s.bins), t])
        self._whiten(white_noise(s.bins, 1.0))

    def under(self, noise: Noise) -> Balance:
        """Return the same under another noise; initial states are projected out."""
        other = copy(self)
        other._whiten(noise)
        return other

    def under_white_noise(self, law: str, effects: Names, values: Values) -> Balance:
        """Return the same under a white noise as large as the residual."""
        white = self.under(white_noise(len(self._start), 1.0))._project_averages(
            self.residual(law, effects, values)
        )
        return self.under(
            white_noise(
                len(self._start), max(float(np.sqrt(np.mean(white[self._counted] ** 2))), 1e-12)
            )
        )

    def _project_averages(self, averages: Array) -> Array:
        return np.asarray(averages @ self._project.T)

    def _whiten(self, noise: Noise) -> None:
        q = np.linalg.qr(noise.whiten @ self._start)[0]
        self._project = noise.whiten - q @ (q.T @ noise.whiten)
        self._through = self._project @ self._pulses
        self._white, self._log_det = self._project_averages(self._measured), noise.log_det

    def respond(self, acceleration: Array) -> Array:
        """Return the response (segments, bins, k) of the whitened averages to accelerations
        (points, k), which are 0 at rest.
        """
        moving = acceleration.reshape(*self.shape, -1) * self._moving[:, :, None]
        return np.asarray(np.einsum("nl,slk->snk", self._through, moving, optimize=True))

    def weight(self, residual: Array) -> Array:
        """Return 1 for segments that count (segments,), else 0."""
        return (self._counted & np.isfinite(residual).all(axis=1)).astype(float)

    def _acceleration_along(
        self, law: str, effects: Names, free: Parameters, values: Values
    ) -> tuple[Array, Array]:
        """Return accelerations (points,) along the motion and their slopes (points, free) on each
        parameter's scale.
        """
        function, names = _acceleration(law, effects, tuple(f.name for f in free))
        known = {**_defaults(law, effects), **self._fixed, **values}
        m = self.motion
        derivatives = function([m.theta, m.v, m.u, m.time, *(known[name] for name in names)])
        a, *by = (np.broadcast_to(each, m.theta.shape) for each in derivatives)
        scale = [values[f.name] if f.factor else 1.0 for f in free]
        return a, np.column_stack(by) * scale if free else np.empty((len(a), 0))

    def evaluate(
        self, law: str, effects: Names, free: Parameters, values: Values
    ) -> tuple[Array, Array]:
        """Return whitened residuals (segments, bins) and the slopes (segments, bins, free) of the
        model's averages.
        """
        a, by = self._acceleration_along(law, effects, free, values)
        return self._white - self.respond(a[:, None])[:, :, 0], self.respond(by)

    def residual(self, law: str, effects: Names, values: Values) -> Array:
        """Return the residual of the averages (segments, bins) [unit of the output], initial states
        not projected out.
        """
        a, _ = self._acceleration_along(law, effects, (), values)
        return np.asarray(self._measured - (a.reshape(self.shape) * self._moving) @ self._pulses.T)

    def fit(
        self,
        law: str,
        effects: Names,
        free: Parameters,
        values: Values,
        steps: int = BALANCE_ITERATIONS,
    ) -> Balanced:
        """Return the parameters in their intervals that balance the torques best, from start
        values.

        Levenberg-Marquardt; misfits have a t distribution, as those of a simulation.
        """
        best = self._at(
            law, effects, free, {**values, **{f.name: f.clip(values[f.name]) for f in free}}
        )
        damping = BALANCE_DAMPING
        for _ in range(steps):
            balanced, slopes = best
            # normal equations, of the parameters that do not press against an interval
            normal = np.einsum("s,snp,snq->pq", balanced.weight, slopes, slopes, optimize=True)
            pull = np.einsum(
                "s,snp,sn->p", balanced.weight, slopes, balanced.residual, optimize=True
            )
            scale = damping * np.diag(normal) + 1e-12 * np.trace(normal) + 1e-300
            active = np.array(
                [not f.leaves(balanced.values[f.name], p) for f, p in zip(free, pull, strict=True)],
                dtype=bool,
            )
            if not active.any():
                break
            # a damped step, with each parameter scaled to unit curvature
            step = np.zeros(len(free))
            size = np.sqrt(np.diag(normal) + scale)
            table = (normal + np.diag(scale)) / np.outer(size, size)
            step[active] = (
                np.linalg.solve(table[np.ix_(active, active)], (pull / size)[active]) / size[active]
            )
            # kept if it gains, else the next one is shorter
            trial = self._at(law, effects, free, moved(free, balanced.values, step))
            gain = trial[0].total - balanced.total
            if gain > 0:
                best, damping = trial, damping / 5
            else:
                damping = max(damping, 1e-4) * 8
            if 0 <= gain < STOP_GAIN or damping > 1e4:
                break
        return best[0]

    def _at(
        self, law: str, effects: Names, free: Parameters, values: dict[str, float]
    ) -> tuple[Balanced, Array]:
        residual, slopes = self.evaluate(law, effects, free, values)
        finite = np.asarray(
            np.isfinite(residual).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
        )
        residual, slopes = (
            np.where(finite[:, None], residual, 1e3),
            np.where(finite[:, None, None], slopes, 0.0),
        )
        n = residual.shape[1] - self._start.shape[1]
        misfit = np.square(residual).sum(axis=1)
        weight = np.where(
            self._counted, (T_DEGREES_OF_FREEDOM + n) / (T_DEGREES_OF_FREEDOM + misfit), 0.0
        )
        score = (
            0.5 * (T_DEGREES_OF_FREEDOM + n) * np.log1p(misfit / T_DEGREES_OF_FREEDOM)
            + 0.5 * self._log_det
        )
        total = -float(score[self._counted].sum())
        return Balanced(values, total, residual, weight), slopes

    def regress(
        self, balanced: Balanced, own: Array, inertia: float, torques: Array
    ) -> tuple[Array, float]:
        """Return coefficients (k,) of torques (points, k) [N.m] with the model's own slopes, and
        their gain [nats].
        """
        columns = self.respond(torques / inertia)
        k = columns.shape[2]
        both = np.concatenate([columns, own], axis=2)
        normal = np.einsum("s,snp,snq->pq", balanced.weight, both, both, optimize=True)
        slope = np.einsum("s,snp,sn->p", balanced.weight, both, balanced.residual, optimize=True)
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        table = normal / np.outer(size, size) + 1e-9 * np.eye(len(size))
        answer = np.linalg.solve(table, slope / size) / size
        alone = (
            np.linalg.solve(table[k:, k:], slope[k:] / size[k:]) / size[k:]
            if len(size) > k
            else np.zeros(0)
        )
        return answer[:k], 0.5 * float(slope @ answer - slope[k:] @ alone)


class BalancedModel:
    """The model fitted to the balance of torques along the measured motion, under white and under
    coloured noise.

    `balance`: the measured motion. `servo`: law and effects, with their free parameters. `values`:
    start values of these. `estimate`: returns the noise of a residual (segments, bins), given the
    weights of segments and the values of parameters.

    `fits`: empty where the model has hidden states, so that a balance does not determine the
    acceleration.
    """

    def __init__(
        self,
        balance: Balance,
        servo: Servo,
        values: Values,
        estimate: Callable[[Array, Array, Values], Noise],
    ) -> None:
        self.servo, self._estimate = servo, estimate
        self.free = tuple(f for f in servo.free if not f.name.startswith(f"{OWN_BRISTLES}."))
        given = {
            name: value for name, value in values.items() if not name.startswith(f"{OWN_BRISTLES}.")
        }
        # the coloured noise of a model without an effect absorbs a large effect; white noise does
        # not
        self.fits: list[tuple[Balance, Balanced]] = []
        try:
            plain = balance.under_white_noise(servo.law, servo.effects, given)
            balanced = plain.fit(servo.law, servo.effects, self.free, given)
            self.fits = [
                (plain, balanced),
                self.refit_with_noise(plain, servo.effects, self.free, balanced),
            ]
        except NotStaticError:
            pass

    def refit_with_noise(
        self, balance: Balance, effects: Names, free: Parameters, balanced: Balanced
    ) -> tuple[Balance, Balanced]:
        """Return a fit under the noise of its own residual."""
        for _ in range(BALANCE_NOISE_PASSES):
            residual = balance.residual(self.servo.law, effects, balanced.values)
            balance = balance.under(
                self._estimate(residual, balance.weight(residual), balanced.values)
            )
            balanced = balance.fit(self.servo.law, effects, free, balanced.values)
        return balance, balanced

    @property
    def models(self) -> list[dict[str, float]]:
        """Parameters with which the model without further effects balances the torques."""
        return [balanced.values for _, balanced in self.fits]


@lru_cache(maxsize=64)
def _defaults(law: str, effects: Names) -> dict[str, float]:
    system = servo(find_law(law), False, [find_effect(name) for name in effects])
    return {name: p.default for name, p in system.parameters.items()}
