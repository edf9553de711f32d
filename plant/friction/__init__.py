"""Friction laws, one a file: a file here with a `LAW` is a law everywhere (FMU, scenarios, command line)."""

from __future__ import annotations

import importlib
import pkgutil

from bristle.common.errors import BristleError
from bristle.model.variables import unique
from bristle.plant.law import FrictionLaw

__all__ = ["law", "laws"]


def laws() -> dict[str, FrictionLaw]:
    """Return all laws by name, in alphabetical order of their files."""
    modules = sorted(module.name for module in pkgutil.iter_modules(__path__))
    found = [getattr(importlib.import_module(f"{__name__}.{name}"), "LAW", None) for name in modules]
    return unique([law for law in found if law is not None], "friction law")


def law(name: str) -> FrictionLaw:
    """Return the law `name`; raise `BristleError` for an unknown one."""
    known = laws()
    if name not in known:
        raise BristleError(f"unknown friction law '{name}'; known: {', '.join(known)}")
    return known[name]
