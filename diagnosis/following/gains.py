"""The controller between a recorded goal and a measured input: its gains, by regression.

The input that a controller asked for is known where a current or torque was measured beside the
goal, so that its law is linear in its gains; the servo itself plays no part.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from bristle.common.metrics import NORMAL_95
from bristle.common.table import Array
from bristle.diagnosis.answer import Estimate, SeenController
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.sliding.stretches import Stretches, integral, stretches_of
from bristle.diagnosis.sliding.torque import driving_input
from bristle.plant.controller import CONTROLLER
from bristle.records.layout import GOAL
from bristle.records.record import Record

CONTROLLER_LAGS = (0.0, 1e-3, 2e-3, 4e-3, 8e-3)  # s: of the position that the controller sees
CONTROLLER_DELAYS = (0, 1, 2)  # samples from what the controller sees to the input that it asks for
# a large input, as a quantile; from which share of it on an input may be at the limit; and by how
# much the law asks for more there where it is
LARGE_INPUT, NEAR_LIMIT, ASKED_BEYOND = 0.995, 0.97, 1.05
LEAST_PIECE = 20  # samples between two moments at the limit
# of the squares that are left: lags and delays with as much count as well as the best, and a
# further part of a controller leaves less
NEARLY_AS_WELL = 1.5
# of the squares left: with P and D action alone both ways of a lag have the same law, and in most
# drives the velocity alone lags
LATE_PRICE = 1.01
AHEAD = "ahead"  # samples by which the goal's rate leads that of the last two samples
# settings of the law between which each part acts with a gain of 1
ONES: Mapping[str, tuple[Mapping[str, float], Mapping[str, float]]] = {
    "kp": ({"kp": 1.0}, {}),
    "weight": ({"kp": 1.0, "weight": 2.0}, {"kp": 1.0}),
    "kd": ({"kd": 1.0}, {}),
    "ki": ({"ki": 1.0}, {}),
    "forward": ({"kd": 1.0, "forward": 1.0}, {"kd": 1.0}),
    AHEAD: ({"kd": 1.0, "forward": 1.0}, {"kd": 1.0}),  # of it, the change to the next sample
    "friction": ({"friction": 1.0}, {}),
}
IDLE = {"weight": 1.0}  # of a part that is not there; 0 of the others
# weights, and the gains that they are relative to
RELATIVE_TO = {"forward": "kd", AHEAD: "forward", "weight": "kp"}
WAYS = tuple(product(CONTROLLER_LAGS, (True, False), CONTROLLER_DELAYS))
TINY_SHARE = 1e-12  # of the input's power: least that is left
GAIN_PARTS = 60  # of the records whose errors count as independent
# what is added to a proportional controller, one after the other, each as far as it shows
FURTHER_PARTS = (("kd",), ("kd", "forward"), (AHEAD,), ("ki",), ("weight",), ("friction",))


@dataclass(frozen=True)
class _Law:
    """A controller of some parts, fitted: gains (k,) of its columns, their covariance, and the sum
    of squares that is left.
    """

    parts: tuple[str, ...]
    lag: float
    late: bool  # whether all that the controller sees lags, or its velocity alone
    delay: int
    gains: Array
    covariance: Array
    left: float


def seen_controller(model: Model, records: Sequence[Record]) -> SeenController | None:
    """Return the controller between goal and input; None where no goal was recorded."""
    if model.goal is None:
        return None
    recorded = _Recorded.of(model, records)
    if not recorded.power:  # an input that is nowhere off its limit
        return SeenController({}, 0.0, 0.0, 0.0, model.output_kind)
    best = recorded.likeliest(())
    while True:
        longer = [
            recorded.likeliest({*best.parts, *more})
            for more in FURTHER_PARTS
            if set(more) - set(best.parts)
        ]
        longer = [law for law in longer if NEARLY_AS_WELL * law.left < best.left]
        if not longer:
            break
        best = min(longer, key=lambda law: law.left)
    # what stood in for a part that was added after it
    idle = {
        name
        for name, each in _gains(model, recorded, best).items()
        if _is_within(IDLE.get(name, 0.0), each)
    }
    best = recorded.likeliest(set(best.parts) - idle) if idle else best
    return _seen(model, recorded, recorded.refined(best))


def _seen(model: Model, recorded: _Recorded, law: _Law) -> SeenController:
    gains = _gains(model, recorded, law)
    if "kd" in gains:
        gains.setdefault("forward", Estimate(0.0, "1", None))
    if recorded.asked_beyond(law) > ASKED_BEYOND:
        gains["limit"] = Estimate(recorded.large, model.input_unit, None)
    share = 1.0 - law.left / recorded.power
    return SeenController(gains, share, law.lag, law.delay * recorded.h, model.output_kind)


def _gains(model: Model, recorded: _Recorded, law: _Law) -> dict[str, Estimate]:
    """Return the gains of a law, with the intervals of all lags and delays that explain the input
    nearly as well: which of them the controller has is not seen.
    """
    units = {name: _unit(model, name) for name in law.parts}
    near = [each for each in recorded.laws(law.parts) if each.left < NEARLY_AS_WELL * law.left]
    gains = _estimates(law, units)
    for other in (_estimates(each, units) for each in near):
        gains = {name: _with(gains[name], other[name]) for name in gains}
    return gains


def _is_within(value: float, estimate: Estimate) -> bool:
    assert estimate.ci95 is not None
    return estimate.ci95[0] <= value <= estimate.ci95[1]


def _estimates(law: _Law, units: Mapping[str, str]) -> dict[str, Estimate]:
    """Return the gains of a law; weights are relative to the gain beside which they stand."""
    values, found = dict(zip(law.parts, law.gains.tolist(), strict=True)), {}
    for k, name in enumerate(law.parts):
        value, slope = values[name], np.eye(len(law.parts))[k]
        if name in RELATIVE_TO:
            over = values[RELATIVE_TO[name]] or math.inf
            slope = slope / over
            slope[law.parts.index(RELATIVE_TO[name])] = -value / over**2
            value = value / over + (1.0 if name == "weight" else 0.0)
        width = NORMAL_95 * math.sqrt(float(slope @ law.covariance @ slope))
        found[name] = Estimate(value, units[name], (value - width, value + width))
    return found


def _with(one: Estimate, other: Estimate) -> Estimate:
    """Return an estimate with the interval of another too."""
    assert one.ci95 is not None
    assert other.ci95 is not None
    ends = min(one.ci95[0], other.ci95[0]), max(one.ci95[1], other.ci95[1])
    return replace(one, ci95=ends)


def _unit(model: Model, name: str) -> str:
    """Return the unit of a gain, for the input that was measured."""
    if name == AHEAD:
        return "1"
    [parameter] = [p for p in CONTROLLER.parameters if p.name == f"{CONTROLLER.name}.{name}"]
    unit = parameter.unit.replace("N.m", model.input_unit)
    return unit.replace("rad", "m") if model.linear else unit


@dataclass(frozen=True)
class _Recorded:
    """Goal, position and input of all records, one after the other.

    `piece` (samples,): number of the stretch away from the limit, -1 where none counts.
    """

    h: float
    u: Array
    over: Stretches
    piece: NDArray[np.int_]
    large: float
    known: dict[tuple[float, bool, int], Array] = field(default_factory=dict)  # as `_products`

    @classmethod
    def of(cls, model: Model, records: Sequence[Record]) -> _Recorded:
        """Return what records hold; of velocities, their integrals."""
        h, resolution = records[0].h, max(r.resolution or model.resolution or 0.0 for r in records)
        velocity = model.output_kind == "velocity"
        shown = [(r.time, r.known[GOAL], r.y) for r in records]
        if velocity:
            shown = [(t, integral(goal, h), integral(y, h)) for t, goal, y in shown]
            resolution *= h
        over = stretches_of(shown, h, False, resolution)
        u = np.concatenate([r.u for r in records])
        large = float(np.quantile(np.abs(u), LARGE_INPUT))
        outside = np.abs(u) >= NEAR_LIMIT * large
        number = np.cumsum(np.diff(outside.astype(int) + 2 * over.record, prepend=0) != 0)
        count = np.bincount(number)
        piece = np.where(outside | (count[number] < LEAST_PIECE), -1, number)
        return cls(h, u, over, piece, large)

    @property
    def power(self) -> float:
        """Sum of squares of the input, its means over the pieces taken out."""
        return float(self._products(*WAYS[0])[:, -1, -1].sum())

    def laws(self, parts: Collection[str]) -> list[_Law]:
        """Return the laws of a proportional controller with these parts, of all lags and delays."""
        names = list[str]()
        for name in ONES:  # each after what it is relative to
            if name in {"kp", *parts} and RELATIVE_TO.get(name, "kp") in {"kp", *names}:
                names.append(name)
        return [self._fitted(tuple(names), *way) for way in WAYS]

    def likeliest(self, parts: Collection[str]) -> _Law:
        """Return the likeliest of them."""
        return min(self.laws(parts), key=lambda law: law.left * (LATE_PRICE if law.late else 1.0))

    def refined(self, law: _Law) -> _Law:
        """Return a law with the likeliest lag between the neighbours of its own."""
        ends = [0.0, *CONTROLLER_LAGS, CONTROLLER_LAGS[-1]]
        k = 1 + CONTROLLER_LAGS.index(law.lag)

        def at(lag: float) -> _Law:
            return self._fitted(law.parts, float(lag), law.late, law.delay)

        found = minimize_scalar(
            lambda lag: at(lag).left, bounds=(ends[k - 1], ends[k + 1]), method="bounded"
        )
        return min(law, at(found.x), key=lambda each: each.left)

    def asked_beyond(self, law: _Law) -> float:
        """Return how much of a large input the law asks for there, median."""
        columns = self._columns(law.parts, law.lag, law.late)
        left = self.u - np.roll(columns @ law.gains, law.delay)
        used = np.flatnonzero(self.piece >= 0)
        beside = np.flatnonzero(np.abs(self.u) >= NEAR_LIMIT * self.large)
        if not (len(used) and len(beside)):
            return 0.0
        # the integral goes on from the piece before
        count = np.maximum(np.bincount(self.piece[used]), 1)
        held = np.bincount(self.piece[used], weights=left[used]) / count
        before = self.piece[used[np.maximum(np.searchsorted(used, beside) - 1, 0)]]
        asked = self.u[beside] - left[beside] + held[before]
        return float(np.median(asked / self.u[beside]))

    def _fitted(self, names: tuple[str, ...], lag: float, late: bool, delay: int) -> _Law:
        products = self._products(lag, late, delay)
        own = [list(ONES).index(name) for name in names]
        blocks, with_input = products[:, own][:, :, own], products[:, own, -1]
        table, slope = blocks.sum(axis=0), with_input.sum(axis=0)
        size = np.sqrt(np.diag(table))
        size[size == 0.0] = 1.0  # a part that never acts
        inverse = np.linalg.pinv(table / np.outer(size, size), hermitian=True)
        inverse = inverse / np.outer(size, size)
        gains = inverse @ slope
        # by the spread of the scores of the blocks
        scores = with_input - blocks @ gains
        left = products[:, -1, -1].sum() - gains @ slope
        return _Law(
            names,
            lag,
            late,
            delay,
            gains,
            covariance=inverse @ scores.T @ scores @ inverse,
            left=max(float(left), TINY_SHARE * float(products[:, -1, -1].sum())),
        )

    def _products(self, lag: float, late: bool, delay: int) -> Array:
        """Return the products (blocks, parts + 1, parts + 1) of what each part of the law asks for
        and of the input, the last, with one another.
        """
        if (lag, late, delay) not in self.known:
            columns = self._columns(list(ONES), lag, late)
            for each in CONTROLLER_DELAYS:
                late_by = np.column_stack([np.roll(columns, each, axis=0), self.u])
                blocks = np.array_split(self._free(late_by), GAIN_PARTS)
                self.known[lag, late, each] = np.array([b.T @ b for b in blocks])
        return self.known[lag, late, delay]

    def _columns(self, names: Sequence[str], lag: float, late: bool) -> Array:
        """Return what the parts of a law ask for (samples, parts), each at a gain of 1."""
        over, found = self._seen(lag, late), []
        for name in names:
            more, less = (_asked({"kp": 0.0, "forward": 0.0, **own}, over) for own in ONES[name])
            part = more - less
            found.append(over.after(part) - part if name == AHEAD else part)
        return np.column_stack(found)

    def _seen(self, lag: float, late: bool) -> Stretches:
        """Return the records as a controller sees them: with the velocity of the last two samples,
        behind a lag.
        """
        keep = math.exp(-self.h / lag) if lag else 0.0
        speed, y = np.zeros_like(self.u), self.over.measured
        for k in range(int(self.over.record[-1]) + 1):
            own = self.over.record == k
            rate = np.diff(y[own], prepend=y[own][0]) / self.h
            speed[own] = lfilter([1 - keep], [1.0, -keep], rate)
        shown = y - lag * speed if late else y
        return replace(self.over, measured=shown, theta=shown, v=speed, a=np.zeros_like(speed))

    def _free(self, columns: Array) -> Array:
        """Return columns (used, k) less their means over each piece."""
        used = np.flatnonzero(self.piece >= 0)
        # the first samples of a record follow from none
        first = np.flatnonzero(np.diff(self.over.record, prepend=-1))
        used = np.setdiff1d(used, np.add.outer(first, np.arange(max(CONTROLLER_DELAYS))).ravel())
        number = self.piece[used]
        count = np.maximum(np.bincount(number), 1)
        means = [np.bincount(number, weights=x) / count for x in columns[used].T]
        return np.asarray(columns[used] - np.stack(means, axis=1)[number])


def _asked(own: Mapping[str, float], over: Stretches) -> Array:
    values = {f"{CONTROLLER.name}.{name}": x for name, x in own.items()}
    return driving_input((CONTROLLER.name,), values, over)
