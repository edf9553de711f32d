"""Records cut into short segments, and the simulation of a servo over them."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs

from bristle.model.errors import SimulationError
from bristle.model.native import Native, pointer
from bristle.plant.effects import effect as find_effect
from bristle.plant.servo import LOAD_STARTS, servo_program

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SEGMENT = 0.4  # s: long enough for friction and inertia to show, short enough for a disturbance not to drift away
BINS = 50  # averages a segment: what is faster than 60 Hz in 0.4 s is the resolution's
SMOOTH = 0.02  # s: half-width of the parabola that gives position and velocity at the start of a segment
LEADERS = {"theta_load": "theta", "v_load": "v"}  # the far side of a coupling moves along when a segment starts anew
STARTS = ("theta_start", "v_start")
APART = tuple(p.name for p in LOAD_STARTS)  # of a load that can move by itself: how far it is behind, and how much slower
COASTING = 0.3  # of the usual speed: how much slower a loose load usually is
LEAST_PLAY = 1e-9  # rad


@dataclass(frozen=True)
class Piece:
    """One record as consecutive segments: time of the first sample [s], inputs (segments * bins * width,), measured
    averages (segments, bins), states at the starts (segments, 2) with their standard deviations."""

    name: str
    time: float
    u: Array
    seen: Array
    starts: Array
    spread: Array


@dataclass(frozen=True)
class Segments:
    """All records as segments of `bins` averages over `width` samples of length h; `velocity` says what was measured.

    The first segment of each record only brings the hidden states to life: it is simulated, not judged.
    """

    pieces: tuple[Piece, ...]
    h: float
    width: int
    bins: int
    velocity: bool

    @property
    def seen(self) -> Array:
        """Measured averages (segments, bins)."""
        return np.concatenate([piece.seen for piece in self.pieces])

    @property
    def starts(self) -> Array:
        """Measured states at the starts of the segments (segments, 2)."""
        return np.concatenate([piece.starts for piece in self.pieces])

    @property
    def spread(self) -> Array:
        """Standard deviations of `starts`."""
        return np.concatenate([piece.spread for piece in self.pieces])

    @property
    def seconds(self) -> float:
        """How long each lasts [s]."""
        return self.bins * self.width * self.h

    @property
    def judged(self) -> Mask:
        """False for the first segment of each record."""
        return np.concatenate([np.arange(len(piece.seen)) > 0 for piece in self.pieces])

    @property
    def block(self) -> NDArray[np.int_]:
        """Number of each segment within its record."""
        return np.concatenate([np.arange(len(piece.seen)) for piece in self.pieces])


def smooth(y: Array, h: float, half: float, order: int = 0) -> Array:
    """Return y or its derivative of an order, from a parabola through the samples within `half` seconds."""
    reach = max(2, round(half / h))
    reach = min(reach, (len(y) - 1) // 2)
    kernel = savgol_coeffs(2 * reach + 1, 2, deriv=order, delta=h)
    padded = np.concatenate([2 * y[0] - y[reach:0:-1], y, 2 * y[-1] - y[-2 : -reach - 2 : -1]])
    return np.convolve(padded, kernel, mode="valid")


def cut(name: str, time: float, h: float, u: Array, y: Array, velocity: bool, resolution: float, width: int, bins: int) -> Piece:
    """Return one record as segments; what is left at the end is dropped."""
    length = width * bins
    n = len(u) // length
    first = np.arange(n) * length
    reach = max(2, round(SMOOTH / h))
    noise = max(resolution / np.sqrt(12), float(np.std(y - smooth(y, h, SMOOTH))), 1e-12)
    if velocity:
        starts = np.column_stack([np.zeros(n), smooth(y, h, SMOOTH)[first]])
        spread = np.column_stack([np.ones(n), np.full(n, 10 * noise)])
    else:
        v = smooth(y, h, SMOOTH, 1)
        starts = np.column_stack([smooth(y, h, SMOOTH)[first], v[first]])
        doubt = 10 * noise / (h * reach**1.5) + 0.05 * np.abs(v[first])
        spread = np.column_stack([np.full(n, 10 * noise), doubt])
    seen = y[: n * length].reshape(n, bins, width).mean(axis=2)
    return Piece(name, time, np.ascontiguousarray(u[: n * length]), seen, starts, spread)


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    """Return the threads that simulate records side by side: compiled code runs outside the interpreter's lock."""
    return ThreadPoolExecutor(os.cpu_count() or 1, "records")


