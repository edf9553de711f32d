"""Effects, one a file: a file here with an `EFFECT` is an effect everywhere (composition, docs, tests)."""

from __future__ import annotations

import importlib
import pkgutil

from bristle.model.errors import BristleError
from bristle.plant.effect import Effect


def effects() -> dict[str, Effect]:
    """Return all effects by name, in alphabetical order of their files."""
    modules = sorted(module.name for module in pkgutil.iter_modules(__path__))
    found = [importlib.import_module(f"{__name__}.{name}").EFFECT for name in modules]
    return {effect.name: effect for effect in found}


def effect(name: str) -> Effect:
    """Return the effect `name`; raise `BristleError` for an unknown one."""
    known = effects()
    if name not in known:
        raise BristleError(f"unknown effect '{name}'; known: {', '.join(known)}")
    return known[name]
