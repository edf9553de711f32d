"""Which columns are the motion of one axis, by their values: a velocity is the derivative of a
position, a goal leads it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate

from bristle.common.table import Array

WINDOWS = 200  # parts of a record over which changes are compared
LEAST_WINDOW = 3  # samples of such a part
SAME_CHANGE = 0.995  # least squared correlation of a change and the integral of its rate
SLOPE_TOLERANCE = 0.02  # by which a factor between them may differ from one of units
# of positions over integrals of velocities, in rad, deg, turns, rad/s, deg/s, rpm, m and mm
SLOPES = (
    *(1.0, 1e3, 1e-3, 180 / math.pi, math.pi / 180),
    *(1 / 60, 6.0, math.pi / 30, 1 / (2 * math.pi), 1 / 360),
)
COMPARED_OVER = 10  # samples: over which changes of a goal and of its position are compared
LONGEST_LEAD = 0.5  # s: by which a goal is ahead of its position at most
FOLLOWED = 0.98  # least squared correlation of a position and its goal


@dataclass(frozen=True)
class Kinematics:
    """Columns by what they are: `velocities` and `goals`, each with the position that it belongs
    to.
    """

    velocities: Mapping[str, str]
    goals: Mapping[str, str]

    def quantity(self, name: str) -> str | None:
        """Return "position" or "velocity", or None if the values of a column tell neither."""
        if name in self.velocities:
            return "velocity"
        positions = {*self.velocities.values(), *self.goals}
        return "position" if name in positions else None


NO_KINEMATICS = Kinematics({}, {})


def motion_in(time: Array, columns: Mapping[str, Array]) -> Kinematics:
    """Return what columns (n,) of a record are to each other; `time` (n,) in s."""
    names = [name for name, x in columns.items() if np.isfinite(x).all() and np.ptp(x) > 0.0]
    if len(names) < 2 or len(time) < LEAST_WINDOW * 10:
        return NO_KINEMATICS
    table = np.array([columns[name] for name in names])
    slopes, alike = _against_integrals(time, table)
    natural = np.min(np.abs(np.log(np.abs(slopes) / np.array(SLOPES)[:, None, None])), axis=0)
    found = (alike > SAME_CHANGE) & (natural < SLOPE_TOLERANCE)
    velocities = {}
    for v, name in enumerate(names):
        if found[:, v].any():
            velocities[name] = names[int(np.argmax(np.where(found[:, v], alike[:, v], 0.0)))]
    goals = {}
    for position in dict.fromkeys(velocities.values()):
        for name in names:
            if name not in (*velocities, position) and _leads(
                time, columns[name], columns[position]
            ):
                goals[name] = position
    return Kinematics(velocities, goals)


def _against_integrals(time: Array, table: Array) -> tuple[Array, Array]:
    """Return slopes and squared correlations (columns, columns): of the changes of the first over
    the integrals of the second, from window to window.
    """
    step = np.diff(time)
    integrals = np.cumsum(0.5 * (table[:, 1:] + table[:, :-1]) * step, axis=1)
    width = max(LEAST_WINDOW, len(time) // WINDOWS)
    change = np.diff(table[:, 1::width], axis=1)
    integral = np.diff(integrals[:, ::width], axis=1)
    both = change @ integral.T
    own, other = np.square(change).sum(axis=1), np.square(integral).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.where(both > 0.0, both / other, np.inf)
        alike = np.where(both > 0.0, both**2 / np.outer(own, other), 0.0)
    return np.nan_to_num(slopes, nan=1e300, posinf=1e300), np.nan_to_num(alike)


def _leads(time: Array, goal: Array, position: Array) -> bool:
    """Return whether a column is what a position follows, in the same unit."""
    h = (time[-1] - time[0]) / (len(time) - 1)
    most = min(len(time) // 4, math.ceil(LONGEST_LEAD / h))
    x, y = (each[COMPARED_OVER:] - each[:-COMPARED_OVER] for each in (goal, position))
    lag = int(np.argmax(correlate(y, x, method="fft")[len(x) - 1 : len(x) + most]))
    if lag == 0:
        return False
    x, y = goal[: len(goal) - lag], position[lag:]
    x, y = x - x.mean(), y - y.mean()
    slope = float(x @ y) / (float(x @ x) or 1.0)
    return abs(slope - 1.0) < 0.1 and float(x @ y) ** 2 > FOLLOWED * float(x @ x) * float(y @ y)
