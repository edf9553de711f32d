"""How visible an effect is: the gap ratio of two records, from the truth itself.

The records are cut into segments of 0.4 s. A model is replayed over each without disturbance, from
the true hidden states; initial position and velocity of each segment are eliminated as nuisances.
The ratio is the mean squared output error of the best base model (inertia, viscous and Coulomb
friction refitted) over that of the true model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from truth import DISPLACEMENT, PERIOD, RESOLUTION, Array, Record, base_friction, replay

LENGTH = round(0.4 / PERIOD)  # samples in a segment
EVERY = 3  # each third segment counts, unless the effect shows in few of them
REPLAY_STEP = 2e-4  # s
NUDGES = (1e-4, 2e-3)  # rad, rad/s: differences for the derivatives
RELATIVE = 2e-3  # the same for parameters
KICKS = (-0.03, 0.03)  # rad/s
ROUNDS = 12
ENOUGH = 2e-3  # relative improvement below which the fit ends


@dataclass(frozen=True)
class Gap:
    """Mean squared output errors [rad2] of base and true model."""

    base_errors: Array  # by segment
    floor_errors: Array

    @property
    def base(self) -> float:
        """Mean squared error of the best model without effect."""
        return float(np.mean(self.base_errors))

    @property
    def floor(self) -> float:
        """Mean squared error of the true model."""
        return float(np.mean(self.floor_errors))

    @property
    def ratio(self) -> float:
        """Base over floor."""
        return self.base / self.floor

    @property
    def typical(self) -> float:
        """Geometric mean over the segments, for which one segment that sticks where it should slip
        counts little.
        """
        return float(np.exp(np.mean(np.log(self.base_errors) - np.log(self.floor_errors))))


class Pieces:
    """Segments of both records, and replays over them."""

    def __init__(self, records: list[Record], every: int = EVERY) -> None:
        self.records = records
        begins = [
            np.arange(LENGTH * (i % every), r.u.size - LENGTH + 1, LENGTH * every)
            for i, r in enumerate(records)
        ]
        self.first = [begin.astype(np.int64) for begin in begins]
        self.states = [r.states[f].copy() for r, f in zip(records, self.first, strict=True)]
        measured = [
            r.theta[f[:, None] + np.arange(LENGTH)]
            for r, f in zip(records, self.first, strict=True)
        ]
        self.measured = np.concatenate(measured) + 0.5 * RESOLUTION  # middle of the count
        self.count = len(self.measured)

    def error(
        self, plant: dict[str, float], nuisance: Array, states: list[Array] | None = None
    ) -> Array:
        """Return measured - replayed (segments x samples); nuisance: segments x (position,
        velocity).
        """
        out, at = [], 0
        for record, first, begin in zip(
            self.records, self.first, states or self.states, strict=True
        ):
            moved = begin.copy()
            part = nuisance[at : at + len(first)]
            moved[:, [0, 4]] += part[:, :1]
            moved[:, [1, 5]] += part[:, 1:]
            out.append(replay(plant, record, first, moved, LENGTH, REPLAY_STEP))
            at += len(first)
        return np.asarray(self.measured - np.concatenate(out))


def _mean_squares(error: Array) -> Array:
    return np.asarray(np.mean(error**2, axis=1))


def _nuisance_slopes(
    pieces: Pieces,
    plant: dict[str, float],
    nuisance: Array,
    error: Array,
    states: list[Array] | None,
) -> Array:
    slopes = np.empty((*error.shape, 2))
    for i, nudge in enumerate(NUDGES):
        moved = nuisance.copy()
        moved[:, i] += nudge
        slopes[..., i] = (error - pieces.error(plant, moved, states)) / nudge
    return slopes


def _solve(slopes: Array, right: Array) -> Array:
    """Return the least-squares solution per segment, slightly damped."""
    normal = np.einsum("ski,skj->sij", slopes, slopes)
    normal += np.eye(2) * (1e-6 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12)
    return np.linalg.solve(
        normal, np.einsum("ski,sk...->si...", slopes, right).reshape(len(right), 2, -1)
    )


def settle(
    pieces: Pieces,
    plant: dict[str, float],
    nuisance: Array,
    states: list[Array] | None = None,
    rounds: int = 4,
) -> tuple[Array, Array]:
    """Fit the nuisances of every segment; return (nuisances, errors). A step that does not improve
    a segment is not taken.
    """
    error = pieces.error(plant, nuisance, states)
    for _ in range(rounds):
        slopes = _nuisance_slopes(pieces, plant, nuisance, error, states)
        step = _solve(slopes, error)[..., 0]
        before = _mean_squares(error)
        for size in (1.0, 0.3):
            trial = nuisance + size * step
            fresh = pieces.error(plant, trial, states)
            better = _mean_squares(fresh) < _mean_squares(error)
            nuisance = np.where(better[:, None], trial, nuisance)
            error = np.where(better[:, None], fresh, error)
        if _mean_squares(error).sum() > (1 - ENOUGH) * before.sum():
            break
    return nuisance, error


def rescue(
    pieces: Pieces,
    plant: dict[str, float],
    nuisance: Array,
    error: Array,
    states: list[Array] | None = None,
) -> Array:
    """Start the nuisances again beside where they ended, for segments that stick or slip against
    the measurement.
    """
    for kick in KICKS:
        trial = nuisance + np.array([0.0, kick])
        trial, fresh = settle(pieces, plant, trial, states, 1)
        better = _mean_squares(fresh) < _mean_squares(error)
        nuisance = np.where(better[:, None], trial, nuisance)
        error = np.where(better[:, None], fresh, error)
    return error


def base_plant(parameters: NDArray[np.float64]) -> dict[str, float]:
    """Return the servo without effect for (log J, a2, log Fc)."""
    J, a2, Fc = math.exp(parameters[0]), float(parameters[1]), math.exp(parameters[2])
    return {"J": J, "a2": a2, "Fc": Fc, **base_friction(J, Fc)}


def _held_states(pieces: Pieces, truth: dict[str, float], plant: dict[str, float]) -> list[Array]:
    """Return the true states with the bristles bent such that they bear the true friction, within
    the level of the model.
    """
    stiffness = (
        truth.get("presliding_stiffness")
        or truth.get("bristle_damping_stiffness")
        or truth.get("sigma0", 0.0)
    )
    second = stiffness * truth.get("presliding_ratio", 0.0)
    held = []
    for states in pieces.states:
        fresh = states.copy()
        force = stiffness * states[:, 2] + second * states[:, 3]
        if truth.get("regular"):
            force = truth["Fc"] * states[:, 1] / (np.abs(states[:, 1]) + truth["regular"])
        fresh[:, 2] = np.clip(force / plant["sigma0"], -DISPLACEMENT, DISPLACEMENT)
        held.append(fresh)
    return held


def _global_step(
    pieces: Pieces, truth: dict[str, float], x: Array, nuisance: Array, error: Array
) -> tuple[Array, Array]:
    """Return the Gauss-Newton step of (parameters, nuisances), the latter eliminated segment by
    segment.

    Source: golub1973 (separable least squares), here segment by segment.
    """
    plant = base_plant(x)
    states = _held_states(pieces, truth, plant)
    slopes = _nuisance_slopes(pieces, plant, nuisance, error, states)
    columns = []
    for i, nudge in enumerate((RELATIVE, RELATIVE * truth["a2"], RELATIVE)):
        moved = x.copy()
        moved[i] += nudge
        other = base_plant(moved)
        columns.append(
            (error - pieces.error(other, nuisance, _held_states(pieces, truth, other))) / nudge
        )
    jacobian = np.stack(columns, axis=-1)
    stacked = np.concatenate([error[..., None], jacobian], axis=-1)
    cleaned = stacked - np.einsum("ski,sij->skj", slopes, _solve(slopes, stacked))
    left, right = cleaned[..., 1:].reshape(-1, 3), cleaned[..., 0].reshape(-1)
    scale = np.linalg.norm(left, axis=0) + 1e-300
    step = np.linalg.lstsq(left / scale, right, rcond=1e-6)[0] / scale
    return step, _solve(slopes, error - jacobian @ step)[..., 0]


def fit_base(
    pieces: Pieces, truth: dict[str, float], start: Array | None = None
) -> tuple[Array, Array]:
    """Refit the base model; return (mean squared errors by segment, parameters as in
    `base_plant`).
    """
    x = (
        np.array([math.log(truth["J"]), truth["a2"], math.log(truth["Fc"])])
        if start is None
        else start.copy()
    )
    low = np.array([x[0] - 2.5, 0.0, math.log(1e-3 * truth["Fc"])])
    plant = base_plant(x)
    nuisance, error = settle(
        pieces, plant, np.zeros((pieces.count, 2)), _held_states(pieces, truth, plant), 2
    )
    for _ in range(ROUNDS):
        step, change = _global_step(pieces, truth, x, nuisance, error)
        for size in (1.0, 0.3, 0.05):
            trial = np.maximum(x + size * np.clip(step, [-0.7, -0.1, -0.7], [0.7, 0.1, 0.7]), low)
            plant = base_plant(trial)
            begun = nuisance + size * change
            states = _held_states(pieces, truth, plant)
            fresh_nuisance, fresh = settle(pieces, plant, begun, states, 1)
            if np.mean(fresh**2) < np.mean(error**2):
                break
        else:
            break
        gained = 1 - np.mean(fresh**2) / np.mean(error**2)
        x, nuisance, error = trial, fresh_nuisance, fresh
        if gained < ENOUGH:
            break
    plant = base_plant(x)
    states = _held_states(pieces, truth, plant)
    nuisance, error = settle(pieces, plant, nuisance, states, 3)
    return _mean_squares(rescue(pieces, plant, nuisance, error, states)), x


def floor_errors(pieces: Pieces, truth: dict[str, float]) -> Array:
    """Return the mean squared errors of the true model by segment."""
    nuisance, error = settle(pieces, truth, np.zeros((pieces.count, 2)), rounds=4)
    return _mean_squares(rescue(pieces, truth, nuisance, error))


def measure(
    records: list[Record], truth: dict[str, float], start: Array | None = None, every: int = EVERY
) -> tuple[Gap, Array]:
    """Return the gap, and the refitted base parameters, from which the fit of a similar case may
    start.
    """
    pieces = Pieces(records, every)
    base, x = fit_base(pieces, truth, start)
    return Gap(base, floor_errors(pieces, truth)), x
