"""What holds for every declaration of a law, an effect or an observer; errors name the file."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol, TypeVar

from bristle.common.errors import BristleError, suggest
from bristle.common.packages import load_offered, offered, packages_of
from bristle.common.plugins import CatalogueFile, declarations, plugin_roots
from bristle.common.units import parse_unit
from bristle.model.variables import Parameter, State

__all__ = ["checked_declarations", "packaged_declaration", "packaged_declarations", "source_keys"]

NAME = re.compile(r"[a-z][a-z0-9_]*")  # of a law, an effect or an observer
ENTRY = re.compile(r"^@\w+\{([^,\s]+),", re.MULTILINE)  # of a BibTeX file
# what looks like a key of a source: name and year
SOURCE_KEY = re.compile(r"\b[a-z]+(?:19|20)\d\d[a-z]?\b")


class Part(Protocol):
    """A friction law, an effect or an observer."""

    @property
    def name(self) -> str: ...

    @property
    def description(self) -> str: ...

    @property
    def source(self) -> str: ...

    @property
    def parameters(self) -> tuple[Parameter, ...]: ...

    @property
    def states(self) -> tuple[State, ...]: ...

    @property
    def file(self) -> str: ...


P = TypeVar("P", bound=Part)


def checked_declarations(
    found: Iterable[CatalogueFile],
    attribute: str,
    kind: type[P],
    more: Callable[[Any, Mapping[str, P]], None] | None = None,
) -> dict[str, P]:
    """Return what the files declare as `attribute`, by name in the order of the files, each
    declaration checked.

    Parameters
    ----------
    found : iterable of CatalogueFile
        The files of a catalogue.
    attribute, kind : str, type
        Name and class of what a file declares.
    more : function, optional
        Checks a declaration further, given all by name.

    Raises
    ------
    BristleError
        One line that names the file: a name, a unit, an interval or a source is wrong, or what
        `more` finds.
    """
    found = list(found)
    declared = declarations(found, attribute, kind)
    plugins = {each.file for each in found if each.plugin}
    by_name = {}
    for file, part in declared.items():
        place = file if file in plugins else ""
        # law, effect or method: each a dataclass
        by_name[part.name] = replace(part, file=place)  # type: ignore[type-var]
    for file, part in declared.items():
        with _naming(file, attribute):
            _check(part)
            if file in plugins:  # a test checks the sources of what is shipped
                _check_sources(part, source_keys())
            if more is not None:
                more(part, by_name)
    return by_name


def packaged_declaration(
    folder: str,
    name: str,
    attribute: str,
    kind: type[P],
    own: Mapping[str, P],
    more: Callable[[Any, Mapping[str, P]], None] | None = None,
) -> P:
    """Return what an installed package declares under a name that `offered` has, checked.

    Parameters
    ----------
    folder, name : str
        Kind of the part (laws, effects, observers) and its name.
    attribute, kind, more
        As of `checked_declarations`.
    own : mapping of str to kind
        What comes with bristle and from plug-in folders, whose names are taken.

    Raises
    ------
    BristleError
        One line that names the package.
    """
    if name in own:
        title = packages_of(folder, name)
        raise BristleError(
            f"{title}: {attribute} is called '{name}', as one that bristle has already; give it a"
            " name of its own"
        )
    value, file = load_offered(folder, name)
    part = value if isinstance(value, kind) else getattr(value, attribute, None)
    if not isinstance(part, kind):
        raise BristleError(
            f"{file}: no {attribute} that is a {kind.__name__}; declare one, or correct the entry"
            f" point '{name}'"
        )
    with _naming(file, attribute):
        if part.name != name:
            raise BristleError(
                f"declares '{part.name}', its entry point is called '{name}'; give both the same"
                " name"
            )
        _check(part)
        _check_sources(part, source_keys() | _keys(Path(file.rpartition(": ")[2]).parent))
        if more is not None:
            more(part, {**own, name: part})
    return replace(part, file=file)  # type: ignore[type-var]  # law, effect or method: each a dataclass


def packaged_declarations(
    folder: str,
    attribute: str,
    kind: type[P],
    own: Mapping[str, P],
    more: Callable[[Any, Mapping[str, P]], None] | None = None,
) -> dict[str, P]:
    """Return by name what installed packages declare (see `packaged_declaration`); a warning tells
    what is left out.
    """
    found = {}
    for name in offered(folder):
        try:
            found[name] = packaged_declaration(folder, name, attribute, kind, own, more)
        except BristleError as error:
            _warn(f"left out: {error}")
    return found


@cache
def _warn(text: str) -> None:
    """Log a warning, once."""
    logging.getLogger("bristle").warning(text)


@contextmanager
def _naming(file: str, attribute: str) -> Iterator[None]:
    """Let an error in a declaration name its file."""
    try:
        yield
    except BristleError as error:
        raise BristleError(f"{file}: {error}") from None
    except (AttributeError, KeyError, TypeError, ValueError) as error:  # something of another type
        raise BristleError(
            f"{file}: {attribute} is malformed: {type(error).__name__}: {error}; copy a shipped"
            " file"
        ) from error


def _check(part: Part) -> None:
    if NAME.fullmatch(part.name) is None:
        raise BristleError(
            f"name '{part.name}': write lower-case letters, digits and _, with a letter first"
        )
    for parameter in part.parameters:
        _check_parameter(part.name, parameter)
    for state in part.states:
        _check_unit(f"state '{state.name}'", state.unit)


def _check_parameter(owner: str, p: Parameter) -> None:
    where = f"parameter '{p.name}'"
    if not p.name.startswith(f"{owner}."):
        raise BristleError(f"{where} must be called '{owner}.…'")
    _check_unit(where, p.unit)
    if not p.minimum <= p.default <= p.maximum:
        raise BristleError(
            f"{where}: default {p.default:g} is outside [{p.minimum:g}, {p.maximum:g}] {p.unit};"
            " correct one"
        )


def _check_unit(where: str, unit: str) -> None:
    try:
        factor = parse_unit(unit).factor
    except BristleError as error:
        raise BristleError(f"{where}: {error}") from None
    if abs(factor - 1.0) > 1e-12:
        raise BristleError(f"{where}: unit '{unit}' is {factor:g} of the SI unit; declare it in SI")


def _check_sources(part: Part, known: frozenset[str]) -> None:
    for where, source in [
        ("", part.source),
        *((f"parameter '{p.name}': ", p.source) for p in part.parameters),
    ]:
        keys = SOURCE_KEY.findall(source)
        unknown = [key for key in keys if key not in known]
        if unknown or not keys:
            said = (
                f"'{unknown[0]}' is no key{suggest(unknown[0], sorted(known))}"
                if unknown
                else "names no key"
            )
            remedy = (
                "correct it, or add an entry to a references.bib in the folder of the plug-ins, or"
                " beside the module of a package"
            )
            raise BristleError(f"{where}source '{source}': {said} of references.bib; {remedy}")


def source_keys() -> frozenset[str]:
    """Return the keys of references.bib, and of those in the folders of BRISTLE_PLUGINS."""
    return _own_keys().union(*(_keys(root) for root in plugin_roots()))


def _keys(folder: Path) -> frozenset[str]:
    """Return the keys of the references.bib in a folder, which need not have one."""
    path = folder / "references.bib"
    return (
        frozenset(ENTRY.findall(path.read_text(encoding="utf-8")))
        if path.is_file()
        else frozenset()
    )


@cache
def _own_keys() -> frozenset[str]:
    """Return the keys of the library's references.bib, from the list in the package."""
    return frozenset(
        Path(str(files("bristle.model") / "source_keys.txt")).read_text(encoding="utf-8").split()
    )
