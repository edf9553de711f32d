"""Checks of the arguments of public functions: each returns the value, or raises one line that
names the argument.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from bristle.common.errors import BristleError

T = TypeVar("T")


def _shown(given: object) -> str:
    """Return a value as an error shows it, in short: of what is no plain value its type."""
    return (
        repr(given)
        if given is None or isinstance(given, (str, int, float))
        else f"a {type(given).__name__}"
    )


def as_path(name: str, given: object) -> Path:
    """Return the path that was given as the argument `name`."""
    if not isinstance(given, (str, os.PathLike)) or not os.fspath(given):
        raise BristleError(f"{name} is {_shown(given)}; give a path, as text or Path")
    return Path(given)


def filled_path(text: str | Path) -> Path:
    """Return the path that an option of a command gives.

    Empty text is refused: it comes from a variable of the shell that is not set, and would be the
    current folder. So is "-", which elsewhere stands for the standard input or output, and would be
    a file of this name.
    """
    if not str(text):
        raise BristleError("it is empty; give a path")
    if text == "-":
        raise BristleError(
            "- is no path; give that of a file, such as /dev/stdout for the standard output, or ./-"
            " for one called -"
        )
    return Path(text)


def as_paths(name: str, given: object) -> list[Path]:
    """Return the paths that were given as the argument `name`: one, or a sequence of them."""
    if isinstance(given, (str, os.PathLike)) or not isinstance(given, Iterable):
        return [as_path(name, given)]
    return [as_path(f"{name}[{k}]", each) for k, each in enumerate(given)]


def as_names(name: str, given: object) -> tuple[str, ...]:
    """Return the names that were given as the argument `name`, a sequence of texts."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise BristleError(f"{name} is {_shown(given)}; give a list of names")
    names = tuple(given)
    for k, each in enumerate(names):
        if not isinstance(each, str):
            raise BristleError(f"{name}[{k}] is {_shown(each)}; give a name as text")
    return names


def as_choice(name: str, given: object, choices: Sequence[T]) -> T:
    """Return the one of the choices that was given as the argument `name`."""
    for choice in choices:
        if type(given) is type(choice) and given == choice:
            return choice
    raise BristleError(f"{name} is {_shown(given)}; choose one of: {', '.join(map(repr, choices))}")


def as_whole_number(name: str, given: object) -> int:
    """Return the whole number that was given as the argument `name`; a NumPy integer is one too."""
    if isinstance(given, bool) or not hasattr(given, "__index__"):
        raise BristleError(f"{name} is {_shown(given)}; give a whole number")
    return int(given.__index__())
