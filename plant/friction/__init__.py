"""Friction laws, one a file; each file that defines `LAW` is a law of the FMU, scenarios and the
command line.
"""

from __future__ import annotations

from bristle.common.errors import BristleError, suggest
from bristle.common.packages import offered
from bristle.common.plugins import catalogue_modules
from bristle.model.declarations import (
    checked_declarations,
    packaged_declaration,
    packaged_declarations,
)
from bristle.plant.law import FrictionLaw

__all__ = ["law", "law_names", "laws"]


def laws(packages: bool = False) -> dict[str, FrictionLaw]:
    """Return all laws by name, in alphabetical order of their files; with `packages`, those of
    installed packages follow.

    The plant of all laws has none of a package: installing one changes no FMU.
    """
    own = checked_declarations(catalogue_modules(__name__, __path__, "laws"), "LAW", FrictionLaw)
    return own | packaged_declarations("laws", "LAW", FrictionLaw, own) if packages else own


def law_names() -> list[str]:
    """Return the names of all laws, those of installed packages too, which are not imported."""
    return list(dict.fromkeys([*laws(), *offered("laws")]))


def law(name: str) -> FrictionLaw:
    """Return the law `name`, also of an installed package; `BristleError` for an unknown one."""
    own = laws()
    if name in own:
        return own[name]
    known = law_names()
    if name not in known:
        raise BristleError(
            f"unknown friction law '{name}'{suggest(name, known)}; known: {', '.join(known)}"
        )
    return packaged_declaration("laws", name, "LAW", FrictionLaw, own)
