"""The servo that is fitted, and its simulation over segments with exact derivatives."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.dataset import Piece, Segments
from bristle.model.native import Native, pointer
from bristle.plant.effects import effect as find_effect
from bristle.plant.servo import LOAD_STARTS, servo_program

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEADERS = {"theta_load": "theta", "v_load": "v"}  # state of the load: state of the motor with which a segment sets it
START_STATES = ("theta_start", "v_start")
LOAD_STATES = tuple(p.name for p in LOAD_STARTS)  # initial states of a load with free play: how far and how much slower it lags
LOAD_SPEED_SHARE = 0.3  # of the rms speed: standard deviation of that lag of a load's speed
LEAST_PLAY = 1e-9  # rad: least half play by which a load's place is divided
OWN_BRISTLES = "bristle_damping"  # effect that gives rigid friction the small deflection of every real servo
BRISTLE_EFFECTS = ("presliding", "bristle_damping")  # effects with a deflection that the sensor resolves
START_FACTOR = 300.0  # largest factor between a positive parameter and its start value
SEARCH_LIMITS = {  # narrower than what can be simulated: what a servo may have
    "stribeck.excess": (0.0, 100.0),
    "compliance.share": (0.02, 0.9),
    "backlash.share": (0.02, 0.9),
    "backlash.dissipation": (1e-3, 1e3),
}


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    """Return the threads that simulate records side by side: compiled code runs outside the interpreter's lock."""
    return ThreadPoolExecutor(os.cpu_count() or 1, "records")


if hasattr(os, "register_at_fork"):  # a forked child has none of its parent's threads, and would wait for them for ever
    os.register_at_fork(after_in_child=_pool.cache_clear)


def play_parameter(effects: Sequence[str]) -> str:
    """Return the parameter that says how far the load behind a coupling can move by itself, or nothing."""
    return next((f"{name}.{find_effect(name).loose}" for name in effects if find_effect(name).loose), "")


@lru_cache(maxsize=256)  # four rounds of all effects
def _compiled(law: str, effects: tuple[str, ...], velocity: bool, base: tuple[str, ...]) -> Native:
    wanted = [*base, *(p.name for name in effects for p in find_effect(name).parameters), *START_STATES]
    wanted += LOAD_STATES if play_parameter(effects) else ()
    observed = "v" if velocity else "theta"
    program = servo_program(law, encoder=False, effects=effects, sensitivities=tuple(wanted), observed=observed)
    return Native(program)


