"""Records cut into short segments, their smoothed motion, and what else a search keeps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.answer import Finding
from bristle.diagnosis.estimation.noise import Noise, estimate, response
from bristle.diagnosis.sliding.stretches import Stretches, smooth
from bristle.records.clock import one_after_the_other, overlap

Mask = NDArray[np.bool_]
SEGMENT_SECONDS = 0.4  # s: length of a segment for a servo of the usual time constant
# s: half-width of the parabola that gives position and velocity at the start of a segment
STATE_SMOOTHING = 0.02
REST_STEPS = 3.0  # steps of the sensor within the smoothing window: a slower speed counts as rest
LEAST_NOISE_SEGMENTS = 10  # segments: fewest in motion from which the noise is estimated
HELD_OUT_EVERY = 4  # segments: one of so many is held out from the search
LANES = 4  # records or parts of them at a time; the same on every processor, so that answers are


@dataclass(frozen=True)
class Grid:
    """How records are cut: segments of `bins` averages over `width` samples of length `h` [s];
    `velocity`: what was measured.
    """

    h: float
    width: int
    bins: int
    velocity: bool

    @property
    def seconds(self) -> float:
        """Length of a segment [s]."""
        return self.bins * self.width * self.h


@dataclass(frozen=True)
class Piece:
    """One record as consecutive segments: time of the first sample [s], inputs (segments * bins *
    width,), measured averages (segments, bins), states at the starts (segments, 2) with their
    standard deviations; length of the whole record [s], with what follows its last segment; other
    inputs by their names."""

    name: str
    time: float
    u: Array
    measured: Array
    initial: Array
    initial_sd: Array
    seconds: float
    others: Mapping[str, Array] = field(default_factory=dict)

    def beside(self, known: Mapping[str, Array]) -> Piece:
        """Return the same with other inputs of the record, as long or longer, by their names."""
        return replace(self, others={name: x[: len(self.u)] for name, x in known.items()})


@dataclass(frozen=True)
class Segments(Grid):
    """All records as segments.

    The first segment of each record only sets the hidden states: it is simulated, but not part of
    the likelihood.
    """

    pieces: tuple[Piece, ...]

    @cached_property
    def inputs(self) -> dict[str, Array]:
        """Inputs of all records, one after the other, by the names that a servo gives them."""
        others = {
            name: np.concatenate([piece.others[name] for piece in self.pieces])
            for name in self.pieces[0].others
        }
        return {"u": np.concatenate([piece.u for piece in self.pieces]), **others}

    def timed(self, times: Sequence[float]) -> Segments:
        """Return the same with other times of the first samples of the records [s]."""
        return replace(
            self,
            pieces=tuple(
                replace(piece, time=time) for piece, time in zip(self.pieces, times, strict=True)
            ),
        )

    @property
    def times(self) -> tuple[float, ...]:
        """Times of the first samples of the records [s]."""
        return tuple(piece.time for piece in self.pieces)

    def consecutive(self, order: Sequence[int]) -> tuple[float, ...]:
        """Return times of the first samples [s] with which the records, in this order, follow one
        another without a gap.
        """
        seconds = [self.pieces[i].seconds for i in order]
        begins = dict(zip(order, one_after_the_other(min(self.times), seconds), strict=True))
        return tuple(begins[i] for i in range(len(order)))

    @property
    def own_clocks(self) -> bool:
        """True if times of the records overlap, so that each has a clock of its own."""
        return overlap(
            (piece.time, piece.time + self.h * (len(piece.u) - 1)) for piece in self.pieces
        )

    def clocks(self, timing: str) -> list[tuple[float, ...]]:
        """Return the times of the first samples that an effect of a `timing` (see `Effect`) calls
        for, each as of `timed`.

        Where each record has a clock of its own, nothing says which was measured first: an event is
        tried with each record as the last one, a course as beginning anew in each record, and as
        going on from one to the next in the order given.
        """
        if not (timing and self.own_clocks):
            return [self.times]
        places = range(len(self.pieces))
        if timing == "course":
            return [self.times, self.consecutive(places)]
        return [
            self.consecutive([*(i for i in places if i != last), last]) for last in reversed(places)
        ]

    @property
    def measured(self) -> Array:
        """Measured averages (segments, bins)."""
        return np.concatenate([piece.measured for piece in self.pieces])

    @property
    def initial(self) -> Array:
        """Measured states at the starts of the segments (segments, 2)."""
        return np.concatenate([piece.initial for piece in self.pieces])

    @property
    def initial_sd(self) -> Array:
        """Standard deviations of `initial`."""
        return np.concatenate([piece.initial_sd for piece in self.pieces])

    @property
    def counted(self) -> Mask:
        """False for the first segment of each record."""
        return self.block > 0

    @property
    def places(self) -> list[slice]:
        """Where the segments of each record stand among those of all."""
        ends = [0, *accumulate(len(piece.measured) for piece in self.pieces)]
        return [slice(begin, end) for begin, end in pairwise(ends)]

    @property
    def block(self) -> NDArray[np.int_]:
        """Number of each segment within its record."""
        return np.concatenate([np.arange(len(piece.measured)) for piece in self.pieces])


# -- parts of records that are simulated side by side, one in each lane of the processor's vectors -
@dataclass(frozen=True)
class Chains:
    """Chains that run side by side, arrays (lanes,): from segment `first` to `end`, counted over
    all records, and from `times` [s].

    Results are those from segment `begin` on. The one before it lets hidden states reach their
    steady motion, as the first segment of a record does.
    """

    times: Array
    first: NDArray[np.longlong]
    begin: NDArray[np.longlong]
    end: NDArray[np.longlong]


def chains_of(segments: Segments, whole_records: bool = False) -> list[Chains]:
    """Return the chains that are simulated one group after the other: parts of records where that
    is quicker, or whole ones.

    Where a velocity was measured records stay whole: no segment says where it begins, so the
    position is the sum of all before. `whole_records` keeps them so too: a controller's integral is
    such a sum.
    """
    counts = [len(piece.measured) for piece in segments.pieces]
    groups, whole = math.ceil(len(counts) / LANES), max(counts)
    lengths = [whole] if segments.velocity or whole_records else range(1, whole + 1)
    longest = next(
        n for n in lengths if sum(math.ceil(count / n) for count in counts) <= LANES * groups
    )
    # a part begins one segment early
    parts = list(_parts(segments, longest if longest + 1 < whole else whole))
    return [_together(parts[k : k + LANES]) for k in range(0, len(parts), LANES)]


def _parts(segments: Segments, longest: int) -> Iterator[tuple[float, int, int, int]]:
    """Give (time, first, begin, end) of parts of the records, none with more segments than
    `longest` and the one before.
    """
    for piece, place in zip(segments.pieces, segments.places, strict=True):
        count = len(piece.measured)
        ends = [round(x) for x in np.linspace(0, count, math.ceil(count / longest) + 1)]
        for begin, end in pairwise(ends):
            first = max(begin - 1, 0)
            yield (
                piece.time + first * segments.seconds,
                place.start + first,
                place.start + begin,
                place.start + end,
            )


def _together(parts: Sequence[tuple[float, int, int, int]]) -> Chains:
    """Return parts as one group; lanes without any have no segment."""
    filled = [*parts, *[(0.0, 0, 0, 0)] * (LANES - len(parts))]
    times, *places = (np.array(column) for column in zip(*filled, strict=True))
    return Chains(times.astype(float), *(place.astype(np.longlong) for place in places))


@dataclass(frozen=True)
class Motion:
    """The measured motion over all segments, one after the other (segments * bins * width,)."""

    theta: Array
    v: Array
    a: Array
    u: Array
    time: Array
    moving: Mask
    record: NDArray[np.int_]


def cut(name: str, time: float, u: Array, y: Array, grid: Grid, resolution: float) -> Piece:
    """Return one record as segments; the samples after the last whole segment are dropped.

    Parameters: time of the first sample [s]; input u and output y (n,); resolution of the output.
    """
    h, bins, width = grid.h, grid.bins, grid.width
    length = width * bins
    n = len(u) // length
    first = np.arange(n) * length
    reach = max(2, round(STATE_SMOOTHING / h))
    smoothed = smooth(y, h, STATE_SMOOTHING)
    noise = max(resolution / np.sqrt(12), float(np.std(y - smoothed)), 1e-12)
    if grid.velocity:
        initial = np.column_stack([np.zeros(n), smoothed[first]])
        initial_sd = np.column_stack([np.ones(n), np.full(n, 10 * noise)])
    else:
        v = smooth(y, h, STATE_SMOOTHING, 1)
        initial = np.column_stack([smoothed[first], v[first]])
        initial_sd = np.column_stack(
            [np.full(n, 10 * noise), 10 * noise / (h * reach**1.5) + 0.05 * np.abs(v[first])]
        )
        # the slope of a parabola has four times the error at its end
        initial_sd[:1, 1] *= 4
    measured = y[: n * length].reshape(n, bins, width).mean(axis=2)
    return Piece(
        name, time, np.ascontiguousarray(u[: n * length]), measured, initial, initial_sd, h * len(u)
    )


def motion(segments: Segments, outputs: list[Array], resolution: float, half: float) -> Motion:
    """Return the smoothed motion of records with these measured outputs (n,), cut to segments."""
    h, parts = segments.h, []
    for i, (piece, y) in enumerate(zip(segments.pieces, outputs, strict=True)):
        n = len(piece.u)
        if segments.velocity:
            v, a = smooth(y, h, half)[:n], smooth(y, h, half, 1)[:n]
            theta = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * h / 2)])
            rest = REST_STEPS * resolution
        else:
            theta, v, a = (smooth(y, h, half, order)[:n] for order in (0, 1, 2))
            rest = REST_STEPS * resolution / (2 * half)
        time = piece.time + h * np.arange(n)
        parts.append((theta, v, a, piece.u, time, np.abs(v) > rest, np.full(n, i)))
    return Motion(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class Dataset:
    """Everything that stays the same during a search."""

    segments: Segments
    motion: Motion
    stretches: Stretches  # where the records slide
    resolution: float  # step of the sensor [unit of the output]
    # standard deviation of an average below which the sensor's noise cannot be [unit of the output]
    least_sd: float
    # why the motion is too uniform to distinguish effects by their form; None if it is not
    uniform: Finding | None = None
    # why an effect is no candidate, by its name
    excluded: Mapping[str, Finding] = field(default_factory=dict)
    linear: bool = False  # True if the axis does not turn
    turn: float = 2 * math.pi  # path after which the motion repeats [rad or m]: one turn of a shaft
    input_may_change: bool = False  # True if the input may change between samples

    @cached_property
    def train(self) -> Mask:
        """Segments that the search uses."""
        return np.asarray(self.segments.counted & ~self.held_out)

    @cached_property
    def held_out(self) -> Mask:
        """Segments held out from the search: none with an extreme of position or input, which may
        show something unique.

        If no other is left, as in a record of two seconds, those with an extreme are held out too,
        or the last one.
        """
        m = self.motion
        counted = np.repeat(self.segments.counted, len(m.theta) // len(self.segments.counted))
        ends = [
            int(np.argmax(np.where(counted, side * x, -np.inf)))
            for x in (m.theta, m.u)
            for side in (1, -1)
        ]
        free = np.ones(len(self.segments.counted), dtype=bool)
        free[np.array(ends) * len(free) // len(m.theta)] = False
        every = self.segments.counted & (self.segments.block % HELD_OUT_EVERY == HELD_OUT_EVERY - 1)
        last = np.arange(len(free)) == np.flatnonzero(self.segments.counted)[-1]
        return next(np.asarray(mask) for mask in (every & free, every, last) if mask.any())

    def time_at(self, times: Sequence[float]) -> Array:
        """Return each sample's time [s] with other times of the first samples of the records."""
        shift = np.array(times) - np.array(self.segments.times)
        return np.asarray(self.motion.time + shift[self.motion.record])

    def noise(
        self, residual: Array, weight: Array, values: Mapping[str, float], slowest: float = 0.0
    ) -> Noise:
        """Return the noise of a residual (segments, bins), from the segments in motion; `slowest`
        as of `estimate`.

        At rest friction absorbs the disturbance and the sensor repeats its last step: such segments
        do not show the noise.
        """
        s = self.segments
        share = self.motion.moving.reshape(len(residual), -1).mean(axis=1)
        in_motion = weight * share
        weight = in_motion if np.count_nonzero(in_motion > 0.5) >= LEAST_NOISE_SEGMENTS else weight
        pulses = response(values["J"], values["a2"], s.h, s.width, s.bins, s.velocity)
        return estimate(residual, weight, pulses, s.h, self.least_sd, slowest)
