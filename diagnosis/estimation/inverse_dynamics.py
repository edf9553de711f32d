"""Torques along the measured motion against the measured output: where a fit of the model with an effect may start.

A simulation that starts from a bad model can stand still where the rig moves, and then nothing that is changed a little
changes anything. Along the measured motion no such trap is there: the acceleration that model and effect give is
integrated twice and compared with what was measured. Noise in the motion makes this worse than a simulation near the
answer; it is made to find the neighbourhood, not to decide.

Source: janot2019 (inverse dynamic model, linear in most parameters), in integral form to avoid differentiating the output.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import NotStaticError
from bristle.diagnosis.estimation.dataset import Motion, Segments
from bristle.diagnosis.estimation.likelihood import T_DEGREES_OF_FREEDOM, moved
from bristle.diagnosis.estimation.noise import Noise, response
from bristle.diagnosis.estimation.optimiser import STOP_GAIN
from bristle.diagnosis.estimation.simulator import OWN_BRISTLES, Free, Servo
from bristle.model.python import for_arrays
from bristle.plant.effects import effect as find_effect
from bristle.plant.friction import law as find_law
from bristle.plant.servo import servo

Array = NDArray[np.float64]
BALANCE_ITERATIONS, BALANCE_SCREENING_ITERATIONS = 12, 4  # steps of a fit; of one that only compares starts
BALANCE_NOISE_PASSES = 2  # times that noise and parameters are estimated in turn
BALANCE_DAMPING = 1e-3
BALANCE_INPUTS = ("theta", "v", "u", "time")


@lru_cache(maxsize=64)
def _acceleration(
    law: str, effects: tuple[str, ...], free: tuple[str, ...]
) -> tuple[Callable[[Sequence[Array | float]], list[Array]], tuple[str, ...]]:
    """Return acceleration and derivatives by the free parameters as a function of motion and parameters, and their names."""
    members = [find_effect(name) for name in effects]
    system = servo(find_law(law), False, members)
    hidden = set(system.states) - {"theta", "v"}
    if hidden or system.before or system.after or system.modes or any(e.output or e.coupling for e in members):
        raise NotStaticError
    rate, v = system.rates["v"], system.symbols["v"]
    if system.dry is not None:
        backward = system.dry.bound if system.dry.backward is None else system.dry.backward
        rate = rate - ca.if_else(v > 0, system.dry.bound, -backward) / system.dry.inertia
    names = tuple(system.parameters)
    seen = [system.symbols[name] if name != "time" else system.time for name in BALANCE_INPUTS]
    given = [system.symbols[name] for name in names]
    still = {"tau_load": 0.0, "load_scale": 1.0}
    rate = ca.substitute(system.expand(rate), ca.vertcat(*(system.symbols[name] for name in still)), ca.DM(list(still.values())))
    both = ca.vertcat(rate, *(ca.jacobian(rate, system.symbols[name]) for name in free))
    return for_arrays(ca.Function("balance", [ca.vertcat(*seen, *given)], ca.cse([ca.densify(both)]))), names


@dataclass(frozen=True)
class Found:
    """Parameters that balance the torques, the log-likelihood of that [nats, up to a constant], whitened residuals."""

    values: dict[str, float]
    total: float
    residual: Array
    weight: Array


class Balance:
    """The measured motion of the judged segments, an average a bin.

    Parameters
    ----------
    segments, motion : Segments, Motion
        The records, and their smoothed motion.
    judged : ndarray of bool, shape (segments,)
        Which segments count.
    fixed : mapping
        Values of parameters that the servo has beside those that are given later.
    """

    def __init__(self, segments: Segments, motion: Motion, judged: NDArray[np.bool_], fixed: Mapping[str, float]) -> None:
        s, self._judged, self._fixed = segments, judged, fixed
        self.shape, self.step = (len(s.seen), s.bins), s.h * s.width

        def mean(x: Array) -> Array:
            return np.asarray(x.reshape(-1, s.width).mean(axis=1))

        self.motion = Motion(
            mean(motion.theta), mean(motion.v), mean(motion.a), mean(motion.u), mean(motion.time),
            mean(motion.moving.astype(float)) > 0.5, motion.record[:: s.width],
        )  # fmt: skip
        self._moving = self.motion.moving.reshape(self.shape)
        fine = response(1.0, 0.0, s.h, s.width, s.bins, s.velocity)
        self._pulses = fine.reshape(s.bins, s.bins, s.width).sum(axis=2)
        self._seen = s.seen
        t = np.linspace(-1.0, 1.0, s.bins)
        self._start = np.ones((s.bins, 1)) if s.velocity else np.column_stack([np.ones(s.bins), t])
        self._whiten(_white(s.bins, 1.0))

    def under(self, noise: Noise) -> Balance:
        """Return the same under another noise; start states are taken out of everything."""
        other = copy(self)
        other._whiten(noise)
        return other

    def evenly(self, law: str, effects: tuple[str, ...], values: Mapping[str, float]) -> Balance:
        """Return the same under a white noise as large as what is left."""
        left = self.under(_white(len(self._start), 1.0))._white_of(self.left(law, effects, values))
        return self.under(_white(len(self._start), max(float(np.sqrt(np.mean(left[self._judged] ** 2))), 1e-12)))

    def _white_of(self, averages: Array) -> Array:
        return np.asarray(averages @ self._project.T)

    def _whiten(self, noise: Noise) -> None:
        q = np.linalg.qr(noise.whiten @ self._start)[0]
        self._project = noise.whiten - q @ (q.T @ noise.whiten)
        self._through = self._project @ self._pulses
        self._white, self._log_det = self._white_of(self._seen), noise.log_det

    def pull(self, acceleration: Array) -> Array:
        """Return what accelerations (points, k) do to the whitened averages (segments, bins, k); at rest, nothing."""
        held = acceleration.reshape(*self.shape, -1) * self._moving[:, :, None]
        return np.asarray(np.einsum("nl,slk->snk", self._through, held, optimize=True))

    def weight(self, residual: Array) -> Array:
        """Return 1 for segments that count."""
        return (self._judged & np.isfinite(residual).all(axis=1)).astype(float)

    def _along(
        self, law: str, effects: tuple[str, ...], free: tuple[Free, ...], values: Mapping[str, float]
    ) -> tuple[Array, Array]:
        """Return accelerations (points,) along the motion and their slopes (points, free), on the scale each moves on."""
        function, names = _acceleration(law, effects, tuple(f.name for f in free))
        known = {**_defaults(law, effects), **self._fixed, **values}
        m = self.motion
        found = function([m.theta, m.v, m.u, m.time, *(known[name] for name in names)])
        a, *by = (np.broadcast_to(each, m.theta.shape) for each in found)
        scale = [values[f.name] if f.factor else 1.0 for f in free]
        return a, np.column_stack(by) * scale if free else np.empty((len(a), 0))

    def evaluate(
        self, law: str, effects: tuple[str, ...], free: tuple[Free, ...], values: Mapping[str, float]
    ) -> tuple[Array, Array]:
        """Return whitened residuals (segments, bins) and the slopes (segments, bins, free) of what they are compared with."""
        a, by = self._along(law, effects, free, values)
        return self._white - self.pull(a[:, None])[:, :, 0], self.pull(by)

    def left(self, law: str, effects: tuple[str, ...], values: Mapping[str, float]) -> Array:
        """Return what is left of the averages (segments, bins) [unit of the output], start states not taken out."""
        a, _ = self._along(law, effects, (), values)
        return np.asarray(self._seen - (a.reshape(self.shape) * self._moving) @ self._pulses.T)

    def fit(
        self,
        law: str,
        effects: tuple[str, ...],
        free: tuple[Free, ...],
        values: Mapping[str, float],
        steps: int = BALANCE_ITERATIONS,
    ) -> Found:
        """Return the parameters in their intervals that balance the torques best, from given values.

        Levenberg-Marquardt; segments have a t distribution, as in the simulation.
        """
        best = self._at(law, effects, free, {**values, **{f.name: f.clip(values[f.name]) for f in free}})
        damping = BALANCE_DAMPING
        for _ in range(steps):
            found, slopes = best
            normal = np.einsum("s,snp,snq->pq", found.weight, slopes, slopes, optimize=True)
            pull = np.einsum("s,snp,sn->p", found.weight, slopes, found.residual, optimize=True)
            scale = damping * np.diag(normal) + 1e-12 * np.trace(normal) + 1e-300
            active = np.array([not f.leaves(found.values[f.name], p) for f, p in zip(free, pull, strict=True)], dtype=bool)
            if not active.any():
                break
            step = np.zeros(len(free))
            size = np.sqrt(np.diag(normal) + scale)
            table = (normal + np.diag(scale)) / np.outer(size, size)
            step[active] = np.linalg.solve(table[np.ix_(active, active)], (pull / size)[active]) / size[active]
            trial = self._at(law, effects, free, moved(free, found.values, step))
            gain = trial[0].total - found.total
            if gain > 0:
                best, damping = trial, damping / 5
            else:
                damping = max(damping, 1e-4) * 8
            if 0 <= gain < STOP_GAIN or damping > 1e4:
                break
        return best[0]

    def _at(self, law: str, effects: tuple[str, ...], free: tuple[Free, ...], values: dict[str, float]) -> tuple[Found, Array]:
        residual, slopes = self.evaluate(law, effects, free, values)
        finite = np.asarray(np.isfinite(residual).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2)))
        residual, slopes = np.where(finite[:, None], residual, 1e3), np.where(finite[:, None, None], slopes, 0.0)
        n = residual.shape[1] - self._start.shape[1]
        misfit = np.square(residual).sum(axis=1)
        weight = np.where(self._judged, (T_DEGREES_OF_FREEDOM + n) / (T_DEGREES_OF_FREEDOM + misfit), 0.0)
        score = 0.5 * (T_DEGREES_OF_FREEDOM + n) * np.log1p(misfit / T_DEGREES_OF_FREEDOM) + 0.5 * self._log_det
        total = -float(score[self._judged].sum())
        return Found(values, total, residual, weight), slopes

    def regress(self, found: Found, own: Array, inertia: float, torques: Array) -> tuple[Array, float]:
        """Return coefficients (k,) of torques (points, k) [N.m] beside the model's own slopes, and what they gain [nats]."""
        columns = self.pull(torques / inertia)
        k = columns.shape[2]
        both = np.concatenate([columns, own], axis=2)
        normal = np.einsum("s,snp,snq->pq", found.weight, both, both, optimize=True)
        slope = np.einsum("s,snp,sn->p", found.weight, both, found.residual, optimize=True)
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        table = normal / np.outer(size, size) + 1e-9 * np.eye(len(size))
        answer = np.linalg.solve(table, slope / size) / size
        alone = np.linalg.solve(table[k:, k:], slope[k:] / size[k:]) / size[k:] if len(size) > k else np.zeros(0)
        return answer[:k], 0.5 * float(slope @ answer - slope[k:] @ alone)


