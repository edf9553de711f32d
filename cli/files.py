"""Files on the command line: measured ones behind one option or as patterns such as ``logs/*.csv``,
scenarios by their names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from glob import glob, has_magic
from pathlib import Path
from typing import Any

from typer.core import TyperCommand

from bristle.common.errors import BristleError

DATA = "--data"
MODELS = (".toml", ".fmu")  # suffixes of what may stand behind the measured files and is none


class DataCommand(TyperCommand):
    """A command whose option `--data` takes all files that follow it, as the shell lists them for
    ``--data logs/*.csv``.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, one_option_each(args))


def one_option_each(args: Sequence[str]) -> list[str]:
    """Return arguments in which each file that follows `--data` has that option before it."""
    found: list[str] = []
    listing = False
    for before, arg in zip(["", *args], args, strict=False):
        if arg.startswith("-"):
            listing = arg == DATA or arg.startswith(f"{DATA}=")
        elif listing and before != DATA and not arg.lower().endswith(MODELS):
            found.append(DATA)
        found.append(arg)
    return found


def files_of(paths: Iterable[Path]) -> list[Path]:
    """Return paths with the files that match in place of each pattern, sorted so that run2 comes
    before run10.
    """
    found: list[Path] = []
    for path in paths:
        if not has_magic(str(path)) or path.exists():
            found.append(path)
            continue
        matches = [each for each in map(Path, glob(str(path), recursive=True)) if each.is_file()]
        if not matches:
            raise BristleError(
                f"{path}: no file matches this pattern; correct it, or name the files"
            )
        found += sorted(matches, key=_natural)
    return found


def pairs(option: str, texts: Iterable[str]) -> dict[str, str]:
    """Return the values of an option such as ``--unit COLUMN=UNIT`` by what stands before the last
    equals sign.
    """
    found = {}
    for text in texts:
        name, mark, value = text.rpartition("=")
        if not mark or not name or not value:
            raise BristleError(
                f"{option} '{text}': is not NAME=VALUE; write for example {option} theta=deg"
            )
        found[name] = value
    return found


def refuse_duplicates(paths: Sequence[Path]) -> None:
    """Raise `BristleError` if two scenarios have one name: the folder of results is called so."""
    stems = [path.stem for path in paths]
    for path in paths:
        if stems.count(path.stem) > 1:
            raise BristleError(
                f"scenario '{path.stem}' is given {stems.count(path.stem)} times; results are named"
                " by the file: rename one"
            )


def _natural(path: Path) -> list[list[str | int]]:
    return [
        [int(text) if text.isdigit() else text.lower() for text in re.split(r"(\d+)", part)]
        for part in path.parts
    ]
