"""Which call of which FMU is under way, in memory that another process can read."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Control = NDArray[np.int64]

# [0] items done, [1] not 0: stop, [2] call under way, [3] place of its FMU, [4] counts calls: a
# sign of life
CONTROL_SIZE = 5


class Call(IntEnum):
    """What a host asks an FMU to do; `step` includes its inputs and outputs."""

    none = 0
    load = 1
    instantiate = 2
    initialise = 3
    step = 4
    free = 5


class Watch:
    """Writes down each call; nothing as long as no memory is given."""

    def __init__(self) -> None:
        self._control: Control | None = None
        self._paths: list[Path] = []

    def start(self, control: Control, paths: Sequence[Path]) -> None:
        """Write from now on into `control`, shape (CONTROL_SIZE,); FMUs by places in `paths`."""
        self._control, self._paths = control, list(paths)

    def begin(self, path: Path, call: Call) -> None:
        """Note that a call begins."""
        if self._control is not None:
            self._control[3] = self._paths.index(path) if path in self._paths else -1
            self._control[2] = call
            self._control[4] += 1

    def end(self) -> None:
        """Note that no call is under way."""
        if self._control is not None:
            self._control[2] = Call.none


WATCH = Watch()  # of this process
