"""Effects, one a file: a file here with an `EFFECT` is an effect everywhere (composition, docs,
tests).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache

from bristle.common.errors import BristleError, suggest
from bristle.common.packages import offered
from bristle.common.plugins import catalogue_modules
from bristle.model.declarations import (
    checked_declarations,
    packaged_declaration,
    packaged_declarations,
)
from bristle.model.normalised import OBSERVED
from bristle.plant.controller import CONTROLLER
from bristle.plant.effect import NEEDS, VIEWS, Effect
from bristle.plant.known import KNOWN
from bristle.plant.unnamed_torque import UNNAMED_TORQUES
from bristle.plant.wording import ROTARY, Wording

__all__ = ["BESIDE", "effect", "effects", "owners_of_inputs", "separation"]

BESIDE = {
    **UNNAMED_TORQUES,
    CONTROLLER.name: CONTROLLER,
    KNOWN.name: KNOWN,
}  # a model may have them, none is tried


@cache
def _catalogue(wording: Wording, packages: bool) -> dict[str, Effect]:
    """Return what the files here declare, checked, so that a mistake in one is reported at once
    with its file.
    """
    if packages:
        own = _catalogue(wording, False)
        added = packaged_declarations("effects", "EFFECT", Effect, own, _check)
        return own | {name: effect.worded(wording) for name, effect in added.items()}
    found = checked_declarations(
        catalogue_modules(__name__, __path__, "effects"), "EFFECT", Effect, _check
    )
    return {name: effect.worded(wording) for name, effect in found.items()}


def _check(effect: Effect, known: Mapping[str, Effect]) -> None:
    """Raise `BristleError` if an effect names a parameter, a view, another effect or a placeholder
    that there is not.
    """
    own = [p.name.removeprefix(f"{effect.name}.") for p in effect.parameters]
    shapes = [name for start in effect.shape_starts for name in start]
    others = [effect.periods, effect.free_play]
    of_parameters = {
        "off": effect.off,
        "unused": effect.unused,
        "search_interval": effect.search_interval,
        "shape_starts": shapes,
        "second_term": effect.second_term,
        "periods or free_play": [name for name in others if name],
    }
    for key, names in of_parameters.items():
        _must_know(key, names, own, "parameter of the effect")
    _must_know("residual", effect.residual, list(VIEWS), "view")
    _must_know("without_truth", effect.without_truth, list(OBSERVED), "normalised parameter")
    _must_know("needs", effect.needs, list(NEEDS), "thing that records may lack")
    _must_know("confounded", effect.confounded, list(known), "effect")
    _must_know("group", effect.group.split("/"), list(known), "effect")
    if effect.name not in effect.group.split("/"):
        raise BristleError(
            f"group '{effect.group}' lacks '{effect.name}'; write the names of its effects with /"
            " between"
        )
    effect.worded(ROTARY)


def _must_know(key: str, names: Iterable[str], known: Sequence[str], what: str) -> None:
    for name in names:
        if name not in known:
            raise BristleError(
                f"{key}: '{name}' is no {what}{suggest(name, known)}; known: {', '.join(known)}"
            )


def effects(wording: Wording = ROTARY, packages: bool = True) -> dict[str, Effect]:
    """Return all effects by name, in alphabetical order of their files, with the words for an axis
    in their texts.

    Those of installed packages follow, unless `packages` is False. Raise `BristleError` if a file
    declares none rightly.
    """
    return dict(_catalogue(wording, packages))


def effect(name: str, wording: Wording = ROTARY) -> Effect:
    """Return the effect `name`, with the words for an axis in its texts; raise `BristleError` for
    an unknown one.

    The unnamed torques, the controller and what is known are found too, although they are not among
    `effects`.
    """
    if (beside := BESIDE.get(name)) is not None:
        return beside.worded(wording)
    own = _catalogue(wording, False)
    return own[name] if name in own else _packaged(name, wording)


@cache
def _packaged(name: str, wording: Wording) -> Effect:
    """Return the effect of an installed package; a mistake in another one does not matter."""
    own, names = _catalogue(wording, False), offered("effects")
    if name not in names:
        known = list(dict.fromkeys([*own, *names]))
        raise BristleError(
            f"unknown effect '{name}'{suggest(name, known)}; known: {', '.join(known)}"
        )
    return packaged_declaration("effects", name, "EFFECT", Effect, own, _check).worded(wording)


def owners_of_inputs() -> dict[str, str]:
    """Return the effect that each known quantity is an input of, by what a file calls it; those of
    `KNOWN` are not among them.
    """
    return {own.name: each.name for each in effects().values() for own in each.inputs}


def separation(names: Collection[str], wording: Wording = ROTARY) -> str:
    """Return what to measure to tell the effects of a class apart; empty if the names are not all
    those of one class.
    """
    found = [effect(name, wording) for name in names]
    whole = all(set(names) == set(each.group.split("/")) for each in found)
    return next((each.separation for each in found if whole and each.separation), "")