class Simulator:
    """A servo with effects, simulated over segments with exact derivatives.

    Parameters
    ----------
    law : str
        Friction law.
    effects : sequence of str
        Names of effects.
    segments : Segments
        Records to follow.
    base : sequence of str
        Parameters of the servo and its law by which may be differentiated; the effects' are always among them.
    fixed : mapping
        Values of other parameters, such as the internal step.
    """

    def __init__(
        self, law: str, effects: Sequence[str], segments: Segments, base: Sequence[str], fixed: Mapping[str, float]
    ) -> None:
        self.segments, self.effects = segments, tuple(effects)
        self.play = play_parameter(effects)
        self.width = len(START_STATES) + (len(LOAD_STATES) if self.play else 0)
        self._native = _compiled(law, tuple(sorted(effects)), segments.velocity, tuple(base))
        self._natives = [self._native.twin() for _ in segments.pieces]  # its own: another diagnosis may run beside this one
        program = self._native.program
        self.names = program.sensitivities[: -self.width]
        self._v = np.array(program.starts)
        known = {"sample_time": segments.h, "solver.max_step": segments.h, **fixed}
        for name, value in known.items():
            if name in program.index:
                self._v[program.index[name]] = value
        self._places = np.array([program.index[name] for name in self.names])
        states = list(self._native.variant.system.states)
        chosen = ["v"] if segments.velocity else ["theta", "v"]
        follow = [LEADERS.get(name, "") for name in states]
        self._set = np.array([states.index(name) for name in chosen], dtype=np.int32)
        self._column = np.array([len(self.names) + (name == "v") for name in chosen], dtype=np.int32)
        self._leader = np.array([chosen.index(f) if f in chosen else -1 for f in follow], dtype=np.int32)
        self._chosen = slice(1 if segments.velocity else 0, self.width)
        pairs = [(states.index(load), states.index(motor)) for load, motor in LEADERS.items()] if self.play else []
        self._load, self._motor = (np.array([pair[i] for pair in pairs], dtype=np.int32) for i in (0, 1))
        self._apart = len(self.names) + len(START_STATES) + np.arange(len(pairs), dtype=np.int32)
        self._input = np.array([program.index["u"]], dtype=np.int32)
        self._observed = program.index["v" if segments.velocity else "theta"]

    def finer(self) -> Simulator:
        """Return the same with half the step of dry friction and a tenth of the tolerance."""
        other, index = copy(self), self._native.program.index
        other._v = self._v.copy()
        for name, factor in (("solver.friction_step", 0.5), ("solver.tolerance", 0.1)):
            if name in index:
                other._v[index[name]] *= factor
        return other

    def hidden_spread(self, values: Mapping[str, float]) -> Array:
        """Return the standard deviations (width - 2,) of the start states that no sensor shows; all are about zero.

        A load may be anywhere within its play, and beyond it as far as the usual torque bends the contact.
        """
        if not self.play:
            return np.empty(0)
        u, v = self._usual
        bend = abs(values["b"]) * u / self._value(f"{self.play.split('.')[0]}.stiffness", values)
        return np.array([1.0 + bend / self._half(values), LOAD_SPEED_SHARE * v + 1e-9])

    @cached_property
    def _usual(self) -> tuple[float, float]:
        """Root mean squares of the input and of the speeds at the starts of the segments."""
        inputs = np.concatenate([piece.u for piece in self.segments.pieces])
        return float(np.sqrt(np.mean(np.square(inputs)))), float(np.sqrt(np.mean(np.square(self.segments.starts[:, 1]))))

    def _half(self, values: Mapping[str, float]) -> float:
        return max(0.5 * self._value(self.play, values), LEAST_PLAY)

    def _value(self, name: str, values: Mapping[str, float]) -> float:
        return float(values.get(name, self._v[self._native.program.index[name]]))

    def run(self, values: Mapping[str, float], starts: Array, jacobian: bool = False) -> tuple[Array, Array | None, Mask, Array]:
        """Simulate all segments from the given states (segments, width): position, velocity and, of a load that can move by
        itself, how far it is behind (over half the play) and how much slower.

        Where the latter are left out or no numbers, the load carries on from the segment before.

        Returns
        -------
        seen : ndarray, shape (segments, bins)
            Averages of the output.
        derivatives : ndarray, shape (segments, bins, len(names) + width), or None
            By the parameters and by the start states.
        good : ndarray of bool, shape (segments,)
            False where the simulation failed; values there mean nothing.
        starts : ndarray, shape (segments, width)
            The start states as they were.
        """
        pieces = self.segments.pieces
        given = np.full((len(starts), self.width), np.nan)
        given[:, : starts.shape[1]] = starts[:, : self.width]
        if self.play:
            given[:, 2] *= self._half(values)
        begins = np.split(given, np.cumsum([len(piece.seen) for piece in pieces])[:-1])
        together = _pool().map if len(pieces) > 1 else map  # records do not depend on each other

        def one(native: Native, piece: Piece, begin: Array) -> tuple[Array, Array, Mask, Array]:
            return self._piece(native, piece, values, begin, jacobian)

        found = [np.concatenate(parts) for parts in zip(*together(one, self._natives, pieces, begins), strict=True)]
        seen, sens, good, begun = found
        if self.play:
            self._over_play(values, begun, sens if jacobian else None)
        return seen, sens if jacobian else None, good, begun

    def _over_play(self, values: Mapping[str, float], starts: Array, sens: Array | None) -> None:
        """Put a load's place over half the play in place of its place, so that it stays in contact when the play changes."""
        half, place = self._half(values), len(self.names) + 2
        starts[:, 2] /= half
        if sens is not None:
            sens[:, :, self.names.index(self.play)] += 0.5 * sens[:, :, place] * starts[:, 2, None]
            sens[:, :, place] *= half

    def _piece(
        self, native: Native, piece: Piece, values: Mapping[str, float], starts: Array, jacobian: bool
    ) -> tuple[Array, Array, Mask, Array]:
        library, bins = native.library, self.segments.bins
        v, n = self._v.copy(), len(piece.seen)
        for name, value in values.items():
            if name in native.program.index:
                v[native.program.index[name]] = value
        v[native.program.index["u"]] = piece.u[0]
        if not self.segments.velocity:
            v[native.program.index["theta_start"]] = starts[0, 0]
        v[native.program.index["v_start"]] = starts[0, 1]
        native.initialise(v, piece.time)
        seen = np.empty((n, bins))
        sens = np.empty((n, bins, len(self.names) + self.width)) if jacobian else np.empty((n, 0, 0))
        good = np.empty(n, dtype=np.uint8)
        begun = starts.copy()
        chosen = np.ascontiguousarray(starts[:, self._chosen])
        library.batch_segments(
            native.core, ctypes.c_longlong(n), bins, self.segments.width, ctypes.c_double(self.segments.h), 1,
            pointer(self._input), pointer(piece.u), len(self._set), pointer(self._set), pointer(self._column),
            pointer(self._leader), pointer(chosen), len(self._load), pointer(self._load), pointer(self._motor),
            pointer(self._apart), self._observed, pointer(seen), pointer(sens) if jacobian else None, pointer(good),
        )  # fmt: skip
        begun[:, self._chosen] = chosen
        return seen, sens, good.astype(bool), begun


