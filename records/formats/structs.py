"""Structs of MATLAB, as dictionaries, by the full names of what they hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np


def flat_structs(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Give what a tree of structs holds; the elements of an array of structs have their label, or
    are numbered from 1.
    """
    for key, value in tree.items():
        name = f"{prefix}{key}"
        elements = (
            list(value.flat) if isinstance(value, np.ndarray) and value.dtype == object else value
        )
        if isinstance(value, Mapping):
            yield from flat_structs(value, f"{name}.")
        elif (
            isinstance(elements, list)
            and elements
            and all(isinstance(each, Mapping) for each in elements)
        ):
            labels = [each.get("label") for each in elements]
            distinct = all(isinstance(label, str) and label for label in labels) and len(
                set(labels)
            ) == len(labels)
            for number, (each, label) in enumerate(zip(elements, labels, strict=True), start=1):
                yield from flat_structs(
                    each, f"{name}.{label}." if distinct else f"{name}({number})."
                )
        else:
            yield name, value
