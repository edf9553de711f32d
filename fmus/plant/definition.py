"""The servo with friction, all laws or one."""

from __future__ import annotations

from collections.abc import Sequence

from bristle.model.program import Program
from bristle.plant.servo import servo_program


def program(law: str | None = None, effects: Sequence[str] = (), encoder: bool = True) -> Program:
    """Return ServoPlant; of a smooth law alone and without the encoder, Model Exchange can be
    offered.
    """
    return servo_program(law, encoder=encoder, effects=effects)
