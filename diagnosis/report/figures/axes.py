"""Units of the axes of figures: what people read."""

from __future__ import annotations

from bristle.common.drawing import DEGREES

AXIS_UNITS = {  # SI unit -> factor and unit of a figure's axis
    "rad": (DEGREES, "deg"),
    "rad/s": (DEGREES, "deg/s"),
    "rad/s2": (DEGREES, "deg/s²"),
    "m": (1e3, "mm"),
    "m/s": (1e3, "mm/s"),
    "m/s2": (1.0, "m/s²"),
    "N.m": (1.0, "N·m"),
    "1": (1.0, ""),
}


def shown(unit: str) -> tuple[float, str]:
    """Return (factor, unit) for an axis in the units people read: degrees and millimetres."""
    return AXIS_UNITS.get(unit, (1.0, unit))
