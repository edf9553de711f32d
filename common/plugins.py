"""Files of the catalogues: those of a package, and those of the folders that the environment variable BRISTLE_PLUGINS names.

Such a folder has sub-folders `laws`, `effects`, `observers` and `scenarios`; a file there counts like one of the package. Several
folders are separated as in PATH.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import pkgutil
import sys
import zlib
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from bristle.common.errors import BristleError

PLUGINS_VARIABLE = "BRISTLE_PLUGINS"  # environment variable with the folders
PLUGIN_KINDS = ("laws", "effects", "observers", "scenarios")  # their sub-folders


def plugin_folders(kind: str) -> list[Path]:
    """Return the folders named in BRISTLE_PLUGINS that have a sub-folder `kind`, as these sub-folders.

    Raises
    ------
    BristleError
        If a folder of BRISTLE_PLUGINS does not exist.
    """
    roots = [Path(name) for name in os.environ.get(PLUGINS_VARIABLE, "").split(os.pathsep) if name]
    for root in roots:
        if not root.is_dir():
            raise BristleError(f"{PLUGINS_VARIABLE}: no folder {root}; create it or correct the variable")
        if not any((root / known).is_dir() for known in PLUGIN_KINDS):
            raise BristleError(
                f"{PLUGINS_VARIABLE}: {root} has none of the sub-folders {', '.join(PLUGIN_KINDS)}; move the files there"
            )
    return [root.resolve() / kind for root in roots if (root / kind).is_dir()]


def plugin_files(kind: str, suffix: str) -> list[Path]:
    """Return the files of a kind in the folders of BRISTLE_PLUGINS; those whose name begins with _ do not count."""
    return [path for folder in plugin_folders(kind) for path in sorted(folder.glob(f"*{suffix}")) if path.name[0] != "_"]


def catalogue_modules(package: str, paths: Iterable[str], kind: str) -> list[tuple[ModuleType, str]]:
    """Return the modules of a package and those of the plug-in folders, in alphabetical order of their files.

    Parameters
    ----------
    package, paths : str, iterable of str
        Name of the package and its `__path__`.
    kind : str
        Name of the sub-folder of a plug-in folder.

    Returns
    -------
    list of (module, str)
        Each module and its file, as errors name it.
    """
    folder = "/".join(package.split(".")[1:])
    own = [(name, f"{folder}/{name}.py", None) for name in (module.name for module in pkgutil.iter_modules(paths))]
    added = [(path.stem, str(path), path) for path in plugin_files(kind, ".py")]
    found = sorted([*own, *added], key=lambda each: each[:2])
    return [(importlib.import_module(f"{package}.{name}") if path is None else _load(path), file) for name, file, path in found]


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
    except (Exception, SystemExit) as error:  # a file that leaves the program is a mistake of the file
        del sys.modules[name]
        raise BristleError(f"{path}: {type(error).__name__}: {error}; correct the file or remove it") from error
    return module
