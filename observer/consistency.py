"""How far an estimator is off compared with what it claims: its estimates must move as much as
their variance allows.

If the innovations of a least-squares estimator are white and of the variance that it assumes, an
estimate moves over any stretch of time by a random amount whose variance is what its own variance
loses in that stretch. If they are not (a disturbance torque, a model that is not quite right), the
estimates move more. The ratio of the two, averaged over blocks that are longer than the innovations
are correlated, is the factor by which the true variance exceeds the claimed one. Source: mehra1970
(innovations as a test of the filter); flyvbjerg1989 (means of blocks, for correlated data).
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, State
from bristle.observer.method import stack, unstack, vector_states

SX = ca.SX
BLOCK_TIME = 1.0  # s of a block
REMEMBERED_BLOCKS = 15.0  # blocks that the average reaches back
BLOCKS_AT_START = 1.0  # blocks that the ratio 1 at the start counts for
LARGEST_RATIO = 1e9
LEAST_VARIANCE = 1e-300  # keeps a division defined where nothing is learnt


def states(count: int, prefix: str = "") -> tuple[State, ...]:
    """Declare what is kept of `count` estimates."""
    moved = "squared movement of an estimate in a block over the variance it lost there, averaged"
    return (
        *vector_states(f"{prefix}excess", "1", moved, count, 1.0),
        *vector_states(f"{prefix}block_loss", "1", "variance lost since the block began", count),
        *vector_states(f"{prefix}block_start", "1", "estimate when the block began", count),
    )


def advance(p: Namespace, estimate: SX, lost: SX, age: SX, time: SX, runs: SX) -> dict[str, SX]:
    """Return the next states after a sample.

    `estimate`: the estimates after it; `lost`: how much variance the sample took from each; `age`,
    `time`: how long the estimator has run before it, and how much of this sample counts (s); where
    it does not `run`, everything starts anew.
    """
    return blocks(p, estimate, lost, (age, time, runs))


def blocks(
    p: Namespace,
    estimate: SX,
    lost: SX,
    clock: tuple[SX, SX, SX],
    at_start: float = BLOCKS_AT_START,
    prefix: str = "",
) -> dict[str, SX]:
    """Do the same with `clock` = (age, time, runs) and another weight of ratio 1 at the start."""
    n, (age, time, runs) = estimate.numel(), clock
    end = ca.logic_or(
        ca.logic_not(runs), ca.floor(age / BLOCK_TIME) != ca.floor((age + time) / BLOCK_TIME)
    )
    total = stack(p, f"{prefix}block_loss", n) + lost
    start, excess = stack(p, f"{prefix}block_start", n), stack(p, f"{prefix}excess", n)
    weight = 1 / ca.fmin(age / BLOCK_TIME + at_start, REMEMBERED_BLOCKS)
    ratio = ca.fmin((estimate - start) ** 2 / ca.fmax(total, LEAST_VARIANCE), LARGEST_RATIO)
    return {
        **unstack(
            f"{prefix}excess",
            ca.if_else(runs, ca.if_else(end, excess + weight * (ratio - excess), excess), 1),
        ),
        **unstack(f"{prefix}block_loss", ca.if_else(end, 0, total)),
        **unstack(f"{prefix}block_start", ca.if_else(end, estimate, start)),
    }


def inflation(p: Namespace, count: int, prefix: str = "", least: float = 1.0) -> SX:
    """Return the factors by which the standard deviations exceed the claimed ones; of their squares
    none is below `least`.
    """
    return SX(ca.sqrt(ca.fmax(stack(p, f"{prefix}excess", count), least)))
