"""Records: ready, as all else takes them, and raw, while intake looks them through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bristle.common.errors import BristleError
from bristle.common.table import KINDS, Array

NAMES = ("time", "input", "output")


@dataclass(frozen=True)
class Record:
    """A record in SI, uniformly sampled, without holes or wraps.

    Attributes
    ----------
    name : str
        Name of the file; pieces of one are name[1], name[2].
    time : ndarray, shape (n,)
        Time [s], uniform; its start is the record's own, so that records of one session share it.
    h : float
        Sampling period [s], the same for all records that were loaded together.
    u : ndarray, shape (n,)
        Input in the model's `input_unit`, held from each sample to the next.
    y : ndarray, shape (n,)
        Output in the model's `output_unit`.
    findings : tuple of str
        What was found and done, one line each.
    resolution : float or None
        Smallest step that the output was recorded in, None where it has none.
    wrapped : bool
        Whether the position was recorded within one turn, and is unwrapped here.
    resampled : bool
        Whether samples were interpolated.
    ahead : float
        Share of the next sample in `u`, where the input was found to change between the samples.

    Raises
    ------
    BristleError
        If time, u and y are no vectors of finite numbers, of one length, if h is not above 0, or if another field is of
        another kind.
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

    def __post_init__(self) -> None:
        columns = vectors(self.name, self.time, self.u, self.y)
        for key, name, column in zip(("time", "u", "y"), NAMES, columns, strict=True):
            if not np.isfinite(column).all():
                k = int(np.argmin(np.isfinite(column)))
                raise BristleError(f"record {self.name}: {name} is not finite at sample {k}; repair it or cut the record")
            object.__setattr__(self, key, column)
        h: object = self.h
        if not isinstance(h, int | float | np.number) or not 0.0 < float(h) < np.inf:
            raise BristleError(f"record {self.name}: h is {h}; give the sampling period in s, above 0")
        for key, value, most in (("resolution", self.resolution or 0.0, np.inf), ("ahead", self.ahead, 1.0)):
            if not isinstance(value, int | float | np.number) or not 0.0 <= float(value) < most:
                raise BristleError(f"record {self.name}: {key} is {value}; give a number of at least 0 and below {most:g}")
        if not isinstance(self.findings, tuple) or not all(isinstance(line, str) for line in self.findings):
            raise BristleError(f"record {self.name}: findings are {self.findings!r}; give a tuple of texts")

    def __len__(self) -> int:
        return len(self.time)


@dataclass
class Raw:
    """A record on its way: SI, and whatever else is the matter; `where` is the path or name that errors begin with."""

    name: str
    where: str
    time: Array
    u: Array
    y: Array
    lines: list[str]

    def say(self, line: str) -> None:
        """Report what was found."""
        self.lines.append(f"record {self.name}: {line}")

    def error(self, line: str) -> BristleError:
        """Return the error to raise."""
        return BristleError(f"record {self.where}: {line}")

    def keep(self, chosen: NDArray[np.bool_] | slice) -> None:
        """Leave out all other samples."""
        self.time, self.u, self.y = self.time[chosen], self.u[chosen], self.y[chosen]


def vectors(name: object, *columns: ArrayLike) -> tuple[Array, Array, Array]:
    """Return time, input and output of a record as vectors of numbers of one length; masked samples are NaN."""
    if not isinstance(name, str):
        raise BristleError(f"record {name}: its name is a {type(name).__name__}; give text")
    time, u, y = (_vector(name, key, values) for key, values in zip(NAMES, columns, strict=True))
    if not len(time) == len(u) == len(y):
        sizes = f"time {len(time)}, input {len(u)}, output {len(y)} samples"
        raise BristleError(f"record {name}: columns of different length ({sizes}); cut them to the same samples")
    if not len(time):
        raise BristleError(f"record {name}: holds no sample; check the columns")
    return time, u, y


def _vector(name: str, key: str, values: ArrayLike) -> Array:
    held = ""
    try:
        array = np.ma.asarray(values) if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
        if array.dtype.kind in "cMm":
            held = f" but of {KINDS[array.dtype.kind]}"
            raise TypeError
        array = np.ma.filled(array.astype(float), np.nan)
    except (TypeError, ValueError):
        raise BristleError(f"record {name}: {key} is not an array of numbers{held}; give one of shape (n,) in SI") from None
    if array.ndim != 1:
        raise BristleError(f"record {name}: {key} has shape {array.shape}; give one of shape (n,)")
    return array
