"""What a child process answers, as plain numbers and text: reading it runs no code."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from bristle.common.errors import BristleError

ARRAY = "\0array"  # key that stands for an array in the tree
NOT_ASKED = "its answer is not what was asked for"


def write_answer(path: Path, answer: Any) -> None:
    """Write None, Booleans, numbers, text, arrays, and lists and dictionaries of these; the file
    appears when it is complete.
    """
    arrays: list[Any] = []
    tree = json.dumps(_without_arrays(answer, arrays)).encode()
    fresh = path.with_suffix(".fresh")
    with fresh.open("wb") as file:
        for array in (np.frombuffer(tree, dtype=np.uint8), *arrays):
            np.save(file, array, allow_pickle=False)
    os.replace(fresh, path)


def _without_arrays(value: Any, arrays: list[Any]) -> Any:
    if isinstance(value, np.ndarray):
        arrays.append(np.ascontiguousarray(value))
        return {ARRAY: len(arrays) - 1}
    if isinstance(value, dict):
        return {name: _without_arrays(each, arrays) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_arrays(each, arrays) for each in value]
    return value


def read_answer(path: Path) -> Any:
    """Return what `write_answer` wrote, tuples as lists; None if there is no file.

    Raises
    ------
    BristleError
        If the file is not one of `write_answer`.
    """
    try:  # not blocked by a pipe in the place of the file
        handle = os.open(
            path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0)
        )
    except FileNotFoundError:
        return None
    except OSError as error:
        raise BristleError(f"its answer cannot be opened ({error.strerror})") from None
    with os.fdopen(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise BristleError("its answer is no file")
        try:
            tree = json.loads(np.load(file, allow_pickle=False).tobytes())
            return _with_arrays(tree, file, [])
        except (
            ValueError,
            OSError,
            EOFError,
            MemoryError,
            RecursionError,
            TypeError,
            KeyError,
            IndexError,
            AttributeError,
        ):
            raise BristleError(NOT_ASKED) from None


def _with_arrays(value: Any, file: BinaryIO, arrays: list[Any]) -> Any:
    """Return the tree with its arrays, which the file has in the order of the tree."""
    if isinstance(value, dict):
        if value.keys() == {ARRAY}:
            arrays.append(np.load(file, allow_pickle=False))
            return arrays[value[ARRAY]]
        return {name: _with_arrays(each, file, arrays) for name, each in value.items()}
    return (
        [_with_arrays(each, file, arrays) for each in value] if isinstance(value, list) else value
    )