class BalancedModel:
    """The model fitted to the balance of torques along the measured motion, under white and under coloured noise.

    Parameters
    ----------
    balance : Balance
        The measured motion.
    servo : Servo
        Law and effects so far, with their free parameters.
    values : mapping
        Where these stand.
    estimate : function
        Returns the noise of a residual (segments, bins), given the weights of segments and the values of parameters.

    Attributes
    ----------
    fits : list of (Balance, Found)
        Empty where the model has hidden states, so that a balance does not determine the acceleration.
    """

    def __init__(
        self,
        balance: Balance,
        servo: Servo,
        values: Mapping[str, float],
        estimate: Callable[[Array, Array, Mapping[str, float]], Noise],
    ) -> None:
        self.servo, self._estimate = servo, estimate
        self.free = tuple(f for f in servo.free if not f.name.startswith(f"{OWN_BRISTLES}."))
        given = {name: value for name, value in values.items() if not name.startswith(f"{OWN_BRISTLES}.")}
        # a large effect hides in the noise that the model without it leaves: white noise lets slow residuals count too
        self.fits: list[tuple[Balance, Found]] = []
        try:
            plain = balance.evenly(servo.law, servo.effects, given)
            found = plain.fit(servo.law, servo.effects, self.free, given)
            self.fits = [(plain, found), self.refit_with_noise(plain, servo.effects, self.free, found)]
        except NotStaticError:
            pass

    def refit_with_noise(
        self, balance: Balance, effects: tuple[str, ...], free: tuple[Free, ...], found: Found
    ) -> tuple[Balance, Found]:
        """Return a fit under the noise that it leaves."""
        for _ in range(BALANCE_NOISE_PASSES):
            left = balance.left(self.servo.law, effects, found.values)
            balance = balance.under(self._estimate(left, balance.weight(left), found.values))
            found = balance.fit(self.servo.law, effects, free, found.values)
        return balance, found

    @property
    def models(self) -> list[dict[str, float]]:
        """Parameters with which the model alone balances the torques."""
        return [found.values for _, found in self.fits]


def _white(bins: int, level: float) -> Noise:
    return Noise(np.eye(bins) / level, 2 * bins * math.log(level), 0.0, 1.0, level)


@lru_cache(maxsize=64)
def _defaults(law: str, effects: tuple[str, ...]) -> dict[str, float]:
    system = servo(find_law(law), False, [find_effect(name) for name in effects])
    return {name: p.default for name, p in system.parameters.items()}
