"""The friction curve of a plant: its friction over velocity, as it coasts down."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from bristle.common.signals import Array
from bristle.fmus.host import Fmu
from bristle.harness.cosim.drive import Drive

# rad/s: speed from which a plant coasts down for its friction curve
CURVE_SPEED = math.radians(120.0)
PUSH, PUSH_RATE = 0.2, 40.0  # s and rad/s2: how it is brought there, at most
SLOWEST = math.radians(1.0)  # rad/s: below, a curve is not drawn


def friction_curve(law: str, parameters: Mapping[str, float]) -> tuple[Array, Array]:
    """Return velocity and friction of a plant that coasts down, the fastest first.

    Parameters
    ----------
    law : str
        Law of a lean plant FMU, which has J = 1 kg.m2 and b = 1 N.m/V.
    parameters : mapping of str to float
        Those of the law.

    Returns
    -------
    velocity, friction : ndarray, shape (n,)
        rad/s and rad/s2; both are empty if the plant does not get to speed.
    """
    from bristle.fmus import obtain

    h = 1e-3
    values = {"J": 1.0, "b": 1.0, "a2": 0.0, "u_max": 1e6, **parameters}
    push = np.full(round(PUSH / h), PUSH_RATE)
    drive = Drive(Fmu(obtain("plant", law=law, encoder=False)), ["u"], ["v", "F"], list(values))
    try:
        [pushed] = drive.run(push[:, None], np.array([[*values.values()]]), h)
        count = int(np.argmax(pushed[:, 0] > CURVE_SPEED))
        series = np.concatenate([push[:count], np.zeros(round(2.0 / h))])
        [slowed] = drive.run(series[:, None], np.array([[*values.values()]]), h)
    finally:
        drive.close()
    v, friction = slowed[count + 2 :].T
    end = int(np.argmax(~(v > SLOWEST))) if np.any(~(v > SLOWEST)) else len(v)
    return v[:end], friction[:end]
