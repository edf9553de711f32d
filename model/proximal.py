"""One step of a system with a set-valued friction row: linearly implicit, reversals located, exact
sticking.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from bristle.model.linear import Elimination
from bristle.model.system import DryRow, System

SX = ca.SX

# steps for the distance of bristles; they close in from one side, from where the servo would slide
NEWTON = 2


def _weight(diagonal: list[SX], h: SX) -> SX:
    """Return the weight of the end of the step: 1/2, and towards 1 for rates too fast for the step,
    so that they decay.

    Source: hairer1996 section IV.3 (theta method: A-stable from 1/2; a mode of rate z/h is damped
    out by 1 - 1/z).
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


@dataclass(frozen=True)
class _Row:
    """The velocity's row once all else is eliminated: pivot dv = pull - friction (accelerations),
    from velocity v.
    """

    dry: DryRow
    v: SX
    pull: SX
    at_rest: SX  # pull at velocity zero
    pivot: SX
    weight: SX  # of dv in the mean velocity of the step
    h: SX


@dataclass(frozen=True)
class Unknown:
    """What a step solves for by iteration: its symbol in the step, its solution, and the equation
    (zero there).
    """

    symbol: SX
    solution: SX
    equation: SX


def proximal(system: System, h: SX) -> tuple[SX, list[Unknown]]:
    """Return x after a step of length h with J v' = T - f, f in N Sgn(v) or bristles in its place.

    What bristles solve for by iteration stands in x as symbols and is returned beside it, so that
    derivatives come from the equations instead of the iterations.

    The smooth part is linearly implicit, (I/h - w A) dx = f(x), with the weight w = 1/2 unless a
    rate is too fast for the step. The velocity is eliminated last, the other states see its mean.
    Second-order accurate.

    Source: acary2008 (inclusion solved by closed-form projection; location of events), hairer1996
    section IV.3 (theta method).
    """
    dry = system.dry
    assert dry is not None
    names = [name for name in system.states if name not in (dry.row, dry.deflection)] + [dry.row]
    x, v = system.vector(names), system.symbols[dry.row]
    f = ca.vertcat(*(system.rates[name] for name in names))
    a = ca.jacobian(f, x)
    weight = _weight([a[i, i] for i in range(x.shape[0])], h)
    factors = Elimination(SX.eye(x.shape[0]) / h - weight * a)
    y = factors.forward(f + weight * h * ca.jacobian(f, system.time))
    row = _Row(dry, v, y[-1], y[-1] - a[-1, -1] * v, factors.a[-1][-1], weight, h)
    after: dict[str, SX] = {}
    unknowns: list[Unknown] = []
    if dry.deflection is None:
        dv, mean = _slip(row)
    else:
        dv, mean, after[dry.deflection], unknowns = _bend(row, system.symbols[dry.deflection])
    x_new = x + factors.backward(y, last=(mean - v) / weight)
    after |= {name: x_new[i] for i, name in enumerate(names)} | {dry.row: v + dv}
    return ca.vertcat(*(after[name] for name in system.states)), unknowns


def _slip(row: _Row) -> tuple[SX, SX]:
    """Return (change, mean) of the velocity over a step with set-valued friction.

    If the velocity keeps its sign, f is the bound at the middle of the step. Otherwise it reaches
    zero after the share l = -v/dv of the step, and there f in N Sgn(v) is solved by projection: it
    sticks, or slides for the rest of the step. In the sticking branch dv = -v is set, not computed,
    so that velocity and position stand still to the last bit.
    """
    v, forward = row.v, row.v > 0
    slide = (row.pull - ca.if_else(forward, *_bounds(row.dry, v, v))) / row.pivot
    slide = (row.pull - ca.if_else(forward, *_bounds(row.dry, v, v + slide / 2))) / row.pivot
    slides = v * (v + slide) > 0
    share = ca.if_else(v == 0, 0, -v / ca.if_else(slides, -1, slide))
    highest, lowest = _bounds(row.dry, v, SX(0))
    rest = (1 - share) * (row.at_rest - ca.fmin(ca.fmax(row.at_rest, lowest), highest)) / row.pivot
    sticks = ca.logic_and(lowest <= row.at_rest, row.at_rest <= highest)
    dv = ca.if_else(slides, slide, ca.if_else(sticks, -v, rest - v))
    return dv, ca.if_else(slides, v + row.weight * slide, (share * v + (1 - share) * rest) / 2)