if hasattr(os, "register_at_fork"):  # a forked child has none of its parent's threads, and would wait for them for ever
    os.register_at_fork(after_in_child=_pool.cache_clear)


def loose_by(effects: Sequence[str]) -> str:
    """Return the parameter that says how far the load behind a coupling can move by itself, or nothing."""
    return next((f"{name}.{find_effect(name).loose}" for name in effects if find_effect(name).loose), "")


class Unstable(SimulationError):
    """A simulation that failed in most of its segments."""


@lru_cache(maxsize=256)  # four rounds of all effects
def _compiled(law: str, effects: tuple[str, ...], velocity: bool, base: tuple[str, ...]) -> Native:
    wanted = [*base, *(p.name for name in effects for p in find_effect(name).parameters), *STARTS]
    wanted += APART if loose_by(effects) else ()
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
        self.loose = loose_by(effects)
        self.width = len(STARTS) + (len(APART) if self.loose else 0)
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
        pairs = [(states.index(load), states.index(motor)) for load, motor in LEADERS.items()] if self.loose else []
        self._load, self._motor = (np.array([pair[i] for pair in pairs], dtype=np.int32) for i in (0, 1))
        self._apart = len(self.names) + len(STARTS) + np.arange(len(pairs), dtype=np.int32)
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

    def unknown(self, values: Mapping[str, float]) -> Array:
        """Return the standard deviations (width - 2,) of the start states that no sensor shows; all are about zero.

        A load may be anywhere within its play, and beyond it as far as the usual torque bends the contact.
        """
        if not self.loose:
            return np.empty(0)
        u, v = self._usual
        bend = abs(values["b"]) * u / self._value(f"{self.loose.split('.')[0]}.stiffness", values)
        return np.array([1.0 + bend / self._half(values), COASTING * v + 1e-9])

    @cached_property
    def _usual(self) -> tuple[float, float]:
        """Root mean squares of the input and of the speeds at the starts of the segments."""
        inputs = np.concatenate([piece.u for piece in self.segments.pieces])
        return float(np.sqrt(np.mean(np.square(inputs)))), float(np.sqrt(np.mean(np.square(self.segments.starts[:, 1]))))

    def _half(self, values: Mapping[str, float]) -> float:
        return max(0.5 * self._value(self.loose, values), LEAST_PLAY)

    def _value(self, name: str, values: Mapping[str, float]) -> float:
        return float(values.get(name, self._v[self._native.program.index[name]]))

    def run(
        self, values: Mapping[str, float], starts: Array, jacobian: bool = False
    ) -> tuple[Array, Array | None, Mask, Array]:
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
        if self.loose:
            given[:, 2] *= self._half(values)
        begins = np.split(given, np.cumsum([len(piece.seen) for piece in pieces])[:-1])
        together = _pool().map if len(pieces) > 1 else map  # records do not depend on each other

        def one(native: Native, piece: Piece, begin: Array) -> tuple[Array, Array, Mask, Array]:
            return self._piece(native, piece, values, begin, jacobian)

        found = [np.concatenate(parts) for parts in zip(*together(one, self._natives, pieces, begins), strict=True)]
        seen, sens, good, begun = found
        if self.loose:
            self._over_play(values, begun, sens if jacobian else None)
        return seen, sens if jacobian else None, good, begun

    def _over_play(self, values: Mapping[str, float], starts: Array, sens: Array | None) -> None:
        """Put a load's place over half the play in place of its place, so that it stays in contact when the play changes."""
        half, place = self._half(values), len(self.names) + 2
        starts[:, 2] /= half
        if sens is not None:
            sens[:, :, self.names.index(self.loose)] += 0.5 * sens[:, :, place] * starts[:, 2, None]
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
