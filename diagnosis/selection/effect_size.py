"""What an effect is worth: the fall of squared errors, and the density of segments under parameters fitted without them."""

from __future__ import annotations

import numpy as np

from bristle.common.table import Array
from bristle.diagnosis.estimation.likelihood import T_DEGREES_OF_FREEDOM, Fit, Problem
from bristle.diagnosis.estimation.optimiser import damped, refit_initial_states

LEAST_FALL = 1.2  # factor by which an effect must lower the mean squared error
OUTLIER_QUARTILES = 10.0  # times the upper quartile of the segments' squared errors: most that one segment counts for
FOLD_DAMPING = 1e-9  # relative increase of each curvature, so that what one segment alone shows can be solved for


def fall(before: Array, after: Array) -> float:
    """Return by which factor mean squared errors of segments (segments,) fall, with outliers clipped.

    Where a servo sticks and slips, a few segments that diverge by chance make up most of the mean.
    """
    most = OUTLIER_QUARTILES * max(float(np.quantile(after, 0.75)), 1e-300)
    return float(np.minimum(before, most).sum() / np.minimum(after, most).sum())


def predictive_density(held_out: Problem, fit: Fit) -> Array:
    """Return the log predictive density of each segment (segments,) [nats], initial states integrated out; 0 for others.

    Held-out segments take no part in the fit. Each of the others is judged with the parameters that the fit would have without it:
    one Gauss-Newton step from those that it has, by its own scores and information. Parameters that end at a bound stay there.

    Source: stone1974 (cross-validation), pregibon1981 (one step in place of a refit without an observation).
    """
    inside = [i for i, f in enumerate(fit.free) if not f.at_bound(fit.values[f.name])]
    columns = fit.by_parameter[:, :, inside]
    own = np.matmul(columns.transpose(0, 2, 1), fit.elimination.project(columns))
    slopes, weight = fit.slopes[:, inside], fit.weight[:, None]
    rest = damped(fit.information[np.ix_(inside, inside)], FOLD_DAMPING) - weight[:, :, None] * own
    step = -np.linalg.solve(rest, (weight * slopes)[:, :, None])[:, :, 0]
    counted = fit.weight > 0
    scale = T_DEGREES_OF_FREEDOM + fit.white.shape[1] - 2
    misfit = scale / np.where(counted, fit.weight, 1.0)  # and the degrees of freedom
    change = np.einsum("sp,spq,sq->s", step, own, step) - 2 * np.einsum("sp,sp->s", slopes, step)
    without = fit.score - 0.5 * scale * np.log(np.maximum(misfit + change, T_DEGREES_OF_FREEDOM) / misfit)
    return np.asarray(np.where(counted, without, fit.score) + refit_initial_states(held_out, fit).score)
