"""Laws, effects and observers of installed packages, which name them as entry points.

The groups are `bristle.laws`, `bristle.effects` and `bristle.observers`. An entry point is called
like what it is, and its value is a module that declares it, as a file of the catalogue does, or the
declaration itself:

    [project.entry-points."bristle.observers"]
    my_observer = "my_package.my_observer"

Nothing is imported before its name is asked for, so that a package that is broken stops nobody who
does not need it.
"""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path

from bristle.common.errors import BristleError
from bristle.common.plugins import told

GROUP_PREFIX = "bristle."  # before a kind of part; the whole is the name of a group of entry points


def offered(kind: str) -> dict[str, list[EntryPoint]]:
    """Return the entry points of a kind (laws, effects, observers) by name, in alphabetical order;
    a name should have one.
    """
    found: dict[str, list[EntryPoint]] = {}
    for entry in sorted(
        entry_points(group=f"{GROUP_PREFIX}{kind}"), key=lambda each: (each.name, _title(each))
    ):
        found.setdefault(entry.name, []).append(entry)
    return found


def packages_of(kind: str, name: str) -> str:
    """Return the packages that offer a name, as errors call them."""
    return " and ".join(f"package {_title(entry)}" for entry in offered(kind)[name])


def load_offered(kind: str, name: str) -> tuple[object, str]:
    """Return what the entry point `name` stands for, and its file as errors name it.

    Raises
    ------
    BristleError
        If two packages offer this name, or the package cannot be imported; the line names the
        package.
    """
    [entry, *others] = offered(kind)[name]
    if others:
        raise BristleError(
            f"{packages_of(kind, name)}: both offer {GROUP_PREFIX}{kind} '{name}'; uninstall one of"
            " them"
        )
    try:
        value = entry.load()
    # a module that leaves the program is a mistake of the package
    except (Exception, SystemExit) as error:
        where = f"package {_title(entry)}: {GROUP_PREFIX}{kind} '{name}' ({entry.value})"
        raise BristleError(f"{where}: {told(error)}; repair or uninstall the package") from error
    return (
        value,
        (
            f"package {_title(entry)}:"
            f" {getattr(sys.modules[entry.module], '__file__', None) or entry.module}"
        ),
    )


def code_offered(kind: str, name: str) -> list[str | bytes]:
    """Return what identifies the code behind a name: packages, versions and all files of Python;
    empty if no package offers it.

    Nothing is imported.
    """
    found: list[str | bytes] = []
    for entry in offered(kind).get(name, []):
        spec = find_spec(entry.module.partition(".")[0])
        folders = [Path(each) for each in spec.submodule_search_locations or ()] if spec else []
        files = [path for folder in folders for path in sorted(folder.rglob("*.py"))]
        if spec and not folders and spec.origin:
            files = [Path(spec.origin)]
        found += [
            _title(entry),
            entry.value,
            *(part for path in files for part in (path.name, path.read_bytes())),
        ]
    return found


def _title(entry: EntryPoint) -> str:
    """Return the name and version of the package of an entry point."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "of no name"
