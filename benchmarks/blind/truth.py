"""The hidden truth in numpy clothes: the structs of truth.c, closed-loop records and replays of
pieces of them.

Nothing of the package's own plants is used; only its C compiler and its cache.
"""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bristle.common.cache import cached, digest
from bristle.model.compiler import FLAGS, SUFFIX, compile_shared, compiler_identity

Array = NDArray[np.float64]

SOURCE = Path(__file__).with_name("truth.c").read_text(encoding="utf-8")
PERIOD = 1e-3  # s, sampling period of the records
STEP = 5e-5  # s, internal step of the records
COUNTS = 16384
RESOLUTION = 2 * math.pi / COUNTS
# rad, Fc/sigma0 of the base friction: 1e-4 would show, a gap ratio of 1.3 to 2 over pure Coulomb
# friction
DISPLACEMENT = 2e-5
# rad/s, above which the damping of the bristles fades, lest it act as an impulse at every reversal
FADE = 0.01
DAMPING_RATIO = 0.3  # of the mass on its bristles
CORNER = 10.0  # Hz, of the disturbance torque


def _struct(name: str) -> type[ctypes.Structure]:
    body = re.search(r"typedef struct \{([^}]*)\} " + name + ";", SOURCE)
    assert body is not None
    fields = [
        (field, ctypes.c_double)
        for field in re.findall(r"^\s*double (\w+);", body[1], re.MULTILINE)
    ]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


Plant = _struct("Plant")
Loop = _struct("Loop")
PLANT_FIELDS = frozenset(name for name, _ in Plant._fields_)


def struct(kind: type[ctypes.Structure], values: Mapping[str, float]) -> ctypes.Structure:
    """Return a struct with some fields set and zero in the others; an unknown field is an error."""
    unknown = set(values) - {name for name, *_ in kind._fields_}
    if unknown:
        raise ValueError(f"{kind.__name__} has no field {sorted(unknown)}")
    return kind(**values)


@cache
def library() -> ctypes.CDLL:
    """Return the compiled truth.c."""
    name = "blind-" + digest(SOURCE, " ".join(FLAGS), compiler_identity())[:32] + SUFFIX
    return ctypes.CDLL(str(cached(name, lambda path: compile_shared({"truth.c": SOURCE}, path))))


@cache
def state_count() -> int:
    """Return the number of states; position is the first, velocity the second, the load's the fifth
    and sixth.
    """
    return int(library().truth_states())


def _pointer(array: NDArray[np.generic]) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


@dataclass(frozen=True)
class Record:
    """A measured record, and what only the truth knows: the states at every sample."""

    start: float  # s, session time of the first sample
    u: Array
    theta: Array
    states: Array

    @property
    def t(self) -> Array:
        """Session time of the samples."""
        return self.start + PERIOD * np.arange(self.u.size)


def base_friction(J: float, Fc: float, displacement: float = DISPLACEMENT) -> dict[str, float]:
    """Return stiff bristles for the Coulomb level Fc.

    Source: canudas1995 (LuGre, with damping that fades with the speed).
    """
    sigma0 = Fc / displacement
    return {
        "sigma0": sigma0,
        "sigma1": 2 * DAMPING_RATIO * math.sqrt(sigma0 * J),
        "sigma1_speed": FADE,
    }


def disturbance(rng: np.random.Generator, samples: int, rms: float) -> Array:
    """Return a first-order low-passed torque noise of a given rms."""
    keep = math.exp(-2 * math.pi * CORNER * PERIOD)
    white = rng.standard_normal(samples) * rms * math.sqrt(1 - keep**2)
    noise = np.empty(samples)
    value = rng.standard_normal() * rms
    for k in range(samples):
        value = keep * value + white[k]
        noise[k] = value
    return noise


def run(
    plant: Mapping[str, float],
    loop: Mapping[str, float],
    start: float,
    reference: Array,
    noise: Array,
) -> Record:
    """Simulate the closed loop over a reference (samples x position, velocity, acceleration)."""
    n, width = len(reference), state_count()
    reference, noise = np.ascontiguousarray(reference), np.ascontiguousarray(noise)
    begin = np.zeros(width)
    begin[0] = begin[4] = reference[0, 0]
    theta, u, states = np.empty(n), np.empty(n), np.empty((n, width))
    library().truth_run(
        ctypes.byref(struct(Plant, {"step": STEP, **plant})),
        ctypes.byref(struct(Loop, {"resolution": RESOLUTION, **loop})),
        ctypes.c_double(start),
        ctypes.c_long(n),
        *(_pointer(array) for array in (reference, noise, begin, theta, u, states)),
    )
    return Record(start, u, theta, states)


def replay(
    plant: Mapping[str, float],
    record: Record,
    first: NDArray[np.int64],
    states: Array,
    length: int,
    step: float,
) -> Array:
    """Return the output of pieces of a record (pieces x samples), without disturbance, from given
    states.
    """
    states, first = np.ascontiguousarray(states), np.ascontiguousarray(first, dtype=np.int64)
    out = np.empty((first.size, length))
    library().truth_replay(
        ctypes.byref(struct(Plant, {**plant, "step": step})),
        ctypes.c_double(record.start),
        ctypes.c_long(first.size),
        ctypes.c_long(length),
        *(_pointer(array) for array in (first, record.u, states, out)),
    )
    return out


def play(plant: Mapping[str, float], start: float, u: Array, noise: Array, place: float) -> Array:
    """Return what the encoder shows (samples,) while an input is played back in open loop, from
    rest at a place.
    """
    u, noise, begin = np.ascontiguousarray(u), np.ascontiguousarray(noise), np.zeros(state_count())
    begin[0] = begin[4] = place
    theta = np.empty(u.size)
    library().truth_play(
        ctypes.byref(struct(Plant, {"step": STEP, **plant})),
        ctypes.c_double(RESOLUTION),
        ctypes.c_double(start),
        ctypes.c_long(u.size),
        *(_pointer(array) for array in (u, noise, begin, theta)),
    )
    return theta
