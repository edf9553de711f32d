"""The servo as a lens: what a torque along the measured motion does to the output, and what torque a residual speaks of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.fit import Fit, Problem
from bristle.diagnosis.noise import response
from bristle.diagnosis.segments import Segments, smooth

Array = NDArray[np.float64]

REST = 3.0  # a speed below this many steps of the sensor in the smoothing window is rest


@dataclass(frozen=True)
class Motion:
    """The measured motion over all segments, one sample after the other, arrays (segments * bins * width,)."""

    theta: Array
    v: Array
    a: Array
    u: Array
    time: Array
    moving: NDArray[np.bool_]
    record: NDArray[np.int_]


def motion(segments: Segments, outputs: list[Array], resolution: float, half: float) -> Motion:
    """Return the smoothed motion of the records whose measured outputs (n,) are given, cut to their segments."""
    h, parts = segments.h, []
    for i, (piece, y) in enumerate(zip(segments.pieces, outputs, strict=True)):
        n = len(piece.u)
        if segments.velocity:
            v, a = smooth(y, h, half)[:n], smooth(y, h, half, 1)[:n]
            theta = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * h / 2)])
            still = REST * resolution
        else:
            theta, v, a = (smooth(y, h, half, order)[:n] for order in (0, 1, 2))
            still = REST * resolution / (2 * half)
        time = piece.time + h * np.arange(n)
        parts.append((theta, v, a, piece.u, time, np.abs(v) > still, np.full(n, i)))
    return Motion(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class Lens:
    """Linear response of the judged segments to torques, start states and the model's own parameters taken out."""

    def __init__(self, problem: Problem, fit: Fit, moving: NDArray[np.bool_], inertia: float, damping: float) -> None:
        segments = fit.simulator.segments
        self.noise, self.shape = problem.noise, (len(fit.score), segments.bins * segments.width)
        self._moving = moving
        self._pulses = response(inertia, damping, segments.h, segments.width, segments.bins, segments.velocity)
        self._h = segments.h
        self._seen = problem.noise.whiten @ self._pulses
        self._cover, self._starts = np.linalg.inv(problem.noise.whiten), fit.raw_by_start
        self.weight = fit.weight
        self.freed = fit.begin.freed
        self.model = self.freed(fit.by_parameter)
        self.rest = self.freed(fit.white[:, :, None])[:, :, 0]
        weighted = self.model * fit.weight[:, None, None]
        own = np.einsum("snp,snq->pq", weighted, self.model)
        self._own = np.linalg.pinv(own, rcond=1e-12)

    def plain(self, columns: Array, which: NDArray[np.int_]) -> Array:
        """Return whitened columns (segments, bins, k) of some segments as averages [output], start states at their best."""
        back = np.einsum("nl,slk->snk", self._cover, columns, optimize=True)
        return np.asarray(back - self._starts[which] @ (np.linalg.pinv(self._starts[which]) @ back))

    def through(self, torques: Array) -> Array:
        """Return what torques (samples, k) [N.m] do to the whitened averages (segments, bins, k), start states free.

        While the servo is at rest, friction takes the torque: it does nothing.
        """
        held = (torques * self._moving[:, None]).reshape(*self.shape, -1)
        return self.freed(np.matmul(self._seen, held))

    def free_of_model(self, columns: Array) -> Array:
        """Return columns (segments, bins, k) less what the model's own parameters could do."""
        cross = np.einsum("s,snp,snk->pk", self.weight, self.model, columns, optimize=True)
        return np.asarray(columns - self.model @ (self._own @ cross))

    def regress(self, torques: Array) -> tuple[Array, float]:
        """Return coefficients (k,) of torques (samples, k) in the residual, and the log-likelihood they gain [nats]."""
        columns = self.free_of_model(self.through(torques))
        normal = np.einsum("s,snk,snl->kl", self.weight, columns, columns, optimize=True)
        slope = np.einsum("s,snk,sn->k", self.weight, columns, self.rest, optimize=True)
        normal += 1e-9 * np.diag(np.diag(normal)) + 1e-300 * np.eye(len(normal))
        coefficients = np.linalg.solve(normal, slope)
        return coefficients, float(0.5 * slope @ coefficients)

    def torque(self) -> Array:
        """Return the most likely torque (segments, bins * width) [N.m] behind the residual.

        The mean of a Gaussian torque of the noise's colour, given the residual. Source: rasmussen2006 eq. (2.25).
        """
        h, n = self._h, self.shape[1]
        memory = np.exp(-2 * np.pi * self.noise.corner * h * np.abs(np.subtract.outer(np.arange(n), np.arange(n))))
        spread = max(self.noise.torque, 1e-30) ** 2
        return np.asarray(self.rest @ (self.noise.whiten @ self._pulses @ memory * spread))
