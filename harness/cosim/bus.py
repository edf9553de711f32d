"""What is co-simulated, and what a run leaves behind: the data of the bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bristle.fmus.host import Fmu, Value

Array = NDArray[np.float64]
Port = tuple[str, str]  # (unit, variable)
Progress = Callable[[int], None]

CHUNK = 5_000  # steps between two looks at the flags, at most
LOOKS = 200  # such looks in a run, at least


@dataclass(frozen=True)
class BusUnit:
    """One unit on the bus: an FMU and its start values."""

    name: str
    fmu: Fmu
    values: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class Bus:
    """What is co-simulated.

    `links` lead from outputs to inputs, `events` are (step, input, value) in order of time,
    `series` holds recorded inputs, a value for each step; `record` names the outputs kept at every
    step, `flags` what is read only now and then (Booleans, calculated parameters), and `watch` the
    units whose recorded outputs must stay below `HUGE`. Of a recorded input, row k + 1 holds what
    the unit got from t_k to t_k+1, its mean if that are several communication steps.
    """

    instances: tuple[BusUnit, ...]
    steps: int
    h: float
    links: tuple[tuple[Port, Port], ...] = ()
    events: tuple[tuple[int, Port, float], ...] = ()
    series: Mapping[Port, Array] = field(default_factory=dict)
    record: tuple[Port, ...] = ()
    flags: tuple[Port, ...] = ()
    watch: tuple[str, ...] = ()
    split: int = 1
    sequential: bool = False
    start: float = 0.0

    @property
    def chunk(self) -> int:
        """Steps between two looks at the flags."""
        return max(1, min(CHUNK, self.steps // LOOKS))

    @property
    def risky(self) -> bool:
        """Whether an FMU takes part whose library may harm its process."""
        return any(instance.fmu.risky for instance in self.instances)


@dataclass(frozen=True)
class Failure:
    """A run that ended early: which unit, when, why."""

    unit: str
    time: float
    message: str


@dataclass(frozen=True)
class Readings:
    """What was read of flags now and then: `values` (readings, ports) at `rows` (readings,), the
    first at row 0.
    """

    ports: tuple[Port, ...]
    rows: NDArray[np.int64]
    values: Array

    @classmethod
    def of(
        cls, ports: tuple[Port, ...], readings: Sequence[tuple[int, Sequence[float]]]
    ) -> Readings:
        """Return readings given one after the other, as row and values."""
        rows, values = (
            np.array([row for row, _ in readings], dtype=np.int64),
            np.array([each for _, each in readings], dtype=float),
        )
        return cls(ports, rows, values.reshape(len(rows), len(ports)))

    @cached_property
    def last(self) -> dict[Port, float]:
        """The last values, by port."""
        return dict(zip(self.ports, self.values[-1].tolist(), strict=True))

    def from_first_sample(self) -> Readings:
        """Return them as belongs to a record, which has no row for the start."""
        later = self.rows > 0
        return (
            Readings(self.ports, self.rows[later] - 1, self.values[later]) if later.any() else self
        )


@dataclass
class BusTrace:
    """What a run leaves behind: row k of `values` is the bus at start + k h."""

    record: tuple[Port, ...]
    values: Array
    h: float
    flags: Readings
    failure: Failure | None = None
    start: float = 0.0

    def __getitem__(self, port: Port) -> Array:
        return self.values[:, self.record.index(port)]

    def get(self, port: Port) -> Array | None:
        """Return what was recorded of a port, None if it was not."""
        return self[port] if port in self.record else None

    def says_something(self, port: Port) -> bool:
        """Say whether a number other than 0 was ever recorded of a port."""
        return self._not_zero.get(port, False) and bool(np.nan_to_num(self[port]).any())

    @cached_property
    def _not_zero(self) -> dict[Port, bool]:
        """Whether anything but 0 was recorded of each port: one pass over all, since most ports of
        an observer are 0 throughout.
        """
        return dict(zip(self.record, np.any(self.values, axis=0).tolist(), strict=True))

    def flag(self, port: Port) -> Array:
        """Return a flag for each row: what was read next, at that row or after it."""
        flags = self.flags
        if port not in flags.ports:
            return np.full(len(self.values), np.nan)
        return np.repeat(flags.values[:, flags.ports.index(port)], self._looked)

    @cached_property
    def _looked(self) -> NDArray[np.int64]:
        """Return how many rows each reading of the flags stands for."""
        ends = np.minimum(self.flags.rows + 1, len(self.values))
        ends[-1] = len(self.values)
        return np.diff(ends, prepend=0)

    def from_first_sample(self, factors: Mapping[Port, float]) -> BusTrace:
        """Return it as belongs to a record: row k is what was published after sample k, each column
        times its factor.
        """
        if not self.steps:
            return self
        scales = np.array([factors[port] for port in self.record])
        return BusTrace(
            self.record,
            self.values[1:] * scales,
            self.h,
            self.flags.from_first_sample(),
            self.failure,
        )

    @property
    def steps(self) -> int:
        """Steps done."""
        return len(self.values) - 1

    @property
    def time(self) -> Array:
        """Time of each row."""
        return np.asarray(self.start + np.arange(len(self.values)) * self.h)