@dataclass(frozen=True)
class Free:
    """A parameter that is fitted: its interval, whether it moves by factors, and (optional) what is known beforehand.

    `nominal`, `doubt`: centre and standard deviation of that knowledge, on the scale it moves on.
    """

    name: str
    low: float
    high: float
    factor: bool = False
    nominal: float | None = None
    doubt: float = 1.0

    @property
    def nominal_value(self) -> float:
        """The prior mean, in its unit."""
        assert self.nominal is not None
        return float(np.exp(self.nominal)) if self.factor else self.nominal

    def scaled(self, value: float) -> float:
        """Return a value on the scale of the parameter's steps: its logarithm if it moves by factors."""
        return float(np.log(value)) if self.factor else value

    def clip(self, value: float) -> float:
        """Return the value moved into the interval."""
        return min(max(value, self.low), self.high)

    def leaves(self, value: float, step: float) -> bool:
        """True if a step from an end of the interval leads out of it."""
        return bool((value <= self.low and step < 0) or (value >= self.high and step > 0))

    def at_bound(self, value: float) -> bool:
        """True at an end of the interval."""
        near = 1e-9 * min(self.high - self.low, abs(self.low) + 1.0), 1e-9 * abs(self.high)
        return bool(value <= self.low + near[0] or value >= self.high - near[1])

    def at_binding_bound(self, value: float) -> bool:
        """True at an end of the interval other than 0, where the parameter is merely absent."""
        return self.at_bound(value) and value != 0.0

    def widened(self, factor: float) -> Free:
        """Return the same with both ends farther out by a factor; an end at 0 stays."""
        low = self.low / factor if self.low > 0 else self.low * factor
        high = self.high * factor if self.high > 0 else self.high / factor
        return replace(self, low=low, high=high)


@dataclass(frozen=True)
class Servo:
    """The model that candidates join: its law, effects, free parameters and everything that stays.

    `rigid`: the set-valued friction has bristles that bend by less than the sensor's step; no model of rigid friction
    agrees with another more closely than that, and without them each effect would be asked to explain it.
    `limits`: how far parameters of effects may move on this axis, where that is less than anywhere; `credible`: beyond these
    intervals an effect must be beyond doubt.
    """

    law: str
    effects: tuple[str, ...]
    base: tuple[str, ...]
    free: tuple[Free, ...]
    fixed: Mapping[str, float]
    rigid: bool
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    credible: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def simulator(self, segments: Segments, more: tuple[str, ...] = ()) -> Simulator:
        """Return a simulator of the servo with more effects added."""
        effects = (*self.effects, *more)
        bent = self.rigid and not set(effects) & set(BRISTLE_EFFECTS)
        return Simulator(self.law, (*effects, OWN_BRISTLES) if bent else effects, segments, self.base, self.fixed)

    def own(self, name: str) -> tuple[Free, ...]:
        """Return the free parameters that stay when an effect joins."""
        return tuple(f for f in self.free if name not in BRISTLE_EFFECTS or not f.name.startswith(f"{OWN_BRISTLES}."))

    def outdone(self, name: str, values: Mapping[str, float]) -> bool:
        """True if an effect brings bristles that are as stiff as the servo's own: what bends no more is no effect."""
        if name not in BRISTLE_EFFECTS or not self.rigid:
            return False
        return values[f"{name}.stiffness"] >= next(f.nominal_value for f in self.free if f.name == f"{OWN_BRISTLES}.stiffness")


def has_free_play(name: str) -> bool:
    """True for a coupling with a load that can move by itself: no two runs of it are the same."""
    return bool(find_effect(name).loose)


def inactive_values(name: str) -> dict[str, float]:
    """Return values at which optional parameters of an effect do nothing."""
    values = {"cogging.amplitude2": 0.0, "cogging.phase2": 0.0, "hard_stop.upper": 1e6, "hard_stop.lower": -1e6}
    effect = find_effect(name)
    forms = {p.name: p.default for p in effect.parameters if p.name.removeprefix(f"{name}.") in effect.bending}
    return {key: value for key, value in (values | forms).items() if key.startswith(f"{name}.")}


def free_parameters(name: str, start: Mapping[str, float], limits: Mapping[str, tuple[float, float]]) -> tuple[Free, ...]:
    """Return the free parameters of an effect: those a start gives, in their intervals and in `limits`."""
    found = []
    for p in find_effect(name).parameters:
        short = p.name.removeprefix(f"{name}.")
        if short not in start:
            continue
        low, high = SEARCH_LIMITS.get(p.name, (p.minimum, p.maximum))
        factor = p.minimum > 0
        if factor:
            low, high = max(low, start[short] / START_FACTOR), min(high, start[short] * START_FACTOR)
        low, high = max(low, limits.get(p.name, (low, high))[0]), min(high, limits.get(p.name, (low, high))[1])
        found.append(Free(p.name, low, high, factor))
    return tuple(found)
