"""One step of a system with a set-valued friction row: linearly implicit, friction in closed form, exact sticking."""

from __future__ import annotations

import casadi as ca

from bristle.model.linear import Elimination
from bristle.model.system import System

SX = ca.SX


def proximal(system: System, h: SX) -> SX:
    """Return x after a step of length h with J v' = T - f, f in N Sgn(v at the end of the step).

    The smooth part is linearly implicit Euler, (I/h - A) dx = f(x). With the velocity eliminated last, the step is one
    scalar inclusion, S dv = r - f/J, f in N Sgn(v + dv), solved by projection. In the sticking branch dv = -v is set,
    not computed, so that velocity and position stand still to the last bit. The bounds of the two directions may differ;
    both are those at the start of the step. First-order accurate.

    Source: moreau1988 (time stepping), acary2008 (closed-form projection).
    """
    dry = system.dry
    assert dry is not None
    names = [name for name in system.states if name != dry.row] + [dry.row]
    x, v = system.vector(names), system.symbols[dry.row]
    f = ca.vertcat(*(system.rates[name] for name in names))
    f_t = ca.jacobian(f, system.time)
    factors = Elimination(SX.eye(x.shape[0]) / h - ca.jacobian(f, x))
    y = factors.forward(f + h * f_t)
    pivot, limit = factors.a[-1][-1], dry.bound / dry.inertia
    stopping = y[-1] + pivot * v  # friction acceleration that would bring the velocity to zero in this step
    if dry.backward is None:
        friction, sticks = ca.fmin(ca.fmax(stopping, -limit), limit), ca.fabs(stopping) <= limit
    else:
        lowest = -dry.backward / dry.inertia
        friction, sticks = ca.fmin(ca.fmax(stopping, lowest), limit), ca.logic_and(lowest <= stopping, stopping <= limit)
    dv = ca.if_else(sticks, -v, (y[-1] - friction) / pivot)
    x_new = x + factors.backward(y, last=dv)
    return ca.vertcat(*(x_new[names.index(name)] for name in system.states))
