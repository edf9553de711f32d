"""Maxwell-slip elements: springs side by side, each with a mode, sticking or slipping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from bristle.model.system import Directed
from bristle.model.variables import Parameter, State

SX = ca.SX

MAXWELL_ELEMENTS = 4
STIFFNESSES = (0.40, 0.25, 0.15, 0.08)  # N.m/rad, of the four elements
MAXWELL_SHARES = (0.1, 0.2, 0.3, 0.4)  # shares of the friction level, of the four elements


@dataclass(frozen=True)
class Element:
    """The equations of one element: rate of its force; next value of its mode, and how far it is
    past its switching point.
    """

    rate: SX
    switch: tuple[SX, SX, Directed]


def element(
    force: SX, slip: SX, speed: SX, limit: SX, rates: tuple[SX, SX], sizes: tuple[SX, SX]
) -> Element:
    """Return an element whose mode `slip` is the direction it slips in, 0 while it sticks.

    It sticks, with the first of the `rates`, until its force in the direction of motion reaches the
    limit; then it slips, with the second, until the motion reverses. `sizes` are those of the force
    and of the speed.

    Source: albender2005 (generalised Maxwell-slip element), lampaert2002 (Maxwell-slip element).
    """
    excess = ca.sign(speed) * force - limit
    sticks = slip == 0
    following = ca.if_else(
        sticks, ca.if_else(excess >= 0, ca.sign(speed), 0), ca.if_else(slip * speed > 0, slip, 0)
    )
    past = ca.if_else(sticks, excess / sizes[0], -slip * speed / sizes[1])
    forward, backward = (
        ca.if_else(sticks, (way * force - limit) / sizes[0], past) for way in (1, -1)
    )
    return Element(
        ca.if_else(sticks, *rates),
        (following, past, Directed(forward, backward, speed)),
    )


def stiffnesses(law: str, source: str) -> tuple[Parameter, ...]:
    """Return the parameters k1, k2, ... of a law's elements."""
    return tuple(
        Parameter(
            f"{law}.k{i}", f"k{i}", "N.m/rad", k, 1e-6, 1e9, f"stiffness of element {i}", source
        )
        for i, k in enumerate(STIFFNESSES, start=1)
    )


def memory() -> tuple[Sequence[State], Sequence[State]]:
    """Return the states F1, F2, ... and the modes slip1, slip2, ... of a law's elements."""
    places = range(1, MAXWELL_ELEMENTS + 1)
    forces = [
        State(f"F{i}", "N.m", f"force of element {i} at nominal load", scale=lambda p: p.Fc)
        for i in places
    ]
    return forces, [
        State(f"slip{i}", "1", f"direction in which element {i} slips, 0 while it sticks")
        for i in places
    ]
