"""Variables of an FMU under other names and in other units, as files give them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bristle.common.errors import BristleError
from bristle.common.units import quantity
from bristle.fmus.host import Alias

Mapped = str | dict[str, str | float]  # how a file names a variable: its name, or a table


def alias(given: Mapped, units: Sequence[str]) -> Alias:
    """Return the variable that a file gives.

    Parameters
    ----------
    given : str or dict
        Its name, or ``{"name": ..., "unit": ..., "scale": ...}``: one of its number is worth scale
        times unit. Where a scale but no unit is given, the unit is the first of `units`.
    units : sequence of str
        Units of which its own must be a multiple; none if it may be any.

    Raises
    ------
    BristleError
        If it is not such a table, or its unit does not fit; the message does not name the place in
        a file.
    """
    table: Mapping[str, object] = {"name": given} if isinstance(given, str) else given
    name, unit, scale = table.get("name"), table.get("unit"), table.get("scale", 1.0)
    if (
        set(table) - {"name", "unit", "scale"}
        or not isinstance(name, str)
        or not isinstance(unit, str | None)
        or not _is_scale(scale)
    ):
        raise BristleError(
            'write { name = "...", unit = "...", scale = 1.0 }; unit and a scale other than 0 are'
            " optional"
        )
    factor = float(str(scale))
    if unit is None:
        return Alias(name, factor, units[0] if units and factor != 1.0 else None)
    problem = ""
    for each in units or (unit,):
        try:
            return Alias(name, factor * quantity(f"1 {unit}", each), each)
        except BristleError as error:
            problem = problem or str(error)
    raise BristleError(problem)


def _is_scale(value: object) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and math.isfinite(value)
        and value != 0
    )
