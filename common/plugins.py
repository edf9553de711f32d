"""Files of the catalogues: those of a package, and those of the folders that the environment
variable BRISTLE_PLUGINS names.

Such a folder has sub-folders `laws`, `effects`, `observers` and `scenarios`; a file there counts
like one of the package. Several folders are separated as in PATH. Whatever is wrong with a file
there, the error names the file. Parts of installed packages are in `packages`.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import pkgutil
import sys
import traceback
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import NamedTuple, Protocol, TypeVar

from bristle.common.errors import BristleError, EquationError

PLUGINS_VARIABLE = "BRISTLE_PLUGINS"  # environment variable with the folders
PLUGIN_KINDS = ("laws", "effects", "observers", "scenarios")  # their sub-folders


class Declared(Protocol):
    """What a file of a catalogue declares."""

    @property
    def name(self) -> str: ...

    @property
    def file(self) -> str: ...


D = TypeVar("D", bound=Declared)


class CatalogueFile(NamedTuple):
    """A file of a catalogue, by the name that errors give it, and whether it is a plug-in."""

    module: ModuleType
    file: str
    plugin: bool


def plugin_roots() -> list[Path]:
    """Return the folders named in BRISTLE_PLUGINS.

    Raises
    ------
    BristleError
        If a folder of BRISTLE_PLUGINS does not exist.
    """
    roots = [Path(name) for name in os.environ.get(PLUGINS_VARIABLE, "").split(os.pathsep) if name]
    for root in roots:
        if not root.is_dir():
            raise BristleError(
                f"{PLUGINS_VARIABLE}: no folder {root}; create it or correct the variable"
            )
        if not any((root / known).is_dir() for known in PLUGIN_KINDS):
            raise BristleError(
                f"{PLUGINS_VARIABLE}: {root} has none of the sub-folders {', '.join(PLUGIN_KINDS)};"
                " move the files there"
            )
    return [root.resolve() for root in roots]


def plugin_folders(kind: str) -> list[Path]:
    """Return the sub-folders `kind` of the folders named in BRISTLE_PLUGINS."""
    return [root / kind for root in plugin_roots() if (root / kind).is_dir()]


def plugin_files(kind: str, suffix: str) -> list[Path]:
    """Return the files of a kind in the folders of BRISTLE_PLUGINS; those whose name begins with _
    do not count.
    """
    return [
        path
        for folder in plugin_folders(kind)
        for path in sorted(folder.glob(f"*{suffix}"))
        if path.name[0] != "_"
    ]


def catalogue_modules(package: str, paths: Iterable[str], kind: str) -> list[CatalogueFile]:
    """Return the modules of a package and those of the plug-in folders, in alphabetical order of
    their files.

    Parameters
    ----------
    package, paths : str, iterable of str
        Name of the package and its `__path__`.
    kind : str
        Name of the sub-folder of a plug-in folder.

    Returns
    -------
    list of CatalogueFile
        Each module with its file.
    """
    folder = "/".join(package.split(".")[1:])
    own = [
        (name, f"{folder}/{name}.py", None)
        for name in (module.name for module in pkgutil.iter_modules(paths))
    ]
    added = [(path.stem, str(path), path) for path in plugin_files(kind, ".py")]
    found = sorted([*own, *added], key=lambda each: each[:2])
    return [
        CatalogueFile(
            importlib.import_module(f"{package}.{name}") if path is None else _load(path),
            file,
            path is not None,
        )
        for name, file, path in found
    ]


def declarations(found: Sequence[CatalogueFile], attribute: str, kind: type[D]) -> dict[str, D]:
    """Return what the files declare as `attribute`, by the names of the files as errors give them.

    A file of the package without it holds helpers of others.

    Raises
    ------
    BristleError
        If a plug-in declares nothing of this kind, or something is called as in another file, of
        which a plug-in is to be changed.
    """
    declared: dict[str, D] = {}
    for module, file, plugin in found:
        item = getattr(module, attribute, None)
        if isinstance(item, kind):
            declared[file] = item
        elif plugin or item is not None:
            raise BristleError(
                f"{file}: no {attribute} that is a {kind.__name__}; declare one, or begin the name"
                " of a file of helpers with _"
            )
    first: dict[str, str] = {}
    for file in (
        each.file for each in sorted(found, key=lambda each: each.plugin) if each.file in declared
    ):
        name = declared[file].name
        if name in first:
            raise BristleError(
                f"{file}: {attribute} is called '{name}', as in {first[name]}; give it a name of"
                " its own"
            )
        first[name] = file
    return declared


@contextmanager
def naming_plugins(parts: Iterable[Declared]) -> Iterator[None]:
    """Let an error in equations of plug-ins, or in what they return, name the file, and the line if
    it is one of the file.
    """
    try:
        yield
    except Exception as error:  # whatever the code of a plug-in raises
        # with the package, where there is one
        files = {part.file.rpartition(": ")[2]: part.file for part in parts if part.file}
        # of parts that are right by themselves
        misfit = isinstance(error, BristleError) and not isinstance(error, EquationError)
        if misfit or not files:
            raise
        frames = [at for at in traceback.extract_tb(error.__traceback__) if at.filename in files]
        where = (
            f"{files[frames[-1].filename]}: line {frames[-1].lineno}"
            if frames
            else " or ".join(files.values())
        )
        raise EquationError(f"{where}: {told(error)}; correct the equations") from error


def told(error: BaseException) -> str:
    """Return an error of a plug-in in one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, BristleError) else f"{type(error).__name__}: {text}"


def _load(path: Path) -> ModuleType:
    """Return the module of a file, loaded once."""
    name = f"bristle_plugin_{zlib.crc32(str(path.parent).encode()):08x}_{path.stem}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    # a file that leaves the program is a mistake of the file
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise BristleError(f"{path}: {told(error)}; correct the file or remove it") from error
    return module
