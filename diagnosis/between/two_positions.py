"""Two positions, of motor and load: what their difference shows of the parts between them.

The difference is a function of the load's own motion, d = c + wave of the position + b sat(T) +
T/k, with the torque T that the coupling carries: that of the load's inertia and friction. Play (b)
follows the sign of T, compliance (1/k) its size, an eccentric encoder or wheel the position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from bristle.common.metrics import NORMAL_95
from bristle.common.table import Array
from bristle.diagnosis.answer import BetweenSensors, Estimate
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.sliding.stretches import smooth
from bristle.records.layout import LOAD
from bristle.records.record import Record

LOAD_SMOOTHING = 0.012  # s: half-width of the parabola that gives the motion of the load
# of the mean torque of the load's inertia: its friction, dry and viscous, that are tried
FRICTION_SHARES = (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 16.0)
VISCOUS_SHARES = (0.0, 0.3, 1.0)
SOFT = 0.1  # of the mean torque: where the side of a play is decided by half
CONTACT_SECONDS = 0.05  # s: before and after it, the side of the contact stays the same
# factors on this time and on the torque below: what changes with them is not known any better
OTHER_WAYS = ((0.5, 1.0), (2.0, 1.0), (1.0, 2.0))
CARRIED = 0.3  # of the mean torque: where the parts are in contact
SLOW = 0.02  # of the mean speed: where the direction is
WAVES = 12  # a turn: most of a wave of the position that is tried
ROBUST = 1.5  # deviations from which on a sample counts less
PASSES = 8  # of these weights
PARTS = 60  # of the records whose errors count as independent
CERTAIN = 5.0  # standard deviations by which a part is there
LEAST_STEPS = 0.5  # steps of the coarser sensor: least play or amplitude that is one


@dataclass(frozen=True)
class _Motion:
    """The difference of both positions and the motion of the load, of all records (n,)."""

    apart: Array
    theta: Array
    v: Array
    a: Array
    record: Array
    settling: float  # samples, either way


@dataclass(frozen=True)
class _Fit:
    """A fit of the difference: columns by name, their coefficients and covariance, and the robust
    sum of what is left.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    left: float

    def value(self, name: str) -> tuple[float, float]:
        """Return a coefficient and its standard deviation."""
        k = self.names.index(name)
        return float(self.values[k]), float(math.sqrt(max(self.covariance[k, k], 0.0)))


def between_sensors(model: Model, records: Sequence[Record]) -> BetweenSensors | None:
    """Return what lies between the two positions of records; None where there is but one."""
    if model.load is None:
        return None
    motion = _motion(records)
    step = max(model.resolution or 0.0, *(r.resolution or 0.0 for r in records))
    waves = 0 if model.linear else _waves(motion)
    frictions = list(product(FRICTION_SHARES, VISCOUS_SHARES))
    fits = [_fit(motion, waves, friction) for friction in frictions]
    k = int(np.argmin([each.left for each in fits]))
    others = tuple(_fit(motion, waves, frictions[k], *way) for way in OTHER_WAYS)
    seen = _Seen(fits[k], others, step)
    unit = model.output_unit
    parts = _coupling(seen, unit)
    if waves:
        parts |= _wave(seen, waves, unit)
    rms = float(np.sqrt(np.mean(np.square(motion.apart - np.mean(motion.apart)))))
    return BetweenSensors(parts, rms, fits[k].left, unit)


@dataclass(frozen=True)
class _Seen:
    """The best fit, the same with other samples, and the step of the coarser sensor."""

    best: _Fit
    others: tuple[_Fit, ...]
    step: float

    def value(self, name: str) -> tuple[float, float]:
        """Return a coefficient, and its deviation with what the choice of the samples changes."""
        value, sd = self.best.value(name)
        changed = [other.value(name)[0] - value for other in self.others]
        return value, math.hypot(sd, *changed)

    @property
    def least(self) -> float:
        """Least play or amplitude that is one."""
        return LEAST_STEPS * self.step


def _estimate(value: float, sd: float, unit: str) -> Estimate:
    return Estimate(value, unit, (value - NORMAL_95 * sd, value + NORMAL_95 * sd))


def _coupling(seen: _Seen, unit: str) -> dict[str, dict[str, Estimate]]:
    """Return a play or else a compliance, if they are certain."""
    play, sd = seen.value("play")
    if play > CERTAIN * sd and 2 * play > seen.least:
        return {"backlash": {"play": _estimate(2 * play, 2 * sd, unit)}}
    give, sd = seen.value("give")
    if give <= CERTAIN * sd:
        return {}
    # the frequency of the load behind a motor that is held: sqrt(k/J)/(2 pi), give = J/k
    frequency = 1.0 / (2 * math.pi * math.sqrt(give))
    off = 0.5 * frequency * sd / give
    return {"compliance": {"frequency": _estimate(frequency, off, "Hz")}}


