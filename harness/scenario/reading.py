"""Reading a scenario file: overrides, deprecated keys, and errors that name file, key and value."""

from __future__ import annotations

import os
import re
import tomllib
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import (
    ValidationError,
)

from bristle.common.errors import BristleError
from bristle.common.toml import first_mistake, mistake, read_toml, too_much
from bristle.harness.scenario.scenario import Scenario

PARAMETER_PARTS = ("plant", "controller", "observer")  # parts of a scenario that have parameters


class Loaded:
    """A scenario with where it came from."""

    def __init__(
        self,
        path: Path,
        text: str,
        scenario: Scenario,
        overrides: Sequence[str],
        notes: Sequence[str] = (),
    ) -> None:
        self.path, self.text, self.scenario, self.overrides, self.notes = (
            path,
            text,
            scenario,
            list(overrides),
            list(notes),
        )

    @property
    def name(self) -> str:
        """The file's stem."""
        return self.path.stem

    def beside(self, file: str) -> Path:
        """Return a path as written in the file, which is relative to the file."""
        return Path(os.path.realpath(self.path.parent / Path(file).expanduser()))

    def error(self, key: str, value: object, message: str) -> BristleError:
        """Return the one-line error for a key of this file."""
        return mistake(self.path, key, value, message)


def load(path: Path, overrides: Sequence[str] = (), seed: int | None = None) -> Loaded:
    """Read and check a scenario file.

    Parameters
    ----------
    path : Path
        The TOML file.
    overrides : sequence of str
        ``path=value`` as text.
    seed : int, optional
        Seed of the controller's reference.

    Raises
    ------
    BristleError
        One line that names file, key, value and what is allowed.
    """
    text, tree = read_toml(path, "scenario file")
    return parse(path, text, tree, overrides, seed)


def parse(
    path: Path,
    text: str,
    tree: dict[str, Any],
    overrides: Sequence[str] = (),
    seed: int | None = None,
) -> Loaded:
    """Check a scenario file that has been read: its text, and its tree, which is changed; the rest
    as of `load`.
    """
    if "friction" in tree and "output" in tree:
        raise BristleError(
            f"{path}: is a model file, no scenario file; give it to bristle diagnose, with records"
        )
    for part in PARAMETER_PARTS:
        _flatten_parameters(tree, part)
    for override in overrides:
        _override(tree, override)
    if seed is not None:
        if "record" in tree:
            raise BristleError(
                f"{path}: seed {seed}: a [record] has no reference to seed; leave the seed out"
            )
        tree.setdefault("controller", {}).setdefault("parameters", {})["seed"] = seed
    notes = _new_record_keys(path, tree)
    try:
        scenario = Scenario.model_validate(tree, context={"record": "record" in tree})
    except ValidationError as error:
        raise first_mistake(path, Scenario, error) from None
    given = [*overrides, *([f"controller.parameters.seed={seed}"] if seed is not None else [])]
    return Loaded(path, text, scenario, given, notes)


OLD_RECORD_KEYS = ("u", "theta", "v")  # of [record], before it had the tables of a model file


def _new_record_keys(path: Path, tree: dict[str, Any]) -> list[str]:
    """Replace the deprecated keys of [record] by [record.input], [record.output] and
    [record.velocity]; say so, also as warning.
    """
    section = tree.get("record")
    old = [key for key in OLD_RECORD_KEYS if isinstance(section, dict) and key in section]
    if not isinstance(section, dict) or not old:
        return []
    kinds = {
        "u": ("input", "voltage"),
        "theta": ("output", "position"),
        "v": ("output", "velocity"),
    }
    # each old key becomes the table that has its place
    new, written = {key: value for key, value in section.items() if key not in old}, []
    for key in old:
        name, kind = kinds[key]
        if key == "v" and "theta" in old:
            name, kind = "velocity", ""
        if name in section:
            raise mistake(
                path,
                f"record.{key}",
                None,
                f"is the deprecated name of [record.{name}], which is given as well; remove it",
            )
        given = section[key]
        new[name] = {**given, "kind": kind} if kind and isinstance(given, dict) else given
        written.append(f"{key} as [record.{name}]" + (f' with kind = "{kind}"' if kind else ""))
    tree["record"] = new
    line = f"{path}: record: the keys {', '.join(old)} are deprecated; write {', '.join(written)}"
    warnings.warn(line, FutureWarning, stacklevel=2)
    return [line]


def _flatten_parameters(tree: dict[str, Any], part: str) -> None:
    """Let `modified.sigma0 = ...` mean the same with and without quotes."""
    section = tree.get(part)
    if not isinstance(section, dict) or not isinstance(section.get("parameters"), dict):
        return
    flat: dict[str, Any] = {}

    def walk(prefix: str, node: Mapping[str, Any]) -> None:
        for key, value in node.items():
            if isinstance(value, dict):
                walk(f"{prefix}{key}.", value)
            else:
                flat[f"{prefix}{key}"] = value

    walk("", section["parameters"])
    section["parameters"] = flat


def _parse(text: str) -> Any:
    """Read an override's value as TOML where it is TOML, else as a plain string."""
    try:
        return tomllib.loads(f"x = {text}")["x"]
    except tomllib.TOMLDecodeError:
        return text
    except (ValueError, RecursionError) as error:
        raise BristleError(f"override '{text}': {too_much(error)}") from None


def keys_of(path: str) -> list[str]:
    """Return the keys of a dotted path, of which one that has a dot itself is in quotes."""
    return [quoted or bare for quoted, bare in re.findall(r'"([^"]*)"|([^."]+)', path.strip())]


def _override(tree: dict[str, Any], override: str) -> None:
    """Apply one ``path=value``; behind ``plant.parameters.`` everything is one structured name."""
    path, separator, text = override.partition("=")
    keys = keys_of(path)
    if not separator or not keys:
        raise BristleError(
            f"override '{override}': not path=value; write for example plant.parameters.J=0.002"
            " kg.m2"
        )
    # the name of a parameter contains dots
    if len(keys) > 2 and keys[0] in PARAMETER_PARTS and keys[1] == "parameters":
        keys = [*keys[:2], ".".join(keys[2:])]
    node: Any = tree
    # down the tree; the last key gets the value
    for depth, key in enumerate(keys):
        last = depth == len(keys) - 1
        if isinstance(node, list):
            if not key.isdigit() or int(key) >= len(node):
                raise BristleError(
                    f"override '{override}': '{key}' is no index of a list of {len(node)}; count"
                    " from 0"
                )
            if last:
                node[int(key)] = _parse(text.strip())
            node = node[int(key)]
        elif isinstance(node, dict):
            if last:
                node[key] = _parse(text.strip())
            node = node.setdefault(key, {})
        else:
            raise BristleError(
                f"override '{override}': '{'.'.join(keys[:depth])}' is a value, not a table;"
                " shorten the path"
            )
