"""Elements side by side, as Maxwell-slip friction has them, by least squares: linear once their distances are chosen.

w = sum w_i, w_i' = [sigma_i0 + sum_j sigma_ij phi_j(v)] v - c_i |v| w_i, with the c_i of a grid. Then w_i = sum_j sigma_ij chi_ij
with chi_ij' = phi_j(v) v - c_i |v| chi_ij, which needs nothing but the velocity; and v' = b u - alpha2 v - w is a regression.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.basis import BASIS_COUNT, gaussian, width_parameter
from bristle.model.variables import Namespace, Parameter
from bristle.observer import rls
from bristle.observer.method import (
    EquationContext,
    Method,
    Sample,
    Update,
    stack,
    stack_symmetric,
    symmetric_states,
    unstack,
    unstack_symmetric,
    vector_states,
)  # fmt: skip

SX = ca.SX
CITATION = "dixit2008 eq. (15) and (17), elements side by side as in iwan1966"
FIT_CITATION = "ljung1999 section 11.2"
GRID = (30.0, 100.0, 300.0)  # 1/rad
WEIGHTS = BASIS_COUNT + 1
CHI = len(GRID) * WEIGHTS
ENTRY_COUNT = 2 + CHI  # alpha2, b, sigma_ij
START_VARIANCES = [1e4] * 2 + [1e8] * CHI  # variances
LARGEST = ENTRY_COUNT * 1e8  # size that forgetting may give the covariance


def _distances(p: Namespace) -> SX:
    return SX(ca.vertcat(*(p[f"c{i}"] for i in range(1, len(GRID) + 1))))


def _relaxed(p: Namespace, s: Sample) -> SX:
    """Advance chi over a sample, exactly at its mean velocity; row by row, an element after the other.

    Source: dixit2008 eq. (17); hochbruck2010 section 2 (exponential step).
    """
    v = (s.y0 + s.y1) / 2
    basis = ca.vertcat(1, *gaussian(v / p.width))
    chi, new = stack(p, "chi", CHI), []
    for i, c in enumerate(ca.vertsplit(_distances(p))):
        travel = ca.fmax(c * ca.fabs(v) * s.period, 1e-9)
        kept = ca.exp(-travel)
        new.append(chi[i * WEIGHTS : (i + 1) * WEIGHTS] * kept + basis * v * s.period * (1 - kept) / travel)
    return ca.vertcat(*new)


def _equations(context: EquationContext, s: Sample) -> Update:
    """Filter v' = -alpha2 v + b u - sum sigma_ij chi_ij on both sides, and fit.

    Source: ljung1999 section 11.2.
    """
    p = context.p
    chi, new = stack(p, "chi", CHI), _relaxed(p, s)
    raw = ca.vertcat((s.y1 - s.y0) / s.period, -(s.y0 + s.y1) / 2, s.u, -(chi + new) / 2)
    gain = 1 - ca.exp(-p.cutoff * s.period)
    once = stack(p, "once", ENTRY_COUNT + 1)
    once_new = once + gain * (raw - once)
    row = stack(p, "twice", ENTRY_COUNT + 1)
    row_new = row + gain * (once_new - row)
    theta, covariance = stack(p, "theta", ENTRY_COUNT), stack_symmetric(p, "cov", ENTRY_COUNT)
    h, error = row_new[1:], row_new[0] - ca.dot(row_new[1:], theta)
    change, covariance_new = rls.least_squares(covariance, h, error, SX(1), p.forgetting, SX(LARGEST))
    levels = theta[2::WEIGHTS] / _distances(p)
    w = ca.dot(theta[2:], chi)
    return Update(
        next={
            **unstack("chi", new),
            **unstack("once", once_new),
            **unstack("twice", row_new),
            **unstack("theta", theta + change),
            **unstack_symmetric("cov", covariance_new),
        },
        estimates={"alpha2": theta[0], "b": theta[1], "Fc": ca.sum1(levels)},
        signals={"v": p.last_y, "w": w, "F": w + theta[0] * p.last_y},
    )


METHOD = Method(
    "parallel_elements",
    f"recursive least squares of alpha2, b and {len(GRID)} friction elements side by side, whose distances are chosen",
    CITATION,
    "y_v",
    (
        *(
            Parameter(f"parallel_elements.c{i}", f"c{i}", "1/rad", c, 1e-6, 1e9, f"inverse distance of element {i}", CITATION)
            for i, c in enumerate(GRID, start=1)
        ),
        Parameter(
            "parallel_elements.cutoff", "a", "rad/s", 150.0, 1e-3, 1e5, "corner of each of two low-pass sections", FIT_CITATION
        ),
        Parameter("parallel_elements.forgetting", "mu", "1", 0.99999, 0.5, 1.0, "forgetting factor a sample", FIT_CITATION),
        width_parameter("parallel_elements"),
    ),
    (
        *vector_states("chi", "1", "filtered basis functions", CHI),
        *vector_states("once", "1", "signals after one section", ENTRY_COUNT + 1),
        *vector_states("twice", "1", "signals after two sections", ENTRY_COUNT + 1),
        *vector_states("theta", "1", "alpha2, b, sigma_ij", ENTRY_COUNT),
        *symmetric_states("cov", "1", "their covariance", ENTRY_COUNT, START_VARIANCES),
    ),
    _equations,
)
