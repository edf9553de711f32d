"""Scenarios by name, and FMUs as files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from bristle.common.errors import BristleError, suggest
from bristle.common.output import output_folder
from bristle.common.plugins import plugin_files
from bristle.common.toml import read_toml


def scenario_files() -> dict[str, Path]:
    """Return the scenarios that come with bristle, and those in plug-in folders, by name in alphabetical order."""
    found: dict[str, Path] = {}
    own = Path(str(files("bristle.scenarios")))
    for path in [*own.glob("*.toml"), *plugin_files("scenarios", ".toml")]:
        if path.stem in found:
            raise BristleError(f"{path}: a scenario is called '{path.stem}' already, {found[path.stem]}; rename the file")
        found[path.stem] = path
    return dict(sorted(found.items()))


def scenarios() -> dict[str, str]:
    """Return the titles of these scenarios by name; raise `BristleError` for a file that is not TOML."""
    return {name: str(read_toml(path, "scenario file")[1].get("title", "")) for name, path in scenario_files().items()}


def find_scenario(given: Path) -> Path:
    """Return the path of a scenario that is given by its path or, if it is one of `scenario_files`, by its name.

    Those of `reproduce` are not listed; their names begin with the folder, as in `reproduce/printed`.

    Raises
    ------
    BristleError
        If a name, without folder and suffix, is neither a file nor such a scenario.
    """
    if not given.is_file() and given.parent == Path("reproduce"):
        shipped = Path(str(files("bristle.scenarios"))) / given.with_suffix(".toml")
        return shipped if shipped.is_file() else given
    if given.is_file() or given.name != str(given) or given.suffix:
        return given
    known = scenario_files()
    if given.name not in known and given.is_dir():
        return given  # a folder: what reads the file says so
    if given.name not in known:
        near = suggest(given.name, list(known))
        raise BristleError(f"scenario '{given}': no such file or name{near}; give a path or one of: {', '.join(known)}")
    return known[given.name]


@dataclass(frozen=True)
class Choice:
    """What an FMU holds: one law or method, or all; effects of the plant, and whether it has its encoder; what it runs on."""

    law: str | None = None
    method: str | None = None
    effects: Sequence[str] = ()
    encoder: bool = True
    platforms: str = "host"


def build_file(what: str, out: Path, *, fmi: int, kind: str, choice: Choice) -> Path:
    """Build an FMU into the folder `out`, named after what it is."""
    from bristle.fmus import build

    names = {"plant": "ServoPlant", "observer": "AdaptiveObserver", "controller": "Controller"}
    variant = choice.law or choice.method
    stem = "_".join([names.get(what, what), *([variant] if variant else []), *sorted(choice.effects)])
    with output_folder(out):
        return build(what, out / f"{stem}.fmu", fmi=fmi, kind=kind, **vars(choice))
