"""Columns converted to SI."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from bristle.common.columns import KINDS as KINDS
from bristle.common.columns import Array as Array
from bristle.common.columns import Columns as Columns
from bristle.common.columns import is_number
from bristle.common.errors import BristleError, suggest
from bristle.common.units import parse_unit, zero_of

# letters of a column name, and column names, that an error message shows at most
SHOWN_LETTERS, SHOWN_NAMES = 40, 20


def factor_to(unit: str, scale: str | None, si_unit: str) -> float:
    """Return the factor that converts a value in `unit` to `si_unit`; `scale` is such as ``"1
    rad/m"``.

    Raises
    ------
    BristleError
        If a unit is not known or does not fit.
    """
    have, want = parse_unit(unit), parse_unit(si_unit)
    factor, exponents = have.factor / want.factor, np.array(have.exponents)
    if scale is not None:
        number, _, text = scale.strip().partition(" ")
        over = parse_unit(text or "1")
        if not is_number(number) or not np.isfinite(float(number)):
            raise BristleError(
                f"scale '{scale}' is not a number with a unit; write for example \"20 rad/m\""
            )
        if float(number) == 0.0:
            raise BristleError(
                f"scale '{scale}' is zero; write what one of the unit is worth, for example \"20"
                ' rad/m"'
            )
        factor, exponents = (
            factor * float(number) * over.factor,
            exponents + np.array(over.exponents),
        )
    if tuple(exponents) != want.exponents:
        if scale is not None:
            advice = f"write unit '1' with a scale in {si_unit}, or correct either"
            raise BristleError(
                f"unit '{unit}' with scale '{scale}' gives none like '{si_unit}', which is needed;"
                f" {advice}"
            )
        raise BristleError(
            f"unit '{unit}' does not fit, a unit like '{si_unit}' is needed; "
            f'correct it, or add scale = "... {si_unit}" over that unit'
        )
    return factor


def _listed(names: Iterable[str]) -> str:
    """Return names in short, for one line of an error message."""
    short = [name if len(name) <= SHOWN_LETTERS else f"{name[:SHOWN_LETTERS]}..." for name in names]
    return ", ".join(short[:SHOWN_NAMES]) + (
        f" and {len(short) - SHOWN_NAMES} more" if len(short) > SHOWN_NAMES else ""
    )


def si_column(
    where: str, columns: Mapping[str, Array], name: str, unit: str, scale: str | None, si_unit: str
) -> Array:
    """Return a column in SI units, shape (n,); `where` begins the line of an error."""
    if what := getattr(columns, "unusable", {}).get(name):
        raise BristleError(f"{where}: column '{name}' holds {what}; give one number a sample")
    if name not in columns:
        raise BristleError(
            f"{where}: no column '{name}'{suggest(name, list(columns))}; there are:"
            f" {_listed(columns)}"
        )
    if name in getattr(columns, "clocks", ()):
        if si_unit != "s":
            raise BristleError(
                f"{where}: column '{name}' holds timestamps; give one number a sample"
            )
        if unit != "s":
            raise BristleError(
                f"{where}: column '{name}' holds timestamps, which are read in s; write unit ="
                ' "s"'
            )
    try:
        return columns[name] * factor_to(unit, scale, si_unit) + zero_of(unit, si_unit)
    except BristleError as error:
        raise BristleError(f"{where}: {error}") from None