def _wave(seen: _Seen, periods: int, unit: str) -> dict[str, dict[str, Estimate]]:
    """Return amplitude, phase and periods of a wave, if it is certain."""
    (a, sa), (b, sb) = (seen.value(name) for name in ("sine", "cosine"))
    size = math.hypot(a, b)
    sd = math.hypot(a * sa, b * sb) / max(size, 1e-300)
    if size <= max(CERTAIN * sd, seen.least):
        return {}
    found = {
        "amplitude": _estimate(size, sd, unit),
        "phase": _estimate(math.atan2(b, a), sd / size, "rad"),
        "periods": Estimate(float(periods), "1", None),
    }
    return {"eccentric_encoder" if periods == 1 else "transmission_error": found}


def _motion(records: Sequence[Record]) -> _Motion:
    parts = []
    for k, r in enumerate(records):
        load = np.unwrap(r.known[LOAD]) if np.ptp(r.known[LOAD]) > math.pi else r.known[LOAD]
        theta, v, a = (smooth(load, r.h, LOAD_SMOOTHING, order) for order in (0, 1, 2))
        parts.append((r.y - load, theta, v, a, np.full(len(r), k)))
    apart, theta, v, a, record = (np.concatenate(each) for each in zip(*parts, strict=True))
    # whole turns between two counters are no play
    turns = np.round(np.median(apart) / (2 * math.pi)) * 2 * math.pi
    return _Motion(apart - turns, theta, v, a, record, CONTACT_SECONDS / records[0].h)


def _waves(motion: _Motion) -> int:
    """Return the periods a turn of the wave that the difference has most of."""
    left = motion.apart - np.mean(motion.apart)
    best, most = 1, 0.0
    for n in range(1, WAVES + 1):
        columns = np.column_stack([np.sin(n * motion.theta), np.cos(n * motion.theta)])
        columns = columns - columns.mean(axis=0)
        gain = float(np.linalg.lstsq(columns, left, rcond=None)[0] @ (columns.T @ left))
        if gain > most:
            best, most = n, gain
    return best


def _fit(
    motion: _Motion,
    waves: int,
    friction: tuple[float, float],
    settling: float = 1.0,
    carried: float = 1.0,
) -> _Fit:
    """Return the fit for shares of dry and viscous friction in the torque that the coupling
    carries; `settling`, `carried`: factors on what is asked of the samples.
    """
    usual_a = float(np.sqrt(np.mean(np.square(motion.a))))
    usual_v = float(np.sqrt(np.mean(np.square(motion.v))))
    way, (dry, viscous) = np.tanh(motion.v / (SLOW * usual_v)), friction
    torque = motion.a + usual_a * (dry * way + viscous * motion.v / usual_v)
    size = float(np.sqrt(np.mean(np.square(torque))))
    columns: dict[str, Array] = {
        f"offset {k}": (motion.record == k).astype(float) for k in np.unique(motion.record)
    }
    columns |= {"play": np.tanh(torque / (SOFT * size)), "give": torque}
    if waves:
        columns |= {"sine": np.sin(waves * motion.theta), "cosine": np.cos(waves * motion.theta)}
    # a load that flies through its play carries no torque
    side = np.sign(torque) * (np.abs(torque) > carried * CARRIED * size)
    chosen = _settled(side, settling * motion.settling)
    return _fitted({key: x[chosen] for key, x in columns.items()}, motion.apart[chosen])


def _settled(side: Array, samples: float) -> Array:
    """Return where the side (n,) of the contact, 0 for none, stays the same for so many samples
    before and after.
    """
    reach = max(2, round(samples))
    changes = np.flatnonzero(np.diff(side, prepend=np.nan) != 0)
    near = np.zeros(len(side) + 1)
    np.add.at(near, np.maximum(changes - reach, 0), 1.0)
    np.add.at(near, np.minimum(changes + reach, len(side)), -1.0)
    return np.asarray((side != 0) & (np.cumsum(near)[:-1] == 0))


def _fitted(columns: Mapping[str, Array], apart: Array) -> _Fit:
    """Return the robust fit of a difference.

    Source: huber1981 (weights), white1982 (sandwich), kunsch1989 (blocks).
    """
    table = np.column_stack([*columns.values()])
    scale = np.sqrt(np.mean(np.square(table), axis=0)) + 1e-300
    table = table / scale
    weight = np.ones(len(apart))
    values = np.zeros(table.shape[1])
    spread = 1.0
    for _ in range(PASSES):
        by = table * weight[:, None]
        values = np.linalg.lstsq(by.T @ table, by.T @ apart, rcond=1e-10)[0]
        error = apart - table @ values
        spread = 1.4826 * float(np.median(np.abs(error))) + 1e-300
        weight = 1.0 / np.maximum(np.abs(error) / (ROBUST * spread), 1.0)
    by = table * weight[:, None]
    inverse = np.linalg.pinv(by.T @ table, rcond=1e-10)
    scores = [part.sum(axis=0) for part in np.array_split(by * error[:, None], PARTS)]
    covariance = inverse @ (np.array(scores).T @ np.array(scores)) @ inverse
    left = float(np.sqrt(np.sum(weight * error**2) / np.sum(weight)))
    return _Fit(tuple(columns), values / scale, covariance / np.outer(scale, scale), left)
