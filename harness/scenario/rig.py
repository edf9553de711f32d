"""Units of a rig, and the normalised ones in which an observer runs on the rig's record.

Gains, gates and thresholds of the observers belong to a servo that turns at about 120 deg/s and is
driven by a few volts. A record of another speed, in other units or with another kind of input is
therefore scaled to the same rms speed and the same rms input before an observer reads it, and all
that the observer publishes is scaled back. alpha2, sigma_i and tau are the same in any units; b, c,
Fc, load, w, v and theta are not. Source: dixit2008 eq. (15)-(17), which keep their form when
position and input are scaled.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from bristle.common.table import Array
from bristle.common.units import BASE, parse_unit
from bristle.records import Layout

NORMAL_SPEED = math.radians(120.0)  # rad/s, rms in motion to which the speed of a record is scaled
NORMAL_INPUT = 3.6  # V, rms to which the input of a record is scaled
SPEED_WINDOW = 0.02  # s, over which a position is differentiated for its rms speed
MOVING_SHARE = 0.1  # of the rms speed, above which a record is in motion
ANGLE, VOLTAGE = "rad", "V"  # units in which observers read position and input


@dataclass(frozen=True)
class Rig:
    """The SI units of a rig's position and input, and what one of each is worth to the observer.

    Attributes
    ----------
    position, input : str
        ``rad`` or ``m``; ``V``, ``A``, ``N.m`` or ``N``.
    angle : float
        rad that the observer reads for one unit of the position.
    voltage : float
        V that the observer reads for one unit of the input.
    """

    position: str = ANGLE
    input: str = VOLTAGE
    angle: float = 1.0
    voltage: float = 1.0

    def unit(self, observers: str) -> str:
        """Return the rig's unit for one in rad and V: ``rad/(s2.V)`` becomes ``m/(s2.N)``."""
        if (self.position, self.input) == (ANGLE, VOLTAGE):
            return observers
        names = {ANGLE: self.position, VOLTAGE: self.input}
        return re.sub(r"[A-Za-z]+", lambda match: names.get(match[0], match[0]), observers)

    def worth(self, observers: str) -> float:
        """Return what one of the rig's unit is worth in the observer's, which is in rad and V."""
        if self.angle == self.voltage == 1.0:
            return 1.0
        exponents = dict(zip(BASE, parse_unit(observers).exponents, strict=True))
        # of what observers read only V has kg
        return float(self.angle ** exponents["rad"] * self.voltage ** exponents["kg"])

    def written(self, observers: str) -> tuple[str, float]:
        """Return the rig's unit for one in rad and V, and what one of it is worth there."""
        return self.unit(observers), self.worth(observers)


def normalising(layout: Layout, h: float, y: Array, u: Array) -> Rig:
    """Return the scales that give a record the speed and the input that observers are made for;
    where nothing moves, 1.
    """
    speed = np.abs(y) if layout.output_kind == "velocity" else _speeds(y, h)
    usual = _rms(speed)
    moving, drive = _rms(speed[speed > MOVING_SHARE * usual]), _rms(u)
    return Rig(
        "m" if layout.linear else ANGLE,
        layout.input_unit,
        NORMAL_SPEED / moving if moving > 0 else 1.0,
        NORMAL_INPUT / drive if drive > 0 else 1.0,
    )


def _speeds(position: Array, h: float) -> Array:
    """Return speeds as differences over a window in which the sensor's steps hardly count."""
    samples = min(max(1, round(SPEED_WINDOW / h)), len(position) - 1)
    return np.abs(position[samples:] - position[:-samples]) / (samples * h)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
