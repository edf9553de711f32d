"""The servo with friction, all laws or one."""

from __future__ import annotations

from collections.abc import Sequence

from bristle.model.program import Program
from bristle.plant.servo import servo_program


def program(law: str | None = None, effects: Sequence[str] = (), encoder: bool = False) -> Program:
    """Return ServoPlant; of a smooth law alone without the encoder, so that Model Exchange can be offered, unless asked for."""
    if law is None or encoder:
        return servo_program(law, effects=effects)
    lean = servo_program(law, encoder=False, effects=effects)
    return lean if lean.variants[0].system.smooth else servo_program(law, effects=effects)
