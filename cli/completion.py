"""What Tab completes: names of laws, methods, effects and scenarios, from file names and texts.

Nothing of a catalogue is imported: its imports take longer than a user waits for Tab, and a broken
plug-in would print there.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path

from bristle.common.errors import BristleError
from bristle.common.packages import offered
from bristle.common.plugins import plugin_files

# suffixes of files that stand where the name of a scenario may
RUNNABLE = (".toml", ".ssp", ".fmu", ".exp")
SIGNAL_EFFECT = re.compile(r'^[A-Z_]+ = Extension\(\s*"(\w+)"', re.MULTILINE)


def complete_law(incomplete: str) -> list[str]:
    """Return the friction laws that begin so."""
    return _beginning(_declared("bristle.plant.friction", "laws", "LAW"), incomplete)


def complete_method(incomplete: str) -> list[str]:
    """Return the observer methods that begin so."""
    return _beginning(_declared("bristle.observer", "observers", "METHOD"), incomplete)


def complete_effect(incomplete: str) -> list[str]:
    """Return the effects of a diagnosis that begin so."""
    return _beginning(_declared("bristle.plant.effects", "effects", "EFFECT"), incomplete)


def complete_effects(incomplete: str) -> list[str]:
    """Return lists of effects, those on signals too, whose last name begins so; those before it
    stay, and are not offered again.
    """
    before, comma, last = incomplete.rpartition(",")
    signals = _folder("bristle.plant") / "signal_effects.py"
    known = [*complete_effect(""), *SIGNAL_EFFECT.findall(signals.read_text(encoding="utf-8"))]
    listed = [name.strip() for name in before.split(",")]
    return [f"{before}{comma}{name}" for name in _beginning(known, last) if name not in listed]


def complete_scenario(incomplete: str) -> list[str]:
    """Return the scenarios that begin so, with files and folders; nothing if no scenario does: the
    shell then offers files.
    """
    own = _folder("bristle.scenarios")
    if incomplete.startswith("reproduce/"):
        return _beginning(
            sorted(f"reproduce/{path.stem}" for path in own.glob("reproduce/*.toml")), incomplete
        )
    paths = [*own.glob("*.toml"), *_plugins("scenarios", ".toml")]
    names = _beginning(sorted(path.stem for path in paths), incomplete)
    return [*names, *_beginning(sorted(_runnable()), incomplete)] if names else []


def _runnable() -> Iterator[str]:
    """Give what stands in the current folder and may be run, a folder of scenarios too."""
    for path in Path().glob("*"):
        if path.is_dir() and not path.name.startswith("."):
            yield f"{path.name}/"
        elif path.suffix.lower() in RUNNABLE:
            yield path.name


def _declared(package: str, kind: str, attribute: str) -> list[str]:
    """Return the names that the files of a catalogue declare, and those of plug-in folders and
    installed packages.

    A name that is not written out in the declaration is taken to be that of the file, as it is in
    the package.
    """
    declaration = re.compile(
        rf'^{attribute}\b[^(\n]*=[^(\n]*(?:\(\s*(?:name=)?"(\w+)")?', re.MULTILINE
    )
    paths = [*_folder(package).glob("*.py"), *_plugins(kind, ".py")]
    found = []
    for path in sorted(paths, key=lambda each: each.stem):
        match = declaration.search(path.read_text(encoding="utf-8", errors="replace"))
        if match:
            found.append(match[1] or path.stem)
    return list(dict.fromkeys([*found, *offered(kind)]))


def _plugins(kind: str, suffix: str) -> list[Path]:
    """Return the files of plug-in folders; none if the variable is wrong, of which the command
    itself tells.
    """
    try:
        return plugin_files(kind, suffix)
    except BristleError:
        return []


def _folder(package: str) -> Path:
    """Return the folder of a package, which is not imported."""
    spec = find_spec(package)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0])


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
