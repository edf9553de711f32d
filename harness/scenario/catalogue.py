"""Scenarios by name, and FMUs as files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from bristle.common.errors import BristleError, suggest
from bristle.common.output import output_folder, replace_files
from bristle.common.plugins import plugin_files
from bristle.common.toml import read_toml
from bristle.common.work import TemporaryFolder

PYTHON_PROJECT = "pyproject.toml"


def scenario_files() -> dict[str, Path]:
    """Return the scenarios of bristle and of plug-in folders, by name in alphabetical order."""
    by_name: dict[str, Path] = {}
    own = Path(str(files("bristle.scenarios")))
    for path in [*own.glob("*.toml"), *plugin_files("scenarios", ".toml")]:
        if path.stem in by_name:
            raise BristleError(
                f"{path}: a scenario is called '{path.stem}' already, {by_name[path.stem]}; rename"
                " the file"
            )
        by_name[path.stem] = path
    return dict(sorted(by_name.items()))


def scenarios() -> dict[str, str]:
    """Return the titles of these scenarios by name; `BristleError` for a file that is not TOML."""
    return {
        name: str(read_toml(path, "scenario file")[1].get("title", ""))
        for name, path in scenario_files().items()
    }


def find_scenario(given: Path) -> Path:
    """Return the path of a scenario that is given by its path or, if it is one of `scenario_files`,
    by its name.

    Those of `reproduce` are not listed; their names begin with the folder, as in
    `reproduce/printed`.

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
    if given.name not in known and given.exists():
        return given  # a folder or a pipe: what reads the file says so
    if given.name not in known:
        near = suggest(given.name, list(known))
        raise BristleError(
            f"scenario '{given}': no such file or name{near}; give a path or one of:"
            f" {', '.join(known)}"
        )
    return known[given.name]


def is_scenario(path: Path) -> bool:
    """True for a TOML file with a table [observer], and for one that is broken, which then fails;
    never for pyproject.toml.
    """
    if path.name == PYTHON_PROJECT:
        return False
    try:
        return "observer" in read_toml(path, "scenario file")[1]
    except BristleError:
        return True


@dataclass(frozen=True)
class Choice:
    """What an FMU holds: one law or method, or all; effects of the plant, and whether it has its
    encoder; what it runs on.
    """

    law: str | None = None
    method: str | None = None
    effects: Sequence[str] = ()
    encoder: bool = True
    platforms: str = "host"


def build_files(
    choices: Mapping[str, Choice],
    out: Path,
    *,
    fmi: int,
    kind: str,
    tell: Callable[[str, float], None] = lambda text, share: None,
) -> list[Path]:
    """Build FMUs into the folder `out`, named after what they are: all or none.

    Parameters
    ----------
    choices : mapping of str to Choice
        By what is built: plant, observer, controller.
    out : Path
        The folder; created if it is missing.
    fmi, kind : int, str
        As of `bristle.fmus.build`.
    tell : function, optional
        Called with what is built next and the share that is done.

    Raises
    ------
    BristleError
        As of `bristle.fmus.build`; the folder is then as it was.
    """
    from bristle.fmus import build

    names = {"plant": "ServoPlant", "observer": "AdaptiveObserver", "controller": "Controller"}
    with output_folder(out), TemporaryFolder("build") as folder:
        made: list[Path] = []
        for what, choice in choices.items():
            variant = choice.law or choice.method
            stem = "_".join(
                [names.get(what, what), *([variant] if variant else []), *sorted(choice.effects)]
            )
            tell(f"building {stem}", len(made) / len(choices))
            made.append(
                build(what, Path(folder) / f"{stem}.fmu", fmi=fmi, kind=kind, **vars(choice))
            )
        return replace_files(
            out, {path.name: path.read_bytes() for path in made}, [path.name for path in made]
        )
