"""The adaptive observers, all methods or one."""

from __future__ import annotations

from bristle.model.program import Program


def program(method: str | None = None) -> Program:
    """Return AdaptiveObserver."""
    from bristle.observer import observer_program

    return observer_program(method)
