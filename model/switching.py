"""Modes that switch within a step: locating the switch, and derivatives across it."""

from __future__ import annotations

import casadi as ca

from bristle.model.system import MAX_STEP, System

SX = ca.SX


# overshoot of a switching point, relative to the size of the margin, up to which a step is accepted
SWITCHING_TOLERANCE = 1e-10


def passed(system: System, end: SX, h: SX) -> list[SX]:
    """Return how much farther a step of length h that ends in the states `end` goes past each
    switching point.

    Taken as an error of the step, it makes the step control locate the point, also if the motion
    reverses between it and the end. Where a step begins past it, because an input jumped or a state
    was set, the excess counts in proportion to the length: the mode switches after a very short
    time. So it does where an element that slipped and reversed, and so sticks past its limit by an
    overshoot, reverses once more.

    Source: gear1984 (the control of the step locates a discontinuity).
    """
    x, longest = system.vector(list(system.states)), system.symbols[MAX_STEP.name]
    found = []
    for name, margin in system.margins.items():
        before, late = margin, ca.substitute(margin, x, end)
        if name in system.directed:
            way = system.directed[name]
            before = ca.fmax(way.forward, way.backward)
            forward, backward = ca.substitute([way.forward, way.backward], [x], [end])
            late = ca.fmax(late, ca.if_else(way.speed > 0, forward, backward))
        found.append(late - ca.fmax(before, 0) * (1 - h / longest) - SWITCHING_TOLERANCE)
    return found


def at_the_point(system: System, end: SX, h: SX) -> SX:
    """Return the end of a step of length h as it would be if a mode that switches there had
    switched at its point.

    Since that point a state had the old rate instead of the new one, for the time margin/margin'.
    The time is nearly zero, but its derivative by a parameter is not: derivatives of this end,
    unlike those of `end`, are right across a switch.

    Source: leine2004 (saltation matrix: jump of the derivative where the right-hand side jumps).
    """
    if not system.margins:
        return end
    x, f, shift = system.vector(list(system.states)), system.rate_vector(), SX.zeros(end.shape[0])
    for name, margin in system.margins.items():
        pace = ca.jtimes(margin, x, f) + ca.jacobian(margin, system.time)
        # all of the step, if it began past the point
        late = ca.fmin(ca.fmax(margin, 0) / ca.fmax(pace, 1e-300), h)
        for i in range(f.shape[0]):
            if ca.depends_on(f[i], system.symbols[name]):
                shift[i] += late * (
                    ca.substitute(f[i], system.symbols[name], system.updates[name]) - f[i]
                )
    return end + ca.substitute(shift, x, end)
