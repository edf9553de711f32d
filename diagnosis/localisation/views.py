"""Views of the motion: functions of position, velocity, input and time that may predict a residual."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.dataset import Motion
from bristle.plant.effects import effect as find_effect

Array = NDArray[np.float64]
VIEW_KNOTS = 9
CLOCK_SPAN = 3.0  # times what they last in all: records of one clock that lie over a longer time lie far apart
PATH_POINTS = 5000  # of the path, for them
PERIOD_TOLERANCE, FORM_HARMONICS = 0.03, (2, 3, 4)  # periods that count as equal; multiples that are the form of a wave
HYSTERESIS_ELEMENTS = 5  # widths of elastic elements that make up a hysteresis


@dataclass(frozen=True)
class Share:
    """What a view predicts: share of the squared error that falls, its p over all views and alone, and a label.

    `periods`: of the wave along the position that was found in it [1/turn]; `frequency`: of one in time [Hz].
    """

    view: str
    share: float
    p: float
    label: str = ""
    alone: float = 1.0
    periods: float | None = None
    frequency: float | None = None

    def period(self, turn: float) -> float | None:
        """Return the length of the wave that was found in it, in the unit of `turn` or in seconds; None without a wave."""
        if self.frequency is not None:
            return 1 / self.frequency
        return None if self.periods is None else turn / self.periods


@dataclass(frozen=True)
class View:
    """Share of the residual's power in the output that is predictable from a view, before and after, each with its p.

    `label` says what was found in it, such as "7 in a turn"; `before` and `after`, shape (lines, bins), are
    residual torques [N.m; N on a linear axis] in the bins of `centres` (bins,) [SI]; the `lines` have names, such as forward
    and backward for views with a direction. Shares are of 1. With a `period` [unit of the axis] its periods are laid over
    each other.
    """

    view: str
    share: float
    p: float
    share_after: float
    p_after: float
    label: str = ""
    centres: Array = field(default_factory=lambda: np.empty(0))
    before: Array = field(default_factory=lambda: np.empty(0))  # (lines, bins)
    after: Array = field(default_factory=lambda: np.empty(0))
    lines: tuple[str, ...] = ()
    period: float | None = None


def periods_of(name: str, values: Mapping[str, float], turn: float) -> float | None:
    """Return how often an effect repeats along a path `turn` [rad]; None if it does not."""
    effect = find_effect(name)
    periods = 1.0 if effect.once_per_turn else values.get(f"{name}.{effect.periods}")
    return None if periods is None else periods * turn / (2 * math.pi)


def is_same(periods: float | None, wave: float) -> bool:
    """True if something repeats as a wave does, both along the same path."""
    return periods is not None and abs(periods / wave - 1) < PERIOD_TOLERANCE


def is_form(periods: float | None, wave: float) -> bool:
    """True if something repeats as a small multiple of a wave: what the wave's own form may have beside a sine."""
    return periods is not None and any(is_same(periods, k * wave) for k in FORM_HARMONICS)


def hats(x: Array, knots: int = VIEW_KNOTS) -> Array:
    """Return piecewise linear functions (n, knots) that add up to one, with knots where the data are."""
    at = np.unique(np.quantile(x, np.linspace(0.005, 0.995, knots)))
    if len(at) < 2:
        return np.ones((len(x), 1))
    inside = np.clip(x, at[0], at[-1])
    return np.column_stack([np.interp(inside, at, np.eye(len(at))[i]) for i in range(len(at))])


def stops(theta: Array, record: NDArray[np.int_], widths: Array) -> Array:
    """Return elastic elements (n, widths) that slide beyond a deflection, scaled to -1..1.

    Some thousand points of the path say enough; between them the elements stand still.

    Source: albender2005 (hysteresis as parallel elasto-slide elements).
    """
    skip = max(1, len(theta) // PATH_POINTS)
    some = theta[::skip]
    step = np.diff(some, prepend=some[0])
    step[np.flatnonzero(np.diff(record[::skip], prepend=record[0]))] = 0.0
    z, out = np.zeros(len(widths)), np.empty((len(some), len(widths)))
    for k, move in enumerate(step.tolist()):
        z = np.clip(z + move, -widths, widths)
        out[k] = z
    return np.repeat(out / widths, skip, axis=0)[: len(theta)]


def harmonics(angle: Array, count: int) -> Array:
    return np.column_stack([wave(k * angle) for k in range(1, count + 1) for wave in (np.sin, np.cos)])


def bases(m: Motion, h: float, step: float) -> dict[str, Array]:
    """Return functions (n, k) of each view; `step` is the step of the sensor [rad]."""
    way = np.sign(m.v)[:, None]
    du = np.diff(m.u, prepend=m.u[0]) / h
    turn = np.column_stack([harmonics(m.theta, 3), hats(m.theta)])
    widths = np.geomspace(4 * step, max(0.2 * np.ptp(m.theta), 40 * step), HYSTERESIS_ELEMENTS)
    span = np.column_stack([np.ones_like(m.u), m.u, np.abs(m.u)])
    return {
        "v": hats(m.v, 13),
        "u": hats(m.u, 13),
        "du": hats(du),
        "t": hats(m.time, 21),
        "theta": turn,
        "theta x direction": way * turn,
        "theta x u": m.u[:, None] * harmonics(m.theta, 4),
        "t x direction": way * hats(m.time),
        "t x v": m.v[:, None] * hats(m.time),
        "u x direction": way * np.column_stack([span, hats(np.abs(m.u))]),
        "v x u": m.v[:, None] * np.column_stack([span, hats(np.abs(m.u), 5)]),
        "history": stops(m.theta, m.record, widths),
    }


def clocks(m: Motion) -> NDArray[np.int_]:
    """Return for each sample (n,) the number of its clock: 0 where the records share one, else that of its record.

    They do not if their times overlap, as those of files that each begin at 0 do; and how a tone goes on from one to the next
    nobody can tell where they lie far apart.
    """
    ends = sorted((float(t[0]), float(t[-1])) for t in (m.time[m.record == k] for k in range(int(m.record.max()) + 1)))
    apart = all(before[1] < after[0] for before, after in pairwise(ends))
    together = apart and ends[-1][1] - ends[0][0] < CLOCK_SPAN * sum(last - first for first, last in ends)
    return np.zeros_like(m.record) if together else m.record
