"""How far an input tells one model from another: by how much the likelihood is expected to fall
with the wrong one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from bristle.common.table import Array
from bristle.diagnosis.estimation.dataset import (
    Grid,
    Piece,
    Segments,
    cut,
)
from bristle.diagnosis.estimation.likelihood import (
    T_DEGREES_OF_FREEDOM,
    Fit,
    Problem,
    evaluate,
    moved,
)
from bristle.diagnosis.estimation.noise import Noise

KNOWN_SHARE = 1e-12  # of the largest curvature: least of a direction in which parameters are drawn


@dataclass(frozen=True)
class Setup:
    """How an experiment is recorded: like the records of a dataset, from rest at `start` (SI) at
    `time` [s].
    """

    grid: Grid
    resolution: float
    start: float
    time: float

    def positions(self, y: Array) -> Array:
        """Return the positions that belong to an output (n,)."""
        return np.asarray(self.start + self.grid.h * np.cumsum(y)) if self.grid.velocity else y


@dataclass(frozen=True)
class Rival:
    """A model that explains the records; `name` is its effect, empty for none."""

    name: str
    fit: Fit

    def drawn(self, rng: np.random.Generator) -> dict[str, float]:
        """Return values that the records cannot tell from its own: from the normal distribution
        that their information gives.
        """
        known, axes = np.linalg.eigh(self.fit.information)
        told = known > KNOWN_SHARE * known[-1]
        step = axes[:, told] @ (rng.standard_normal(np.count_nonzero(told)) / np.sqrt(known[told]))
        return moved(self.fit.free, self.fit.values, step)

    def output(
        self, u: Array, setup: Setup, values: Mapping[str, float] | None = None
    ) -> Array | None:
        """Return its output (n,) under an input (n,) from rest, with its own values or others; None
        if the simulation fails.
        """
        start, seconds = np.array([[setup.start, 0.0]]), setup.grid.h * len(u)
        blank = Piece(
            "experiment", setup.time, u, np.zeros((1, len(u))), start, np.ones((1, 2)), seconds
        )
        simulator = self.fit.simulator.over(
            Segments(setup.grid.h, 1, len(u), setup.grid.velocity, (blank,))
        )
        simulated, _, good, _ = simulator.run(
            self.fit.values if values is None else values, blank.initial
        )
        return simulated[0] if good[0] and np.isfinite(simulated).all() else None


def lead(truth: Array, u: Array, rival: Rival, setup: Setup) -> float:
    """Return by how many nats a rival is expected to fall behind the model whose output (n,) under
    an input is `truth`.

    Half the squared whitened difference of the outputs that is left when the rival has moved its
    parameters, as far as the records allow, and the initial states of segments; as a segment counts
    in the likelihood, noise included.

    Source: box1967 (discrimination between models by the expected ratio of their likelihoods).
    """
    g = setup.grid
    piece = cut("experiment", setup.time, u, truth, g, setup.resolution)
    segments = Segments(g.h, g.width, g.bins, g.velocity, (piece,))
    problem = Problem.of(segments, rival.fit.noise, segments.counted)
    seen = evaluate(
        problem,
        replace(rival.fit.at(initial=piece.initial), simulator=rival.fit.simulator.over(segments)),
    )
    live = seen.good & problem.counted
    turned = np.matmul(
        seen.by_parameter[live].transpose(0, 2, 1),
        seen.elimination.project(seen.by_parameter)[live],
    ).sum(axis=0)
    known = rival.fit.information
    step = np.linalg.lstsq(turned + known, seen.slopes[live].sum(axis=0), rcond=1e-12)[0]
    left = seen.white - seen.by_parameter @ step
    rest = np.einsum("sn,sn->s", left, seen.elimination.project(left[:, :, None])[:, :, 0])[live]
    scale = T_DEGREES_OF_FREEDOM + g.bins - 2
    return float(
        0.5 * scale * np.log1p(np.maximum(rest, 0.0) / scale).sum() + 0.5 * step @ known @ step
    )


def disturbed(u: Array, noise: Noise, gain: float, h: float, rng: np.random.Generator) -> Array:
    """Return an input (n,) with a fit's disturbance torque on top, `gain` in torque over input."""
    keep = np.exp(-2 * np.pi * noise.corner * h)
    white = noise.torque * np.sqrt(1 - keep**2) * rng.standard_normal(len(u))
    return np.asarray(u + lfilter([1.0], [1.0, -keep], white) / gain)
