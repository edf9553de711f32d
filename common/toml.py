"""TOML files: reading, checking against a schema, errors with file, key, value and what to do."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from bristle.common.errors import BristleError, suggest
from bristle.common.files import check_regular

SCALARS = ("str", "int", "float", "bool")  # names of types in the place of an error


class Section(BaseModel):
    """A table of the file; unknown keys are mistakes. The text below a key describes it
    (docs/generate.py).
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


@dataclass(frozen=True)
class InUnit:
    """The SI unit of a key that is written as text with a unit, as metadata of its type."""

    unit: str

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        """Return the JSON schema of the text, such as ``20 s``."""
        return {
            "type": "string",
            "pattern": r"^\s*[-+0-9.eE]+\s+\S+\s*$",
            "examples": [f"1 {self.unit}"],
        }


def read_toml(path: Path, what: str) -> tuple[str, dict[str, Any]]:
    """Return text and tree of a TOML file; `what` names its kind in an error ("scenario file")."""
    if path.is_dir():
        raise BristleError(f"{path}: is a folder; give a {what}")
    check_regular(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
        return text, tomllib.loads(text)
    except OSError as error:
        raise BristleError(f"{path}: {error.strerror}; check the path of the {what}") from None
    except UnicodeDecodeError:
        raise BristleError(f"{path}: not UTF-8 text; give a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise BristleError(f"{path}: not valid TOML: {error}; correct that line") from None
    except (ValueError, RecursionError) as error:
        raise BristleError(f"{path}: {too_much(error)}") from None


def too_much(error: ValueError | RecursionError) -> str:
    """Return what is wrong with TOML that is valid, but that Python does not read."""
    if isinstance(error, RecursionError):
        return "brackets inside brackets, more than Python reads; use fewer"
    return f"a number of more than {sys.get_int_max_str_digits()} digits; write fewer"


def _shown(value: object) -> str:
    text = (
        f'"{value}"'
        if isinstance(value, str)
        else str(value).lower()
        if isinstance(value, bool)
        else repr(value)
    )
    return text if len(text) <= 60 else text[:57] + "..."


def mistake(path: Path | str, key: str, value: object, message: str) -> BristleError:
    """Return the one-line error for a key of a file; None stands for a key that is not there."""
    where = (
        f"{path}: " + (key if value is None else f"{key} = {_shown(value)}") if key else f"{path}"
    )
    return BristleError(" ".join(f"{where}: {message}".split()))


def quoted(text: str) -> str:
    """Return a basic TOML string: quotes, backslashes and control characters escaped."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + re.sub(r"[\x00-\x1f\x7f]", lambda match: f"\\u{ord(match[0]):04x}", escaped) + '"'


def _dotted(location: Sequence[int | str]) -> str:
    return "".join(
        f"[{part}]" if isinstance(part, int) else f".{part}" for part in location
    ).lstrip(".")


def _section_at(schema: type[BaseModel], location: Sequence[int | str]) -> type[BaseModel] | None:
    """Return the section that a location of an error lies in."""
    for part in location:
        if isinstance(part, int):
            continue
        if part not in schema.model_fields:
            return None
        found = [
            t
            for t in _types(schema.model_fields[part].annotation)
            if isinstance(t, type) and issubclass(t, BaseModel)
        ]
        if not found:
            return None
        schema = found[0]
    return schema


def _types(annotation: Any) -> list[Any]:
    inner = get_args(annotation)
    return [annotation] if not inner else [t for arg in inner for t in _types(arg)]


def _missing_keys(path: Path | str, found: Sequence[ErrorDetails]) -> BristleError:
    """Return the error for all keys that are missing; an error may say in its context which keys
    could take the place of one.
    """
    keys = [
        e.get("ctx", {}).get("keys", _dotted(e["loc"])) for e in found if e["type"] == "missing"
    ]
    more = f" (and {len(found) - len(keys)} more)" if len(found) > len(keys) else ""
    return mistake(
        path, ", ".join(keys), None, f"missing; add {'it' if len(keys) == 1 else 'them'}{more}"
    )


def _unknown_key(schema: type[BaseModel], location: Sequence[int | str]) -> str:
    """Say that a key is unknown, and which are known there."""
    section = _section_at(schema, location[:-1])
    known = list(section.model_fields) if section else []
    return f"unknown key{suggest(str(location[-1]), known)}; allowed here: {', '.join(known)}"


def first_mistake(
    path: Path | str, schema: type[BaseModel], error: ValidationError
) -> BristleError:
    """Return the first error that pydantic found, in one line."""
    found = error.errors()
    # of an unknown and a missing key the unknown one is shown: it is usually a misspelt one
    first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
    kind, value, context = first["type"], first["input"], first.get("ctx", {})
    location = [p for p in first["loc"] if not str(p).startswith("function-")]
    key = _dotted(location)
    # pydantic tells for each type it could be
    if isinstance(value, (dict, list)) and location and location[-1] in SCALARS:
        said = "must be one value, not a table or a list; change the value"
        return mistake(path, _dotted(location[:-1]), value, said)
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    if kind == "extra_forbidden":
        said = _unknown_key(schema, location)
        return mistake(path, key, value, f"{said}{more}")
    if kind == "missing":
        return _missing_keys(path, found)
    if kind == "value_error":
        shown = value if key and not isinstance(value, (dict, Section)) else None
        return mistake(path, key, shown, f"{context.get('error')}{more}")
    if kind == "literal_error":
        choices = str(context.get("expected")).replace(" or ", ", ")
        return mistake(path, key, value, f"not a choice; choose one of: {choices}{more}")
    hint = {
        "greater_than_equal": f"must be at least {context.get('ge')}",
        "finite_number": "must be a finite number",
        "too_short": f"needs at least {context.get('min_length')} entry",
        "model_type": "must be a table; write it as [section]",
        "dict_type": "must be a table; write it as [section]",
        "string_type": "must be text in quotes",
        "list_type": "must be a list, in brackets",
        "tuple_type": "must be a list, in brackets",
    }.get(kind, first["msg"].replace("Input should be", "must be"))
    return mistake(path, key, value, f"{hint}; change the value{more}")
