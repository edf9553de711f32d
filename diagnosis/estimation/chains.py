"""Records as chains of segments that are simulated side by side, one in each lane of the processor's vectors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.estimation.dataset import Segments

WIDE, NARROW = 8, 2  # lanes; the same on every processor, so that answers are
WIDE_COST = 3.0  # time of a step of the wide lanes, over that of the narrow ones


@dataclass(frozen=True)
class Chains:
    """Chains that run side by side, arrays (lanes,): from segment `first` to `end`, counted over all records, and from `times` [s].

    Results are those from segment `begin` on. The one before it lets hidden states reach their steady motion, as the first segment
    of a record does.
    """

    times: Array
    first: NDArray[np.longlong]
    begin: NDArray[np.longlong]
    end: NDArray[np.longlong]


def chains_of(segments: Segments) -> list[Chains]:
    """Return the chains that are simulated one group after the other: parts of records where that is quicker, or whole ones.

    Where a velocity was measured records stay whole: no segment says where it begins, so the position is the sum of all before.
    """
    counts = [len(piece.measured) for piece in segments.pieces]
    groups = math.ceil(len(counts) / WIDE)
    longest = next(n for n in range(1, max(counts) + 1) if sum(math.ceil(count / n) for count in counts) <= WIDE * groups)
    steps = groups * (longest + (longest < max(counts)))
    if segments.velocity:
        longest, steps = max(counts), groups * max(counts)
    wide = WIDE_COST * steps < math.ceil(len(counts) / NARROW) * max(counts)
    parts = list(_parts(segments, longest if wide else max(counts)))
    width = WIDE if wide else NARROW
    return [_together(parts[k : k + width], width) for k in range(0, len(parts), width)]


def _parts(segments: Segments, longest: int) -> Iterator[tuple[float, int, int, int]]:
    """Give (time, first, begin, end) of parts of the records, none with more segments than `longest` and the one before."""
    offset = 0
    for piece in segments.pieces:
        count = len(piece.measured)
        ends = [round(x) for x in np.linspace(0, count, math.ceil(count / longest) + 1)]
        for begin, end in pairwise(ends):
            first = max(begin - 1, 0)
            yield piece.time + first * segments.seconds, offset + first, offset + begin, offset + end
        offset += count


def _together(parts: Sequence[tuple[float, int, int, int]], width: int) -> Chains:
    """Return parts as one group; lanes without any have no segment."""
    filled = [*parts, *[(0.0, 0, 0, 0)] * (width - len(parts))]
    times, *places = (np.array(column) for column in zip(*filled, strict=True))
    return Chains(times.astype(float), *(place.astype(np.longlong) for place in places))
