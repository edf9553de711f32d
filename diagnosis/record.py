"""Records: ready, as all else takes them, and raw, while intake looks them through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bristle.model.errors import BristleError
from bristle.model.table import Array


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

    def __len__(self) -> int:
        return len(self.time)


@dataclass
class Raw:
    """A record on its way: SI, and whatever else is the matter."""

    name: str
    time: Array
    u: Array
    y: Array
    lines: list[str]

    def say(self, line: str) -> None:
        """Report what was found."""
        self.lines.append(f"record {self.name}: {line}")

    def error(self, line: str) -> BristleError:
        """Return the error to raise."""
        return BristleError(f"record {self.name}: {line}")

    def keep(self, chosen: NDArray[np.bool_] | slice) -> None:
        """Leave out all other samples."""
        self.time, self.u, self.y = self.time[chosen], self.u[chosen], self.y[chosen]
