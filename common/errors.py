"""The exceptions of the library, all in one tree, and suggestions for a misspelt word.

    Exception
    ├── ValueError
    │   └── BristleError           what the user gave cannot be used; the base of all that follow
    │       ├── SimulationError    a simulation cannot go on (an ArithmeticError too)
    │       ├── EquationError      equations are incomplete, or cannot be composed
    │       ├── RestartError       an FMU cannot be started again from given states
    │       ├── IncompleteError    one of several outputs could not be made; the others were written
    │       ├── NotStaticError     the inverse dynamics need states that are not measured
    │       ├── CasesError         of harness: cases of a suite cannot be run, so none is
    │       ├── ScenarioError      of harness: a scenario that pytest runs did not pass
    │       ├── NotApplicable      of fmus: a point asks for what the FMU does not claim to do
    │       ├── CallFailed         of fmus: a call that the standard allows was not done
    │       └── Ended              of fmus: an FMU asks to end the simulation, as it may
    └── RuntimeError
        ├── CoreError              bristle.model.runtime
        └── RefusedError           bristle.fmus.slave
    BaseException
    ├── Interrupted                bristle.cli.terminal: Ctrl-C or SIGTERM
    └── OutOfTime                  bristle.common.deadline: work under a time budget is left

`except BristleError` catches whatever the library reports. CoreError and RefusedError are raised
inside an FMU, where the library is not installed: their modules are copied into it, and the
importing tool turns them into an FMI error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = [
    "BristleError",
    "EquationError",
    "IncompleteError",
    "NotStaticError",
    "RestartError",
    "SimulationError",
    "suggest",
]


class BristleError(ValueError):
    """A mistake in what the user gave: one line on what, where, what is allowed, what to do."""


class SimulationError(BristleError, ArithmeticError):
    """A simulation that cannot go on: a state is not finite, or the cap of steps was hit.

    Attributes
    ----------
    time : float
        Simulated time in seconds at which it stopped.
    """

    def __init__(self, message: str, time: float = math.nan) -> None:
        super().__init__(message)
        self.time = time


class EquationError(BristleError):
    """Equations that are incomplete, contradict each other or cannot be composed."""


class RestartError(BristleError):
    """An FMU that cannot be started from given states more than once in one process."""


class IncompleteError(BristleError):
    """One of several outputs could not be made; the others were written."""


class NotStaticError(BristleError):
    """The acceleration of a model depends on more than position, velocity, input and time."""


def suggest(word: str, known: Sequence[str]) -> str:
    """Return " (did you mean 'x'?)" or nothing."""
    import difflib

    near = difflib.get_close_matches(word, known, 1, 0.6)
    return f" (did you mean '{near[0]}'?)" if near else ""
