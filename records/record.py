"""Records: `Record` as all other code takes them, `Raw` while they are checked and repaired."""

from __future__ import annotations

from collections.abc import Mapping
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
    known : dict of str to ndarray, shape (n,)
        What else is known of the servo at each sample, by what the layout calls it, in SI.

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
    known: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        found = vectors(self.name, self.time, self.u, self.y, self.velocity, self.known)
        for name, column in found.items():
            if not np.isfinite(column).all():
                k = int(np.argmin(np.isfinite(column)))
                raise BristleError(
                    f"record {self.name}: {name} is not finite at sample {k}; repair it or cut the"
                    " record"
                )
        for key, name in zip(("time", "u", "y", "velocity"), COLUMN_NAMES, strict=True):
            object.__setattr__(self, key, found.pop(name, None))
        object.__setattr__(self, "known", found)
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
        known = {name: values[which] for name, values in self.known.items()}
        return replace(self, time=time, u=u, y=y, velocity=velocity, known=known)


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
    known: dict[str, Array] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list, kw_only=True)

    @classmethod
    def of(cls, name: str, where: str, columns: Mapping[str, Array]) -> Raw:
        """Return the record of these columns, by their names."""
        time, u, y = (columns[key] for key in COLUMN_NAMES[:3])
        rest = {key: x for key, x in columns.items() if key not in COLUMN_NAMES}
        velocity = columns.get("velocity")
        return cls(name, where, time, u, y, velocity, rest)

    @property
    def columns(self) -> dict[str, Array]:
        """All columns by their names: time, input, output, perhaps velocity, and what is known."""
        velocity = {} if self.velocity is None else {"velocity": self.velocity}
        return {"time": self.time, "input": self.u, "output": self.y, **velocity, **self.known}

    def say(self, line: str) -> None:
        self.lines.append(f"record {self.name}: {line}")

    def error(self, line: str) -> BristleError:
        return BristleError(f"record {self.where}: {line}")

    def keep(self, chosen: NDArray[np.bool_] | slice) -> None:
        """Leave out all other samples."""
        self.time, self.u, self.y = self.time[chosen], self.u[chosen], self.y[chosen]
        self.velocity = None if self.velocity is None else self.velocity[chosen]
        self.known = {name: values[chosen] for name, values in self.known.items()}


def vectors(
    name: object,
    time: ArrayLike,
    u: ArrayLike,
    y: ArrayLike,
    velocity: ArrayLike | None = None,
    known: Mapping[str, ArrayLike] | None = None,
) -> dict[str, Array]:
    """Return time, input, output and, if it is given, velocity of a record, and what else is known
    of it, as vectors of one length, by their names; masked samples are NaN.
    """
    if not isinstance(name, str):
        raise BristleError(f"record {name}: its name is a {type(name).__name__}; give text")
    given = dict(zip(COLUMN_NAMES, (time, u, y, velocity), strict=True)) | dict(known or {})
    found = {key: _vector(name, key, values) for key, values in given.items() if values is not None}
    if len({len(values) for values in found.values()}) > 1:
        sizes = ", ".join(f"{key} {len(values)}" for key, values in found.items())
        raise BristleError(
            f"record {name}: columns of different length ({sizes} samples); cut them to the same"
            " samples"
        )
    if not len(found["time"]):
        raise BristleError(f"record {name}: holds no sample; check the columns")
    return found


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
