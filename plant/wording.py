"""Words for an axis: texts of the catalogue have placeholders for what is called differently on
another kind of axis.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ROTARY", "Wording"]


@dataclass(frozen=True)
class Wording:
    """Fills the placeholders {torque}, {input}, {periods} and {range} of a text.

    Attributes
    ----------
    linear : bool
        True for a linear axis, on which a force acts.
    input_kind : str
        What the input is: voltage, current, torque or force.
    """

    linear: bool = False
    input_kind: str = "voltage"

    @property
    def torque(self) -> str:
        """What moves the axis."""
        return "force" if self.linear else "torque"

    @property
    def range(self) -> str:
        """What periods along the position are counted in."""
        return "the range travelled" if self.linear else "a turn"

    def fill(self, text: str) -> str:
        """Return a text with its placeholders filled."""
        periods = "2 pi over the length of a period" if self.linear else "periods in a turn"
        return text.format(
            torque=self.torque, input=self.input_kind, periods=periods, range=self.range
        )


ROTARY = Wording()
