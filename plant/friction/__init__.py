"""Friction laws, one a file; each file that defines `LAW` is a law of the FMU, scenarios and the command line."""

from __future__ import annotations

from bristle.common.errors import BristleError, suggest
from bristle.common.plugins import catalogue_modules
from bristle.model.declarations import checked_declarations
from bristle.plant.law import FrictionLaw

__all__ = ["law", "laws"]


def laws() -> dict[str, FrictionLaw]:
    """Return all laws by name, in alphabetical order of their files."""
    return checked_declarations(catalogue_modules(__name__, __path__, "laws"), "LAW", FrictionLaw)


def law(name: str) -> FrictionLaw:
    """Return the law `name`; raise `BristleError` for an unknown one."""
    known = laws()
    if name not in known:
        raise BristleError(f"unknown friction law '{name}'{suggest(name, list(known))}; known: {', '.join(known)}")
    return known[name]
