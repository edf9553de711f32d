"""XML documents: the text of a tree, and texts that XML may hold."""

from __future__ import annotations

from xml.etree import ElementTree


def document(root: ElementTree.Element) -> bytes:
    """Return a tree as an indented document in UTF-8."""
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"


def printable(text: str) -> str:
    """Return a text without characters that XML cannot hold, or that would break a line."""
    return "".join(c if c.isprintable() else " " for c in text)
