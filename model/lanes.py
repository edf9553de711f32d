"""Several instances of a program in step, one in each lane of the processor's vectors, with the
digits of one alone.
"""

from __future__ import annotations

import ctypes
import logging
import platform
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bristle.common.cache import cached, digest
from bristle.common.errors import BristleError
from bristle.model.compiler import SUFFIX, Target, compile_shared, compiler_identity
from bristle.model.native import pointer
from bristle.model.program import Program
from bristle.model.sources import fingerprint, lanes_sources
from bristle.model.system import FRICTION_STEP, MAX_STEP, MAX_STEPS, SAMPLE_TIME

Array = NDArray[np.float64]
# parameters that all lanes must share
TIMING = tuple(each.name for each in (SAMPLE_TIME, MAX_STEP, MAX_STEPS, FRICTION_STEP))
# its widest vectors; without it where the compiler does not know the flag
OWN_PROCESSOR = "-march=native"
ANY_WIDTH = (
    # compiles in three quarters of the time, as fast afterwards: of what is compiled for a few runs
    # only
    "-O2",
    # functions that pass wider vectors than the processor has are called in here only
    "-Wno-psabi",
)


class Lanes:
    """Several instances of one program.

    Parameters
    ----------
    program : Program
        With one variant.
    width : int, optional
        How many: 2, 4 or 8; as many as the processor's vectors have lanes by default.
    what : str, optional
        What is said to be compiled, once a process, if it is not in the cache.
    """

    def __init__(self, program: Program, width: int = 0, what: str = "") -> None:
        options = (*ANY_WIDTH, f"-DLANES={width}") if width else ()
        self.program, self.library = program, _compiled(program, options, what)
        self.width = int(self.library.lanes_width())
        self._reserve()

    def twin(self) -> Lanes:
        """Return as many more instances of the same program."""
        other = copy(self)
        other._reserve()
        return other

    def _reserve(self) -> None:
        size = int(self.library.lanes_size())
        room = np.zeros(size + 64, dtype=np.uint8)
        begin = -room.ctypes.data % 64  # vectors are aligned
        self._memory = room[begin : begin + size]

    @property
    def address(self) -> int:
        """Where the library finds it."""
        return int(self._memory.ctypes.data)

    def place(self, name: str, lane: int) -> int:
        """Return the address of a variable."""
        return self.address + 8 * self.reference(name, lane)

    def reference(self, name: str, lane: int) -> int:
        """Return by which number `lanes_get` knows a variable."""
        return self.program.index[name] * self.width + lane

    def initialise(
        self,
        values: Sequence[Mapping[str, float]],
        time: float,
        driven: Mapping[str, tuple[float, float]],
    ) -> None:
        """Set each lane to its start.

        Parameters
        ----------
        values : sequence of mapping of str to float, one a lane
            Parameters and start values of inputs, in the program's units.
        time : float
            Start time [s].
        driven : mapping of str to (low, high)
            Inputs that will be set; a lane fails where one is outside these limits, or is no
            number.

        Raises
        ------
        BristleError
            If the lanes differ in one of `TIMING`.
        """
        table = np.repeat(np.array(self.program.starts)[:, None], self.width, axis=1)
        for lane, given in enumerate(values):
            for name, value in given.items():
                table[self.program.index[name], lane] = value
        for name in TIMING:
            if name in self.program.index and np.ptp(table[self.program.index[name]]):
                raise BristleError(
                    f"{self.program.name}: '{name}' differs between lanes; run those alone"
                )
        self.begin(table, time, driven)

    def begin(
        self,
        table: Array,
        time: float = 0.0,
        driven: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        """Set the lanes to the start of a whole `table` (variables, lanes), in which parameters of
        `TIMING` are alike.
        """
        driven = driven or {}
        places = np.array([self.program.index[name] for name in driven], dtype=np.int32)
        low, high = (
            np.array([pair[end] for pair in driven.values()], dtype=float) for end in (0, 1)
        )
        self.library.lanes_initialise(
            ctypes.c_void_p(self.address),
            pointer(table),
            ctypes.c_double(time),
            len(places),
            pointer(places),
            pointer(low),
            pointer(high),
        )

    def alive(self, lane: int) -> bool:
        """Say whether a lane has come so far without a failure."""
        return bool(self.library.lanes_alive(ctypes.c_void_p(self.address), lane))

    def function(self, name: str) -> int:
        """Return the address of a function of the library."""
        return ctypes.cast(getattr(self.library, name), ctypes.c_void_p).value or 0


def _compiled(program: Program, options: tuple[str, ...], what: str) -> ctypes.CDLL:
    """Compile a program for this processor (or take it from the cache) and load it."""
    try:
        return _library(program, Target(options=(OWN_PROCESSOR, *options)), what)
    except BristleError:  # a compiler that does not know this flag
        return _library(program, Target(options=options), what)


def _library(program: Program, target: Target, what: str) -> ctypes.CDLL:
    def make(out: Path) -> None:
        if what:
            _tell(what)
        compile_shared(lanes_sources(program), out, target)

    key = digest(*target.flags(), compiler_identity(), _processor(), *fingerprint(program))
    return ctypes.CDLL(str(cached(f"{program.name}-lanes-{key[:24]}{SUFFIX}", make)))


@cache
def _tell(what: str) -> None:
    message = "compiling %s once, a few seconds each; later calls take them from the cache"
    logging.getLogger("bristle").info(message, what)


@lru_cache(maxsize=1)
def _processor() -> str:
    """Return what tells processors with other vectors apart."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    features = {line for line in lines if line.startswith(("flags", "Features"))}
    return " ".join([platform.machine(), platform.processor(), *sorted(features)])
