"""Effects, one a file: a file here with an `EFFECT` is an effect everywhere (composition, docs, tests)."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache

from bristle.common.errors import BristleError
from bristle.common.plugins import catalogue_modules
from bristle.plant.effect import Effect
from bristle.plant.wording import ROTARY, Wording

__all__ = ["effect", "effects", "separation"]


@cache
def _catalogue(wording: Wording) -> dict[str, Effect]:
    """Return what the files here declare, checked, so that a mistake in one is reported at once with its file."""
    files: dict[str, str] = {}
    found = []
    for module, file in catalogue_modules(__name__, __path__, "effects"):
        effect = getattr(module, "EFFECT", None)
        if not isinstance(effect, Effect):
            raise BristleError(f"{file}: no EFFECT; a file there declares one, so put helpers elsewhere")
        if effect.name in files:
            raise BristleError(f"{file}: EFFECT is called '{effect.name}', as in {files[effect.name]}; give it a name of its own")
        for parameter in effect.parameters:
            if not parameter.name.startswith(f"{effect.name}."):
                raise BristleError(f"{file}: parameter '{parameter.name}' must be called '{effect.name}.…'")
        files[effect.name] = file
        found.append(effect)
    for effect in found:
        if unknown := [name for name in effect.confounded if name not in files]:
            listed = ", ".join(files)
            raise BristleError(f"{files[effect.name]}: confounded with unknown effects: {', '.join(unknown)}; known: {listed}")
    return {effect.name: effect.worded(wording) for effect in found}


def effects(wording: Wording = ROTARY) -> dict[str, Effect]:
    """Return all effects by name, in alphabetical order of their files, with the words for an axis in their texts.

    Raise `BristleError` if a file declares none rightly.
    """
    return dict(_catalogue(wording))


def effect(name: str, wording: Wording = ROTARY) -> Effect:
    """Return the effect `name`, with the words for an axis in its texts; raise `BristleError` for an unknown one."""
    known = _catalogue(wording)
    if name not in known:
        raise BristleError(f"unknown effect '{name}'; known: {', '.join(known)}")
    return known[name]


def separation(names: Collection[str], wording: Wording = ROTARY) -> str:
    """Return what to measure to tell the effects of a class apart; empty if the names are not all those of one class."""
    found = [effect(name, wording) for name in names]
    whole = all(set(names) == set(each.group.split("/")) for each in found)
    return next((each.separation for each in found if whole and each.separation), "")
