"""References to choose from for a servo in a position loop: steps of all sizes and speeds, slow
motion and sweeps within the range of the records, and the motion of the records at other paces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bristle.common.table import Array
from bristle.diagnosis.answer import Reason, finding
from bristle.diagnosis.experiment.inputs import (
    DRAWS,
    INPUT_SCALES,
    QUICKER,
    RESTS,
    SHORTEST,
    SWEEP_SHARE,
    USED_RANGE,
    VARIED_DRAWS,
    Input,
    Limits,
    Plan,
    move,
    sweep,
    varied,
)

USED_PEAKS = (0.3, 1.0)  # of the largest speed and acceleration of the records
CREEP_SHARE = 0.15  # of the parts: slow motion at constant speed in place of a step
CREEP_SPEEDS = (0.003, 0.1)  # of the reach, each second
CREEP_SECONDS = 3.0  # s: length of slow motion


def references(
    limits: Limits,
    recorded: Sequence[Array],
    peaks: tuple[float, float],
    samples: tuple[int, float],
) -> list[Input]:
    """Return references (n,) of so many samples of length h [s] to choose from, the same each time,
    given the `recorded` positions, and the largest speed and acceleration among them.
    """
    n, h = samples
    proposed = []
    for seed in range(DRAWS):
        rng = np.random.default_rng(seed)
        drawn = parts(rng, _planned(rng, limits, peaks, h), n)
        proposed.append(Input(finding(Reason.MANY_STEPS), (drawn,)))
    for theta in recorded:
        own = theta - limits.middle
        quick = np.interp(QUICKER * np.arange(int(len(own) / QUICKER)), np.arange(len(own)), own)
        others = [varied(np.random.default_rng(seed), own, n, h) for seed in range(VARIED_DRAWS)]
        for motion, path in (
            (Reason.QUICKENED_INPUT, looped(quick, n)),
            *((Reason.VARIED_INPUT, other) for other in others),
        ):
            scaled = tuple(limits.middle + scale * path for scale in INPUT_SCALES)
            proposed.append(Input(finding(motion), scaled))
    return proposed


def _planned(
    rng: np.random.Generator, limits: Limits, peaks: tuple[float, float], h: float
) -> Plan:
    """Return what parts are drawn within."""
    reach = rng.uniform(*USED_RANGE) * 0.5 * (limits.theta[1] - limits.theta[0])
    speed, acceleration = (rng.uniform(*USED_PEAKS) * peak for peak in peaks)
    return Plan(h, limits.middle, reach, speed, acceleration, rng.uniform(*RESTS))


def looped(path: Array, n: int) -> Array:
    """Return a path (m,) played to and fro for n samples, without jumps."""
    return np.resize(np.concatenate([path, path[::-1]]), n)


def parts(rng: np.random.Generator, plan: Plan, n: int) -> Array:
    """Return steps of all sizes and speeds with rests, slow motion and sweeps between them (n,)."""
    found, at, total = [np.full(round(0.2 / plan.h), plan.middle)], plan.middle, 0
    while total < n:
        size = plan.reach * math.exp(rng.uniform(math.log(SHORTEST), 0.0))
        side = float(rng.choice([-1.0, 1.0]))
        if abs(at + side * size - plan.middle) > plan.reach:
            side = -math.copysign(1.0, at - plan.middle)
        kind = rng.random()
        if kind < SWEEP_SHARE:
            path = sweep(plan)
        elif kind < SWEEP_SHARE + CREEP_SHARE:
            speed = plan.reach * math.exp(rng.uniform(*np.log(CREEP_SPEEDS)))
            count = round(CREEP_SECONDS / plan.h)
            path = np.linspace(0.0, side * speed * CREEP_SECONDS, count)
        else:
            quick = rng.uniform(0.15, 1.0)
            path = move(side * size, quick * plan.speed, quick * plan.acceleration, plan.h)
        rest = np.full(round(plan.rest * rng.uniform(0.5, 1.5) / plan.h), path[-1])
        found.append(at + np.concatenate([path, rest]))
        at, total = float(found[-1][-1]), total + len(found[-1])
    return np.concatenate(found)[:n]
