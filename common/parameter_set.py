"""Parameter sets as files (SSV of SSP 1.0): values of variables by name.

Source: ssp2019 (System Structure and Parameterization 1.0).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from xml.etree import ElementTree as ET

from bristle.common.errors import BristleError
from bristle.common.xml import document

Value = float | int | bool | str

SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
# in this order: a bool is an int
KINDS_OF_VALUES = {bool: "Boolean", int: "Integer", str: "String", float: "Real"}


def parameter_set(name: str, values: Mapping[str, Value]) -> bytes:
    """Return the file of these values."""
    ET.register_namespace("ssv", SSV)
    root = ET.Element(f"{{{SSV}}}ParameterSet", version="1.0", name=name)
    parameters = ET.SubElement(root, f"{{{SSV}}}Parameters")
    for each, value in values.items():
        kind = next(name for cls, name in KINDS_OF_VALUES.items() if isinstance(value, cls))
        text = (
            str(value).lower()
            if kind == "Boolean"
            else str(value)
            if kind == "String"
            else repr(value)
        )
        ET.SubElement(
            ET.SubElement(parameters, f"{{{SSV}}}Parameter", name=each),
            f"{{{SSV}}}{kind}",
            value=text,
        )
    return document(root)


def parameter_values(tree: ET.Element) -> Iterator[tuple[str, Value]]:
    """Give the values below an element of a file or of a description, as (name, value).

    Raises
    ------
    BristleError
        If a value is none, or of another type; the message wants the file in front of it.
    """
    for parameter in tree.iter(f"{{{SSV}}}Parameter"):
        yield parameter.get("name", ""), _value(parameter)


def finite_number(text: str | None) -> float:
    """Return a text as a finite number, or raise `BristleError`."""
    try:
        value = float(text or "")
    except ValueError:
        raise BristleError(f"'{text}' is no number") from None
    if not math.isfinite(value):
        raise BristleError(f"'{text}' is not finite")
    return value


def _value(parameter: ET.Element) -> Value:
    for value in parameter:
        kind, text = value.tag.rpartition("}")[2], value.get("value", "")
        if kind == "Real":
            return finite_number(text)
        if kind in ("Integer", "Enumeration"):
            return int(finite_number(text))
        if kind == "String":
            return text
        if kind == "Boolean" and text in ("true", "false", "0", "1"):
            return text in ("true", "1")
    raise BristleError(
        f"parameter '{parameter.get('name')}' is neither Real nor Integer, Boolean or String"
    )
