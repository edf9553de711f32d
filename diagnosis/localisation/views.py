"""Views of the motion: functions of position, velocity, input and time, to predict a residual."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.answer import Line
from bristle.diagnosis.estimation.dataset import Motion
from bristle.plant.effects import effect as find_effect

Array = NDArray[np.float64]

VIEW_KNOTS = 9  # knots of a piecewise linear function of a view
# span of records over their total duration, beyond which a tone's phase cannot be followed between
# them
CLOCK_SPAN = 3.0
PATH_POINTS = 5000  # points of the path that hysteresis elements follow, about
PERIOD_TOLERANCE = 0.03  # relative difference up to which two numbers of periods count as equal
FORM_HARMONICS = (2, 3, 4)  # multiples of a wave's periods that count as its form
HYSTERESIS_ELEMENTS = 5  # elastic elements of different widths that make up a hysteresis
# narrowest element and least travel, in steps of the sensor
MIN_WIDTH_STEPS, MIN_TRAVEL_STEPS = 4, 40


@dataclass(frozen=True)
class Share:
    """What a view predicts of a residual."""

    view: str  # the variables that the residual is taken for a function of
    share: float  # share of the residual's power in the output
    p: float  # probability that chance predicts as much in any view
    label: Line = ""  # what was found in it, such as a wave
    alone: float = 1.0  # probability that chance predicts as much in this view alone
    periods: float | None = None  # of the wave that was found along the position [1/turn]
    frequency: float | None = None  # of the wave that was found in time [Hz]

    def period(self, turn: float) -> float | None:
        """Return the length of the wave that was found, in the unit of `turn` or in seconds; None
        without a wave.
        """
        if self.frequency is not None:
            return 1 / self.frequency
        return None if self.periods is None else turn / self.periods


def periods_of(name: str, values: Mapping[str, float], turn: float) -> float | None:
    """Return how often an effect repeats along a path `turn` [rad]; None if it does not."""
    effect = find_effect(name)
    periods = 1.0 if effect.once_per_turn else values.get(f"{name}.{effect.periods}")
    return None if periods is None else periods * turn / (2 * math.pi)


def is_same(periods: float | None, wave: float) -> bool:
    """True if two waves along the same path have the same number of periods; None is no wave."""
    return periods is not None and abs(periods / wave - 1) < PERIOD_TOLERANCE


def is_form(periods: float | None, wave: float) -> bool:
    """True if the number of periods is a small multiple of a wave's, so maybe a harmonic."""
    return periods is not None and any(is_same(periods, k * wave) for k in FORM_HARMONICS)


def hats(x: Array, knots: int = VIEW_KNOTS) -> Array:
    """Return piecewise linear functions (n, knots) that add up to one, knots where the data are."""
    at = np.unique(np.quantile(x, np.linspace(0.005, 0.995, knots)))
    if len(at) < 2:
        return np.ones((len(x), 1))
    inside = np.clip(x, at[0], at[-1])
    return np.column_stack([np.interp(inside, at, np.eye(len(at))[i]) for i in range(len(at))])


def hysteresis(theta: Array, record: NDArray[np.int_], widths: Array) -> Array:
    """Return the deflections (n, widths) of elastic elements that slide beyond a width, scaled to
    -1..1.

    They are computed at some thousand points of the path and held between them.
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
    return np.column_stack(
        [wave(k * angle) for k in range(1, count + 1) for wave in (np.sin, np.cos)]
    )


def bases(m: Motion, h: float, step: float) -> dict[str, Array]:
    """Return functions (n, k) of each view; `step` is the step of the sensor [rad]."""
    way = np.sign(m.v)[:, None]
    du = np.diff(m.u, prepend=m.u[0]) / h
    turn = np.column_stack([harmonics(m.theta, 3), hats(m.theta)])
    widths = np.geomspace(
        MIN_WIDTH_STEPS * step,
        max(0.2 * np.ptp(m.theta), MIN_TRAVEL_STEPS * step),
        HYSTERESIS_ELEMENTS,
    )
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
        "history": hysteresis(m.theta, m.record, widths),
    }


def clocks(m: Motion) -> NDArray[np.int_]:
    """Return for each sample (n,) the number of its clock: 0 where the records share one, else that
    of its record.

    They do not if their times overlap, as those of files that each begin at 0 do, or if they are so
    far apart that the phase of a tone cannot be followed from one to the next.
    """
    ends = sorted(
        (float(t[0]), float(t[-1]))
        for t in (m.time[m.record == k] for k in range(int(m.record.max()) + 1))
    )
    apart = all(before[1] < after[0] for before, after in pairwise(ends))
    together = apart and ends[-1][1] - ends[0][0] < CLOCK_SPAN * sum(
        last - first for first, last in ends
    )
    return np.zeros_like(m.record) if together else m.record
