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
    LANES,
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
from bristle.diagnosis.estimation.simulator import Simulator
from bristle.diagnosis.sliding.loop import Loop

KNOWN_SHARE = 1e-12  # of the largest curvature: least of a direction in which parameters are drawn


@dataclass(frozen=True)
class Response:
    """What a record of an experiment would hold: input and output (n,)."""

    u: Array
    y: Array


@dataclass(frozen=True)
class Setup:
    """How an experiment is recorded: like the records of a dataset, from rest at `start` (SI) at
    `time` [s]; in a `loop` that follows a reference, or in open loop.
    """

    grid: Grid
    resolution: float
    start: float
    time: float
    loop: Loop | None = None
    input_ends: tuple[float, float] = (-np.inf, np.inf)  # of a loop: what it may drive with

    @property
    def initial(self) -> Array:
        """Position and velocity at the beginning (1, 2)."""
        return np.array([[self.start, 0.0]])

    def drive(self, values: Mapping[str, float]) -> tuple[float, float, float, float]:
        """Return the input of the loop by error and by its rate, and its ends."""
        assert self.loop is not None
        return (*self.loop.gains(values["J"], values["b"]), *self.input_ends)

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

    def response(
        self, given: Array, setup: Setup, values: Mapping[str, float] | None = None
    ) -> Response | None:
        """Return its response to an input or, in a loop, to a reference (n,) from rest, with its
        own values or others; None if the simulation fails.
        """
        values = self.fit.values if values is None else values
        found = self._responses(given, setup, values, np.zeros((len(given), 1)))
        return found[0] if found else None

    def disturbed(self, given: Array, setup: Setup, draws: int) -> list[Response] | None:
        """Return the same under so many disturbances as large as that of the records."""
        rng, gain = np.random.default_rng(0), self.fit.values["b"]
        shaken = [
            disturbance(len(given), self.fit.noise, gain, setup.grid.h, rng) for _ in range(draws)
        ]
        return self._responses(given, setup, self.fit.values, np.column_stack(shaken))

    def _responses(
        self, given: Array, setup: Setup, values: Mapping[str, float], added: Array
    ) -> list[Response] | None:
        """Return the responses with what is added (n, k) to the input; None if one fails."""
        count = added.shape[1]
        if setup.loop is None:
            outputs = [
                self._simulator(given + each, setup).run(values, setup.initial) for each in added.T
            ]
            seen = [Response(given, y[0]) for y, _, good, _ in outputs if good[0]]
        else:
            filled = np.column_stack([added, *[added[:, 0]] * (LANES - count)])
            pairs = np.column_stack([given, np.gradient(given, setup.grid.h)])
            y, u, good = self._simulator(given, setup).follow(
                values, pairs, filled, setup.drive(values)
            )
            seen = [Response(u[:, k], y[:, k]) for k in range(count) if good[k]]
        usable = len(seen) == count and all(np.isfinite(r.y).all() for r in seen)
        return seen if usable else None

    def _simulator(self, u: Array, setup: Setup) -> Simulator:
        blank = Piece(
            "experiment",
            setup.time,
            u,
            np.zeros((1, len(u))),
            setup.initial,
            np.ones((1, 2)),
            setup.grid.h * len(u),
        )
        return self.fit.simulator.over(
            Segments(setup.grid.h, 1, len(u), setup.grid.velocity, (blank,))
        )


def lead(truth: Response, rival: Rival, setup: Setup) -> float:
    """Return by how many nats a rival is expected to fall behind the model whose response is
    `truth`.

    Half the squared whitened difference of the outputs that is left when the rival has moved its
    parameters, as far as the records allow, and the initial states of segments; as a segment counts
    in the likelihood, noise included.

    Source: box1967 (discrimination between models by the expected ratio of their likelihoods).
    """
    g = setup.grid
    piece = cut("experiment", setup.time, truth.u, truth.y, g, setup.resolution)
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


def disturbance(n: int, noise: Noise, gain: float, h: float, rng: np.random.Generator) -> Array:
    """Return a fit's disturbance torque (n,) in units of the input, `gain` being torque over it."""
    keep = np.exp(-2 * np.pi * noise.corner * h)
    white = noise.torque * np.sqrt(1 - keep**2) * rng.standard_normal(n)
    return np.asarray(lfilter([1.0], [1.0, -keep], white) / gain)
