"""Adaptive observers, one a file; each file that defines `METHOD` is a method of the FMU, scenarios and the command line."""

from __future__ import annotations

from bristle.common.errors import BristleError
from bristle.common.plugins import catalogue_modules
from bristle.model.declarations import checked_declarations
from bristle.model.program import Program
from bristle.observer.method import Method, observer

__all__ = ["methods", "observer_program"]


def methods() -> dict[str, Method]:
    """Return all methods by name, in alphabetical order of their files."""
    return checked_declarations(catalogue_modules(__name__, __path__, "observers"), "METHOD", Method)


def observer_program(method: str | None = None) -> Program:
    """Return the observers as a program: all methods behind the selector `method`, or one alone.

    Raises
    ------
    BristleError
        If the method is unknown.
    """
    known = methods()
    if method is None:
        systems = [observer(each) for each in known.values()]
        about = "adaptive observer, chosen by the parameter method"
        return Program("AdaptiveObserver", systems, "method", about, chosen="bastin_gevers")
    if method not in known:
        raise BristleError(f"unknown observer '{method}'; known: {', '.join(known)}")
    return Program(f"AdaptiveObserver_{method}", [observer(known[method])])
