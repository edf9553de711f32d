"""Linear response of the residual: what a torque does to the output, and which torque the residual
is evidence of.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel
from bristle.diagnosis.estimation.noise import response

Array = NDArray[np.float64]


class ResidualResponse:
    """Linear response of the residual to a torque, with what initial states and the model's own
    parameters could do projected out.

    `rest`, shape (segments, bins), is the whitened residual, free of the initial states; `weight`
    that of each segment.
    """

    def __init__(self, fitted: FittedModel, dataset: Dataset) -> None:
        problem, fit, segments = fitted.problem, fitted.fit, fitted.fit.simulator.segments
        self.noise, self.shape = problem.noise, (len(fit.score), segments.bins * segments.width)
        self._moving = dataset.motion.moving
        self._pulses = response(
            fit.values["J"],
            fit.values["a2"],
            segments.h,
            segments.width,
            segments.bins,
            segments.velocity,
        )
        self._h = segments.h
        self._seen = problem.noise.whiten @ self._pulses
        self._cover, self._starts = np.linalg.inv(problem.noise.whiten), fit.output_by_initial
        self.weight = fit.weight
        self.freed = fit.elimination.project
        self.model = self.freed(fit.by_parameter)
        self.rest = self.freed(fit.white[:, :, None])[:, :, 0]
        weighted = self.model * fit.weight[:, None, None]
        own = np.einsum("snp,snq->pq", weighted, self.model)
        self._own = np.linalg.pinv(own, rcond=1e-12)

    def plain(self, columns: Array, which: NDArray[np.int_]) -> Array:
        """Return whitened columns (segments, bins, k) of some segments as averages [output], with
        optimal initial states.
        """
        back = np.einsum("nl,slk->snk", self._cover, columns, optimize=True)
        return np.asarray(back - self._starts[which] @ (np.linalg.pinv(self._starts[which]) @ back))

    def through(self, torques: Array) -> Array:
        """Return what torques (samples, k) [N.m] do to the whitened averages (segments, bins, k),
        free of the initial states.

        At rest friction balances the torque, so it does nothing.
        """
        held = (torques * self._moving[:, None]).reshape(*self.shape, -1)
        return self.freed(np.matmul(self._seen, held))

    def free_of_model(self, columns: Array) -> Array:
        """Return columns (segments, bins, k) less what the model's own parameters could do."""
        cross = np.einsum("s,snp,snk->pk", self.weight, self.model, columns, optimize=True)
        return np.asarray(columns - self.model @ (self._own @ cross))

    def regress(self, torques: Array) -> tuple[Array, float]:
        """Return coefficients (k,) of torques (samples, k) in the residual, and the log-likelihood
        they gain [nats].
        """
        columns = self.free_of_model(self.through(torques))
        normal = np.einsum("s,snk,snl->kl", self.weight, columns, columns, optimize=True)
        slope = np.einsum("s,snk,sn->k", self.weight, columns, self.rest, optimize=True)
        normal += 1e-9 * np.diag(np.diag(normal)) + 1e-300 * np.eye(len(normal))
        coefficients = np.linalg.solve(normal, slope)
        return coefficients, float(0.5 * slope @ coefficients)

    def torque(self) -> Array:
        """Return the most likely torque (segments, bins * width) [N.m] behind the residual.

        The mean of a Gaussian torque of the noise's colour, given the residual. Source:
        rasmussen2006 eq. (2.25).
        """
        h, n = self._h, self.shape[1]
        memory = np.exp(
            -2
            * np.pi
            * self.noise.corner
            * h
            * np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        )
        spread = max(self.noise.torque, 1e-30) ** 2
        return np.asarray(self.rest @ (self.noise.whiten @ self._pulses @ memory * spread))


def chance(draws: Array, seen: float) -> float:
    """Return the p of an observed value among draws (replicates,) by chance, the observed one
    counted as one of them.
    """
    return float((1 + np.count_nonzero(draws >= seen)) / (1 + len(draws)))


def directions(columns: Array, weight: Array) -> Array:
    """Return columns (segments, bins, k) made orthonormal in the weighted scalar product; what is
    dependent is dropped.

    Segments without weight are set to 0.
    """
    columns = np.where(weight[:, None, None] > 0, columns, 0.0)
    normal = np.einsum("s,snk,snl->kl", weight, columns, columns, optimize=True)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    keep = values > 1e-6
    return np.asarray(columns @ (vectors[:, keep] / size[:, None] / np.sqrt(values[keep])))
