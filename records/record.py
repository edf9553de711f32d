"""Records: `Record` as all other code takes them, `Raw` while they are checked and repaired."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bristle.common.errors import BristleError
from bristle.common.table import KINDS, Array

COLUMN_NAMES = ("time", "input", "output", "velocity")  # of a record, as errors name them


@dataclass(frozen=True)
class Record:
    """A record in SI, uniformly sampled, without gaps.

    Attributes
    ----------
    name : str
        Name of the file; pieces of one are name[1], name[2].
    time : ndarray, shape (n,)
        Time [s], uniform; it does not begin with 0, so that records of one measurement keep their
        order in time.
    h : float
        Sampling period [s], the same for all records that were loaded together.
    u : ndarray, shape (n,)
        Input in the layout's `input_unit`, held from each sample to the next.
    y : ndarray, shape (n,)
        Output in the layout's `output_unit`.
    findings : tuple of str
        What was found and repaired, one line each.
    resolution : float or None
        Step in which the output was recorded, None if it shows none.
    wrapped : bool
        Whether the position was recorded within one turn, and is unwrapped here.
    resampled : bool
        Whether samples were interpolated.
    ahead : float
        Share of the next sample in `u`, where the input was found to change between the samples.
    velocity : ndarray, shape (n,), or None
        Velocity that was recorded besides the position.

    Raises
    ------
    BristleError
        If time, u and y are no vectors of finite numbers, of one length, h is not above 0, or
        another field of another kind.
    """

    name: str
    time: Array
    h: float
    u: Array
    y: Array
    findings: tuple[str, ...] = ()
    resolution: float | None = None
    wrapped: bool = False
    resampled: bool = False
    ahead: float = 0.0
    velocity: Array | None = None

    def __post_init__(self) -> None:
        columns = vectors(self.name, self.time, self.u, self.y, self.velocity)
        for key, name, column in zip(
            ("time", "u", "y", "velocity"), COLUMN_NAMES, columns, strict=False
        ):
            if not np.isfinite(column).all():
                k = int(np.argmin(np.isfinite(column)))
                raise BristleError(
                    f"record {self.name}: {name} is not finite at sample {k}; repair it or cut the"
                    " record"
                )
            object.__setattr__(self, key, column)
        h: object = self.h
        if not isinstance(h, int | float | np.number) or not 0.0 < float(h) < np.inf:
            raise BristleError(
                f"record {self.name}: h is {h}; give the sampling period in s, above 0"
            )
        for key, value, most in (
            ("resolution", self.resolution or 0.0, np.inf),
            ("ahead", self.ahead, 1.0),
        ):
            if not isinstance(value, int | float | np.number) or not 0.0 <= float(value) < most:
                raise BristleError(
                    f"record {self.name}: {key} is {value}; give a number of at least 0 and below"
                    f" {most:g}"
                )
        if not isinstance(self.findings, tuple) or not all(
            isinstance(line, str) for line in self.findings
        ):
            raise BristleError(
                f"record {self.name}: findings are {self.findings!r}; give a tuple of texts"
            )

    def __len__(self) -> int:
        return len(self.time)

    def part(self, which: slice) -> Record:
        """Return a part of the record."""
        velocity = None if self.velocity is None else self.velocity[which]
        time, u, y = self.time[which], self.u[which], self.y[which]
        return replace(self, time=time, u=u, y=y, velocity=velocity)


@dataclass
class Raw:
    """A record in SI before it is checked; `where` is the path or name that errors begin with,
    `lines` are the findings.
    """

    name: str
    where: str
    time: Array
    u: Array
    y: Array
    velocity: Array | None = None
    lines: list[str] = field(default_factory=list, kw_only=True)

    @property
    def columns(self) -> list[Array]:
        """Time, input, output and, where it was recorded, velocity."""
        return [self.time, self.u, self.y, *([] if self.velocity is None else [self.velocity])]

    def say(self, line: str) -> None:
        self.lines.append(f"record {self.name}: {line}")

    def error(self, line: str) -> BristleError:
        return BristleError(f"record {self.where}: {line}")

    def keep(self, chosen: NDArray[np.bool_] | slice) -> None:
        """Leave out all other samples."""
        self.time, self.u, self.y = self.time[chosen], self.u[chosen], self.y[chosen]
        self.velocity = None if self.velocity is None else self.velocity[chosen]


def vectors(name: object, *columns: ArrayLike | None) -> list[Array]:
    """Return time, input, output and, if it is given, velocity of a record as vectors of one
    length; masked samples are NaN.
    """
    if not isinstance(name, str):
        raise BristleError(f"record {name}: its name is a {type(name).__name__}; give text")
    found = {
        key: _vector(name, key, values)
        for key, values in zip(COLUMN_NAMES, columns, strict=False)
        if values is not None
    }
    if len({len(values) for values in found.values()}) > 1:
        sizes = ", ".join(f"{key} {len(values)}" for key, values in found.items())
        raise BristleError(
            f"record {name}: columns of different length ({sizes} samples); cut them to the same"
            " samples"
        )
    if not len(found["time"]):
        raise BristleError(f"record {name}: holds no sample; check the columns")
    return list(found.values())


def _vector(name: str, key: str, values: ArrayLike) -> Array:
    held = ""
    try:
        array = (
            np.ma.asarray(values) if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
        )
        if array.dtype.kind in "cMm":
            held = f" but of {KINDS[array.dtype.kind]}"
            raise TypeError
        array = np.ma.filled(array.astype(float), np.nan)
    except (TypeError, ValueError):
        raise BristleError(
            f"record {name}: {key} is not an array of numbers{held}; give one of shape (n,) in SI"
        ) from None
    if array.ndim != 1:
        raise BristleError(f"record {name}: {key} has shape {array.shape}; give one of shape (n,)")
    return array
