"""The exceptions a user can meet."""

from __future__ import annotations


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
