"""What an effect is worth: the fall of squared errors, and the density of segments under parameters
fitted without them.
"""

from __future__ import annotations

import numpy as np

from bristle.common.table import Array
from bristle.diagnosis.estimation.likelihood import Fit, Problem
from bristle.diagnosis.estimation.optimiser import damped, gradient_of, refit_initial_states

LARGEST_FALL = 10.0  # most that the error of one segment counts as lowered, or raised, by
# times the upper quartile of the segments' squared errors: most that one segment counts for
OUTLIER_QUARTILES = 10.0
# relative increase of each curvature, so that what one segment alone shows can be solved for
FOLD_DAMPING = 1e-9


def fall(before: Array, after: Array, acts: Array) -> float:
    """Return by which factor the mean squared errors of segments (segments,) fall on average,
    weighted by `acts`.

    `acts`: how much the prediction of each segment changes. A stop that is met in one segment is as
    large as a cogging in all of them; and where a servo sticks and slips, a few segments that
    diverge by chance would make up most of a ratio of sums.
    """
    tiny = np.finfo(float).tiny
    falls = np.clip(
        np.maximum(before, tiny) / np.maximum(after, tiny), 1.0 / LARGEST_FALL, LARGEST_FALL
    )
    return float(np.average(falls, weights=acts)) if acts.any() else 1.0


def fall_in_all(before: Array, after: Array) -> float:
    """Return by which factor mean squared errors of segments (segments,) fall, with outliers
    clipped.

    Where a servo sticks and slips, a few segments that diverge by chance make up most of the mean.
    """
    most = OUTLIER_QUARTILES * max(float(np.quantile(after, 0.75)), 1e-300)
    return float(np.minimum(before, most).sum() / np.minimum(after, most).sum())


def gain_error(gains: Array) -> float:
    """Return the standard error of the sum of gains of segments (segments,), by those that lose.

    Chance alone gives either sign alike, so that the losses say how large its gains are too. What
    an effect gains in few segments, such as a stop that is met once, does not count against it.
    """
    losses = np.minimum(gains, 0.0)
    return float(np.sqrt(2.0 * np.square(losses).sum()))


def predictive_density(held_out: Problem, fit: Fit) -> Array:
    """Return the log predictive density of each segment (segments,) [nats], initial states
    integrated out; 0 for others.

    Held-out segments take no part in the fit. Each of the others is judged with the parameters that
    the fit would have without it, and what it would then not know of them. Parameters that end at a
    bound stay there.

    Source: stone1974 (cross-validation).
    """
    inside = [i for i, f in enumerate(fit.free) if not f.at_bound(fit.values[f.name])]
    columns, weight = fit.by_parameter[:, :, inside], fit.weight[:, None]
    own = weight[:, :, None] * np.matmul(
        columns.transpose(0, 2, 1), fit.elimination.project(columns)
    )
    anywhere = np.diag([fit.free[i].precision for i in inside])
    information = damped(fit.information[np.ix_(inside, inside)], FOLD_DAMPING) + anywhere
    lost = left_out_loss(own, weight * fit.slopes[:, inside], gradient_of(fit)[inside], information)
    return np.asarray(
        np.where(fit.weight > 0, fit.score - lost, fit.score)
        + refit_initial_states(held_out, fit).score
    )


def left_out_loss(own: Array, pull: Array, gradient: Array, information: Array) -> Array:
    """Return how much likelier each segment is in the common fit than under what the others say
    (segments,) [nats].

    The parameters are integrated out, so that what a segment alone shows costs the size of the
    interval where it was looked for, and not what a wrong guess would. `own` (segments, k, k),
    `pull` (segments, k): information and gradient of each segment at the fit; `information` (k, k),
    `gradient` (k,): those of all, prior knowledge included.

    Source: tierney1986 (integrals by the curvature at their maxima).
    """
    rest = information - own
    others = gradient - pull
    drawn = np.einsum("sp,sp->s", others, np.linalg.solve(rest, others[:, :, None])[:, :, 0])
    wider = np.linalg.slogdet(information)[1] - np.linalg.slogdet(rest)[1]
    return np.asarray(0.5 * (drawn - gradient @ np.linalg.solve(information, gradient) + wider))
