"""From a program to an FMU."""

from bristle.fmus.build import build, obtain

__all__ = ["build", "obtain"]
