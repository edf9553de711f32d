"""Units of a rig: the equations are those of a rotary servo driven by volts; a linear axis or a torque reads otherwise."""

from __future__ import annotations

import re

from bristle.model.drawing import DEGREES

DRIVEN = {"torque": "N.m", "force": "N", "voltage": "V", "current": "A"}  # unit of the input by its kind
SHOWN = {  # SI unit -> factor and unit of a figure's axis
    "rad": (DEGREES, "deg"), "rad/s": (DEGREES, "deg/s"), "rad/s2": (DEGREES, "deg/s²"),
    "m": (1e3, "mm"), "m/s": (1e3, "mm/s"), "m/s2": (1.0, "m/s²"),
    "N.m": (1.0, "N·m"), "1": (1.0, ""),
}  # fmt: skip


def rig_unit(text: str, linear: bool, input_kind: str = "voltage") -> str:
    """Return the unit that a parameter of the servo has on a rig; what is already one of the rig stays.

    On a linear axis metres stand for radians, newtons for newton metres and kilograms for inertia; with another input
    than a voltage its unit stands for the volt.
    """
    if linear:
        text = text.replace("kg.m2", "kg").replace("N.m", "N").replace("rad", "m")
    driven = "N" if linear and input_kind == "torque" else DRIVEN.get(input_kind, "V")
    text = re.sub(r"\bV\b", driven, text)
    return "1" if text in ("N.m/N.m", "N/N") else text


def shown(unit: str) -> tuple[float, str]:
    """Return (factor, unit) for an axis in the units people read: degrees and millimetres."""
    return SHOWN.get(unit, (1.0, unit))
