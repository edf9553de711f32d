"""One step of a system with a set-valued friction row: linearly implicit, reversals located, exact sticking."""

from __future__ import annotations

import casadi as ca

from bristle.model.linear import Elimination
from bristle.model.system import DryRow, System

SX = ca.SX


def _weight(diagonal: list[SX], h: SX) -> SX:
    """Return the weight of the end of the step: 1/2, and towards 1 for rates too fast for the step, so that they decay.

    Source: hairer1996 section IV.3 (theta method: A-stable from 1/2; a mode of rate z/h is damped out by 1 - 1/z).
    """
    z = SX(0)
    for entry in diagonal:
        z = ca.fmax(z, h * ca.fabs(entry))
    return ca.fmax(0.5, (z - 1) / ca.fmax(z, 1))


def _bounds(dry: DryRow, v: SX, at: SX) -> tuple[SX, SX]:
    """Return (highest, lowest) friction acceleration at velocity `at`."""
    backward = dry.bound if dry.backward is None else dry.backward
    highest, lowest = ca.substitute([dry.bound / dry.inertia, -backward / dry.inertia], [v], [at])
    return highest, lowest


def proximal(system: System, h: SX) -> SX:
    """Return x after a step of length h with J v' = T - f, f in N Sgn(v).

    The smooth part is linearly implicit, (I/h - w A) dx = f(x), with the weight w = 1/2 unless a rate is too fast for
    the step. With the velocity eliminated last, what remains is S dv = r - f/J. If the velocity keeps its sign, f is the
    bound at the middle of the step. Otherwise it reaches zero after the share l = -v/dv of the step, and there
    f in N Sgn(v) is solved by projection: it sticks, or slides for the rest of the step. The other states see the mean
    velocity of the two parts. In the sticking branch dv = -v is set, not computed, so that velocity and position stand
    still to the last bit. Second-order accurate.

    Source: acary2008 (inclusion solved by closed-form projection; location of events), hairer1996 section IV.3 (theta
    method).
    """
    dry = system.dry
    assert dry is not None
    names = [name for name in system.states if name != dry.row] + [dry.row]
    x, v = system.vector(names), system.symbols[dry.row]
    f = ca.vertcat(*(system.rates[name] for name in names))
    a = ca.jacobian(f, x)
    weight = _weight([a[i, i] for i in range(x.shape[0])], h)
    factors = Elimination(SX.eye(x.shape[0]) / h - weight * a)
    y = factors.forward(f + weight * h * ca.jacobian(f, system.time))
    pivot, forward = factors.a[-1][-1], v > 0
    slide = (y[-1] - ca.if_else(forward, *_bounds(dry, v, v))) / pivot
    slide = (y[-1] - ca.if_else(forward, *_bounds(dry, v, v + slide / 2))) / pivot
    slides = v * (v + slide) > 0
    share = ca.if_else(v == 0, 0, -v / ca.if_else(slides, -1, slide))  # of the step, until the velocity is zero
    pull = y[-1] - a[-1, -1] * v  # acceleration at velocity zero, without friction
    highest, lowest = _bounds(dry, v, SX(0))
    rest = (1 - share) * (pull - ca.fmin(ca.fmax(pull, lowest), highest)) / pivot
    sticks = ca.logic_and(lowest <= pull, pull <= highest)
    dv = ca.if_else(slides, slide, ca.if_else(sticks, -v, rest - v))
    mean = (share * v + (1 - share) * rest) / 2
    x_new = x + factors.backward(y, last=ca.if_else(slides, slide, (mean - v) / weight))
    return ca.vertcat(*(v + dv if name == dry.row else x_new[names.index(name)] for name in system.states))