@dataclass(frozen=True)
class _Leg:
    """A share of the step in one direction: from a velocity and a deflection, against a level."""

    share: SX
    side: SX  # 1 forward, -1 backward
    v: SX
    z: SX
    pull: SX  # at this velocity
    level: SX


def _path(row: _Row, leg: _Leg) -> tuple[Unknown, SX]:
    """Return (distance, deflection) after a leg.

    Bristles relax with the distance d: z = s + (z0 - s) exp(-d/b), with b = level / stiffness and s
    = side b, so that their mean force along the way is a function of d alone, and d solves one
    scalar equation. It is concave and rises: Newton's steps from the left, from where it would
    slide, close in on it from one side. A negative distance belongs to a step that reverses in its
    first half; there the equation goes on along its tangent, and the distance tells when.
    """
    dry, side, level, tau = row.dry, leg.side, leg.level, leg.share * row.h
    pivot, weight = row.pivot / leg.share, ca.if_else(leg.share < 1, 0.5, row.weight)
    length = level * dry.inertia / dry.stiffness
    # how far the deflection is from its limit, counted in the direction of motion
    gap = side * (side * length - leg.z)
    elastic, viscous = dry.stiffness / dry.inertia, dry.damping / (dry.inertia * tau)
    offset = pivot * side * leg.v / weight + side * leg.pull - level
    slope = pivot / (weight * tau)

    def equation(d: SX) -> tuple[SX, SX]:
        ahead = ca.fmax(d, 0)
        q = ahead / length
        decay = ca.exp(-q)
        small = q < 1e-4  # there the closed forms lose their digits
        mean = ca.if_else(small, 1 - q / 2 + q * q / 6, (1 - decay) / ca.if_else(small, 1, q))
        # derivative of the mean by q
        bend = ca.if_else(small, -0.5 + q / 3, (decay - mean) / ca.if_else(small, 1, q))
        value = slope * ahead - offset - elastic * gap * mean + viscous * gap * (1 - decay)
        rise = slope - elastic * gap * bend / length + viscous * gap * decay / length
        return value + rise * (d - ahead), rise

    value, rise = equation(SX(0))
    least = ca.fmin(-value / rise, 0)
    solution = ca.fmax(offset / slope, 0)
    for _ in range(NEWTON):
        value, rise = equation(solution)
        solution = ca.fmax(solution - value / rise, least)
    d = SX.sym("d")
    return Unknown(d, solution, equation(d)[0]), side * length - side * gap * ca.exp(-d / length)


def _bend(row: _Row, z: SX) -> tuple[SX, SX, SX, list[Unknown]]:
    """Return (change, mean) of the velocity, the deflection after a step with bristles, and what is
    solved for.

    A reversal within the step is located as for set-valued friction; then the bristles bend from
    where they were.

    Source: dahl1968 (friction as a function of the distance), canudas1995 (its damping),
    gonzalez1996 (mean force).
    """
    v, dry = row.v, row.dry
    upper, lower = _bounds(dry, v, v)
    side, level = ca.if_else(v < 0, -1, 1), ca.if_else(v < 0, -lower, upper)
    on, bent = _path(row, _Leg(SX(1), side, v, z, row.pull, level))
    dv = (side * on.symbol / row.h - v) / row.weight
    keeps = v * (v + dv) > 0
    # a reversal in the last instant of the step is taken a little earlier: nothing is to be divided
    # by what is left of it
    share = ca.if_else(
        v == 0, 0, ca.fmin(-v / ca.if_else(ca.logic_or(keeps, v == 0), -1, dv), 1 - 1e-4)
    )
    before = ca.fabs(v) * share * row.h / 2
    length = level * dry.inertia / dry.stiffness
    middle = side * length - (side * length - z) * ca.exp(-before / length)
    push = row.at_rest - dry.stiffness / dry.inertia * middle
    turned = ca.if_else(push < 0, -1, 1)
    upper, lower = _bounds(dry, v, SX(0))
    against = ca.if_else(push < 0, -lower, upper)
    back, end = _path(row, _Leg(1 - share, turned, SX(0), middle, row.at_rest, against))
    rest = 2 * turned * back.symbol / ((1 - share) * row.h)
    mean = ca.if_else(keeps, side * on.symbol, side * before + turned * back.symbol) / row.h
    return ca.if_else(keeps, dv, rest - v), mean, ca.if_else(keeps, bent, end), [on, back]
