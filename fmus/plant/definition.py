"""The servo with friction, all laws or one."""

from __future__ import annotations

from collections.abc import Sequence

from bristle.model.program import Program
from bristle.plant.servo import servo_program


def program(law: str | None = None, effects: Sequence[str] = (), encoder: bool = True) -> Program:
    """Return ServoPlant; of a smooth law without the encoder it can offer Model Exchange."""
    return servo_program(law, encoder=encoder, effects=effects)
