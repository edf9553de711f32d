"""The exceptions a user can meet, and the near miss they suggest."""

from __future__ import annotations

from collections.abc import Sequence


class BristleError(ValueError):
    """A mistake in what the user gave: one line that says what, where, what is allowed and what to do."""


class SimulationError(BristleError):
    """A simulation that cannot go on: a state left the finite numbers or the internal-step cap was hit.

    Attributes
    ----------
    time : float
        Simulated time in seconds at which it stopped.
    """

    def __init__(self, message: str, time: float) -> None:
        super().__init__(message)
        self.time = time


def suggest(word: str, known: Sequence[str]) -> str:
    """Return " (did you mean 'x'?)" or nothing."""
    import difflib

    near = difflib.get_close_matches(word, known, 1, 0.6)
    return f" (did you mean '{near[0]}'?)" if near else ""
