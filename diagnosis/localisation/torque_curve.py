"""What no effect of the catalogue explains, fitted as a smooth function of one variable: an unnamed
torque with its band.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.answer import TorqueCurve
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import FittedModel, refit_with_noise, under_own_noise
from bristle.diagnosis.estimation.likelihood import FitPoint, squares
from bristle.diagnosis.estimation.optimiser import refit as refit_parameters
from bristle.diagnosis.estimation.optimiser import resume
from bristle.diagnosis.estimation.uncertainty import INTERVAL_FACTOR
from bristle.diagnosis.localisation.residual_localisation import FOLDS, VIEW_RIDGE
from bristle.diagnosis.localisation.residual_response import ResidualResponse
from bristle.plant.unnamed_torque import UNNAMED_KNOTS

# weights of the smoothness that are tried, relative to the data's
SMOOTHNESS = tuple(10.0**k for k in range(-6, 3))
FILL_PASSES = 2  # alternations of the curve and the model's own parameters
RANGE_QUANTILES = (0.005, 0.995)  # of the variable in motion: the range that a curve covers


@dataclass(frozen=True)
class FittedCurve:
    """A model with the curve that explains most of its residual, fitted to training segments."""

    curve: TorqueCurve
    fitted: FittedModel
    before: Array  # (held-out segments,): mean squared errors [output squared] without the curve
    after: Array  # the same with it


@dataclass(frozen=True)
class _Columns:
    """The linear response to the values of a curve, segment by segment, with the residual that they
    are to explain.
    """

    own: Array  # (segments, bins, k)
    target: Array  # (segments, bins)
    weight: Array  # (segments,)

    def normal(self, which: slice | NDArray[np.bool_] = slice(None)) -> tuple[Array, Array]:
        """Return matrix (k, k) and right side (k,) of the least squares over some segments."""
        own, w = self.own[which], self.weight[which]
        gram = np.einsum("s,snk,snl->kl", w, own, own, optimize=True)
        return gram, np.einsum("s,snk,sn->k", w, own, self.target[which], optimize=True)


def _hats(x: Array, low: float, high: float) -> Array:
    """Return the piecewise linear functions (n, UNNAMED_KNOTS) of a curve."""
    places = np.linspace(low, high, UNNAMED_KNOTS)
    inside = np.clip(x, low, high)
    return np.column_stack([np.interp(inside, places, row) for row in np.eye(UNNAMED_KNOTS)])


def _penalty(gram: Array, smoothness: float) -> Array:
    """Return the curvature of the smoothness, on the scale of the data's, and a small ridge for
    what the model could do as well.

    Source: eilers1996 (squares of second differences).
    """
    second = np.diff(np.eye(UNNAMED_KNOTS), 2, axis=0)
    scale = np.trace(gram) / UNNAMED_KNOTS + 1e-300
    return np.asarray(
        scale * (smoothness * second.T @ second + 1e-3 * VIEW_RIDGE * np.eye(UNNAMED_KNOTS))
    )


def _left_out_gain(columns: _Columns, smoothness: float) -> float:
    """Return by how much the log-likelihood of segments rises that are left out of the fit in turn
    [nats].

    Source: stone1974 (cross-validation).
    """
    live = np.flatnonzero(columns.weight > 0)
    fold, gain = np.zeros(len(columns.weight), dtype=int) - 1, 0.0
    fold[live] = np.arange(len(live)) % FOLDS
    for k in range(FOLDS):
        gram, side = columns.normal((fold >= 0) & (fold != k))
        curve = np.linalg.solve(gram + _penalty(gram, smoothness), side)
        held_gram, held_side = columns.normal(fold == k)
        gain += float(held_side @ curve - 0.5 * curve @ held_gram @ curve)
    return gain


def _variables(dataset: Dataset, final: FittedModel) -> dict[str, Array]:
    """Return the variables (samples,) that a curve may be over; none that differs between records
    by an unknown constant.
    """
    m, s = dataset.motion, dataset.segments
    variables = {
        "v": m.v,
        "theta": m.theta,
        "u": m.u,
        "t": dataset.time_at(final.fit.simulator.segments.times),
    }
    several = len(s.pieces) > 1
    unknown = {
        name
        for name, condition in (("theta", s.velocity and several), ("t", s.own_clocks))
        if condition
    }
    taken = {name for name in variables if f"unnamed_torque_{name}" in final.servo.effects}
    return {name: x for name, x in variables.items() if name not in unknown | taken}


def _columns(response: ResidualResponse, hats: Array, values: Array) -> _Columns:
    """Return the response to a curve, of a model that has it with these values already."""
    own = response.free_of_model(response.through(hats))
    return _Columns(own, response.rest + own @ values, response.weight)


def _solved(columns: _Columns) -> tuple[Array, Array, float]:
    """Return values and half the width of their 95 % band (UNNAMED_KNOTS,), smoothed as left-out
    segments ask, and the gain there.

    Source: white1982 (sandwich).
    """
    gain, smoothness = max((_left_out_gain(columns, each), each) for each in SMOOTHNESS)
    gram, side = columns.normal()
    inverse = np.linalg.inv(gram + _penalty(gram, smoothness))
    values = inverse @ side
    scores = columns.weight[:, None] * np.einsum(
        "snk,sn->sk", columns.own, columns.target - columns.own @ values
    )
    spread = np.sqrt(np.maximum(np.diag(inverse @ (scores.T @ scores) @ inverse), 0.0))
    return np.asarray(values), np.asarray(1.96 * INTERVAL_FACTOR * spread), gain


def fitted_curve(dataset: Dataset, final: FittedModel) -> FittedCurve | None:
    """Fit what a model leaves as a smooth function of the variable that predicts most of it in
    left-out segments.

    The curve is a linear regression on the response of the residual, in turn with a refit of the
    model's own parameters by simulation. None where no variable predicts anything. Segments held
    out from the search take no part.
    """
    response = ResidualResponse(final, dataset)
    # the variable whose curve predicts most
    best: tuple[float, TorqueCurve, Array] | None = None
    for variable, x in _variables(dataset, final).items():
        low, high = map(float, np.quantile(x[dataset.motion.moving], RANGE_QUANTILES))
        if not high > low:
            continue
        hats = _hats(x, low, high)
        values, half, gain = _solved(_columns(response, hats, np.zeros(UNNAMED_KNOTS)))
        if gain > (0.0 if best is None else best[0]):
            best = gain, TorqueCurve(variable, low, high, values, half), hats
    if best is None:
        return None
    _, curve, hats = best
    # the curve in turn with the model's own parameters
    servo = replace(final.servo, effects=(*final.servo.effects, curve.effect))
    simulator, fitted = servo.simulator(final.fit.simulator.segments), final
    for k in range(FILL_PASSES):
        if k:
            values, half, _ = _solved(
                _columns(ResidualResponse(fitted, dataset), hats, curve.values)
            )
            curve = replace(curve, values=values, half_width=half)
        known = {
            **fitted.fit.values,
            **{f"{curve.effect}.{name}": x for name, x in curve.parameters.items()},
        }
        point = FitPoint(simulator, servo.free, known, fitted.fit.initial)
        fit = refit_with_noise(dataset, refit_parameters(fitted.problem, point))
        problem = under_own_noise(dataset, fit)
        fitted = FittedModel(servo, problem, resume(problem, fit))
    # what it is worth in the segments held out
    before, after = (squares(each.fit, dataset.held_out) for each in (final, fitted))
    return FittedCurve(curve, fitted, before, after)
