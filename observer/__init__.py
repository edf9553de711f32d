"""Adaptive observers, one a file; each file that defines `METHOD` is a method of the FMU, scenarios
and the command line.
"""

from __future__ import annotations

from collections.abc import Mapping

from bristle.common.errors import BristleError, suggest
from bristle.common.packages import offered
from bristle.common.plugins import catalogue_modules
from bristle.model.declarations import (
    checked_declarations,
    packaged_declaration,
    packaged_declarations,
)
from bristle.model.program import Program
from bristle.observer.method import Method, observer

__all__ = ["estimated", "methods", "observer_program"]


def methods(packages: bool = False) -> dict[str, Method]:
    """Return all methods by name, in alphabetical order of their files; with `packages`, those of
    installed packages follow.

    The observer of all methods has none of a package: installing one changes no FMU.
    """
    own = checked_declarations(catalogue_modules(__name__, __path__, "observers"), "METHOD", Method)
    return own | packaged_declarations("observers", "METHOD", Method, own) if packages else own


def observer_program(method: str | None = None) -> Program:
    """Return the observers as a program: all methods behind the selector `method`, or one alone,
    also of an installed package.

    Raises
    ------
    BristleError
        If the method is unknown.
    """
    own = methods()
    if method is None:
        systems = [observer(each) for each in own.values()]
        about = "adaptive observer, chosen by the parameter method"
        return Program("AdaptiveObserver", systems, "method", about).choosing("bastin_gevers")
    return Program(f"AdaptiveObserver_{method}", [observer(_chosen(method, own))])


def estimated(method: str) -> list[str]:
    """Return the signals and parameters that a method estimates, in the order of its outputs; its
    others are always 0.

    Raises
    ------
    BristleError
        If the method is unknown.
    """
    outputs = observer(_chosen(method, methods())).outputs
    said = {name for name, (_, value) in outputs.items() if not value.is_zero()}
    hats = [name.removesuffix("_hat") for name in outputs if name.endswith("_hat")]
    return [
        name
        for name in hats
        if said & {f"{name}_{each}" for each in ("hat", "hat_valid", "valid", "sd")}
    ]


def _chosen(method: str, own: Mapping[str, Method]) -> Method:
    known = list(dict.fromkeys([*own, *offered("observers")]))
    if method not in known:
        raise BristleError(
            f"unknown observer '{method}'{suggest(method, known)}; known: {', '.join(known)}"
        )
    return (
        own[method]
        if method in own
        else packaged_declaration("observers", method, "METHOD", Method, own)
    )
