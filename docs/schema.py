"""Pages of the keys of scenario files and model files, from the classes that check them."""

from __future__ import annotations

import inspect
import types
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from bristle.common.toml import InUnit, Section

# (class, key) -> values that are checked against another list
Choices = Mapping[tuple[str, str], Sequence[str]]
VALUE = {str, int, float, bool}  # the types of a value that is a number or text with a unit
SIMPLE = {str: "text", int: "whole number", float: "number", bool: "true or false"}
RELATIONS = {Ge: ("ge", "≥"), Gt: ("gt", ">"), Le: ("le", "≤"), Lt: ("lt", "<")}


def key_tables(
    section: type[Section], choices: Choices, path: str = "", level: int = 2
) -> Iterator[str]:
    """Yield the lines of a Markdown page: a table of keys for a section of the file and for every
    table inside.
    """
    yield from (
        (f"{'#' * level} `{path}`", "", inspect.getdoc(section) or "", "")
        if path
        else (f"{'#' * level} Top level", "")
    )
    yield from ("| key | meaning | type | unit | default | allowed |", "|---|---|---|---|---|---|")
    inner = []
    for name, field in section.model_fields.items():
        given = _cell(
            ", ".join(f"`{value}`" for value in choices.get((section.__name__, name), ()))
            or _allowed(field)
        )
        kind = "text with a unit" if _unit(field) else _kind(field.annotation)
        texts = (
            f"`{name}`",
            _cell(field.description or ""),
            kind,
            _unit(field),
            _default(field),
            given,
        )
        yield f"| {' | '.join(texts)} |"
        if child := _section(field.annotation):
            many = get_origin(_plain(field.annotation)) is list
            inner.append((child, f"[[{name}]]" if many else f"[{_inside(path)}{name}]"))
    yield ""
    for child, at in inner:
        yield from key_tables(child, choices, at, level)


def _inside(path: str) -> str:
    return f"{path.strip('[]')}." if path else ""


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _plain(annotation: Any) -> Any:
    """Return a type without the None of an optional key."""
    if get_origin(annotation) in (Union, types.UnionType):
        rest = [part for part in get_args(annotation) if part is not type(None)]
        if len(rest) == 1:
            return _bare(rest[0])
    return annotation


def _bare(annotation: Any) -> Any:
    """Return a type without its metadata."""
    return get_args(annotation)[0] if hasattr(annotation, "__metadata__") else annotation


def _metadata(field: FieldInfo) -> list[Any]:
    """Return the metadata of a key, also of the one type of an optional key."""
    parts = [part for part in get_args(field.annotation) if hasattr(part, "__metadata__")]
    return [*field.metadata, *(item for part in parts for item in part.__metadata__)]


def _section(annotation: Any) -> type[Section] | None:
    """Return the section that a key holds, alone or in a list."""
    plain = _plain(annotation)
    if get_origin(plain) is list:
        plain = get_args(plain)[0]
    return plain if isinstance(plain, type) and issubclass(plain, Section) else None


def _kind(annotation: Any) -> str:
    plain = _plain(annotation)
    origin, inside = get_origin(plain), get_args(plain)
    if _section(plain) is not None:
        return "list of tables" if origin is list else "table"
    if origin is Literal:
        return "text"
    if origin is list:
        return f"list of {_kind(inside[0])}"
    if origin is tuple:
        return "[" + ", ".join(_kind(part) for part in inside) + "]"
    if origin is dict:
        return "table" if inside[1] is Any else "table of " + _kind(inside[1])
    if origin in (Union, types.UnionType) and set(inside) == VALUE:
        return "value"
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_kind(part) for part in inside if part is not type(None)))
    return SIMPLE.get(plain, "any value")


def _unit(field: FieldInfo) -> str:
    return next((item.unit for item in _metadata(field) if isinstance(item, InUnit)), "")


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if (
        value is PydanticUndefined
        or value is None
        or isinstance(value, Section)
        or value in ({}, [], "")
    ):
        return "–"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    unit = _unit(field)
    return f"`{value:g} {unit}`" if unit else f"`{value}`"


def _allowed(field: FieldInfo) -> str:
    plain = _plain(field.annotation)
    if get_origin(plain) is Literal:
        return ", ".join(f"`{value}`" for value in get_args(plain))
    found = ["> 0"] if _unit(field) in ("s", "Hz") else []
    for item in _metadata(field):
        if type(item) in RELATIONS:
            name, sign = RELATIONS[type(item)]
            found.append(f"{sign} {getattr(item, name)}")
        if isinstance(item, MinLen):
            found.append(f"at least {item.min_length}")
    return ", ".join(found)
