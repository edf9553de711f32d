"""The original LuGre law identified directly with its nonlinear parameters: hierarchical min-max
estimation from velocity.

With sigma1 = 0, (7)-(10) over the inertia are w' = sigma0 (v - |v| w / N), N = Fc + Fd exp(-q v^2),
where q = 1/v0^2, Fc = sigma0 a0 and Fd = sigma0 a1. In the direction of motion, with the speed |v|,
that is
    |v| w = N (|v| - w' / sigma0),
and each factor and term is e to the power of something affine in theta = (ln Fc, ln Fd, q, -ln
sigma0): convex, up to a sign. The upper level keeps the region in which theta lies; the lower level
moves the estimate in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State, declaring
from bristle.observer import zhang
from bristle.observer.interval import TINY, Interval
from bristle.observer.method import EquationContext, Method, Sample, Update, stack, unstack

SX = ca.SX
CITATION = "cao2003; dixit2008 eq. (7)-(10)"
REGION = {  # of theta at the start, given by its physical meaning: intervals that hold most servos
    "Fc": ("rad/s2", 0.1, 100.0, "Coulomb friction over inertia"),
    "Fd": ("rad/s2", 0.1, 100.0, "static friction above it, over inertia"),
    "v0": ("rad/s", 0.05, 1.75, "Stribeck velocity"),
    "sigma0": ("1/s2", 10.0, 1e5, "stiffness over inertia"),
}
INDICES = range(len(REGION))
LEAST_SPEED = 1e-9  # rad/s; the speed is divided by
CONTRADICTION_SHARE = 1e-3  # share of contradicting samples from which the model counts as wrong


@dataclass(frozen=True)
class Equation:
    """What is known of speed w = N (speed - w'/sigma0) in the direction of motion, and the error
    bound of each.
    """

    speed: SX
    w: SX
    dw: SX
    speed_error: SX
    w_error: SX
    dw_error: SX


def equation(p: Namespace, s: Sample) -> tuple[Equation, SX]:
    """Return the friction that follows from two samples, and whether the velocity is steady enough
    for it to hold.

    The mean of w over a sample follows from (15), u being held and v next to linear; two of them
    give w and w' between, and that w' belongs to v weighted by the triangle (1, 4, 1)/6. Errors are
    a share of each term that speed, w and w' are made of. Source: dixit2008 eq. (7)-(9) with sigma1
    = 0.
    """
    h = s.period
    earlier = p.b * p.u_before - p.alpha2 * (p.v_before + s.y0) / 2 - (s.y0 - p.v_before) / h
    later = p.b * s.u - p.alpha2 * (s.y0 + s.y1) / 2 - (s.y1 - s.y0) / h
    v, dv = (p.v_before + 4 * s.y0 + s.y1) / 6, (s.y1 - p.v_before) / 2
    direction, speed = ca.sign(v), ca.fabs(v)
    jerk = ca.fabs(s.y1 - 2 * s.y0 + p.v_before)
    w_size = ca.fabs(p.b) * ca.fabs(s.u + p.u_before) / 2 + p.alpha2 * speed + ca.fabs(dv) / h
    dw_size = (ca.fabs(p.b) * ca.fabs(s.u - p.u_before) + p.alpha2 * ca.fabs(dv) + jerk / h) / h
    w, dw = direction * (earlier + later) / 2, direction * (later - earlier) / h
    known = Equation(speed, w, dw, *(p.tolerance * size for size in (speed, w_size, dw_size)))
    return known, ca.logic_and(p.samples >= 2, ca.fabs(dv) + LEAST_SPEED < p.steadiness * speed)


def contract(e: Equation, region: list[Interval]) -> list[Interval]:
    """Return the part of the region that agrees with the equation; an empty interval if none does.

    Each factor and each term of N (speed - w'/sigma0) = speed w is solved for in turn, and the
    others are intervals. Source: cao2003 (the region that the upper level keeps).
    """
    fc, fd, q, compliance = region
    x = e.speed**2
    level, fall, soft = fc.exp(), (fd - q.times(x)).exp(), compliance.exp()
    n = level + fall
    slack = e.speed * e.w_error + n.hi * (e.speed_error + soft.hi * e.dw_error)
    left = Interval(e.speed * e.w - slack, e.speed * e.w + slack)
    rest = Interval(e.speed, e.speed) - soft.times(e.dw)
    quotient = left.over(rest)
    definite = rest.lo * rest.hi > 0
    n = n.meet(
        Interval(ca.if_else(definite, quotient.lo, n.lo), ca.if_else(definite, quotient.hi, n.hi))
    )
    falls = (n - level).log()
    bent = Interval(e.speed, e.speed) - left.over(n)
    moved = bent.over(Interval(e.dw, e.dw)).log()
    moves = ca.fabs(e.dw) > 0
    found = [
        (n - fall).log(),
        falls + q.times(x),
        (fd - falls).times(1 / x),
        Interval(
            ca.if_else(moves, moved.lo, compliance.lo), ca.if_else(moves, moved.hi, compliance.hi)
        ),
    ]
    empty = n.lo > n.hi
    met = [old.meet(new) for old, new in zip(region, found, strict=True)]
    return [Interval(ca.if_else(empty, 1, each.lo), ca.if_else(empty, 0, each.hi)) for each in met]


def lower(e: Equation, region: list[Interval], theta: SX) -> SX:
    """Return the estimate after one min-max step.

    The equation is f(theta) = speed w with four terms c exp(z), z affine in theta. A convex term is
    bounded from below by its tangent and from above by its chord over the region, a concave one the
    other way round: of the two bounds of f that are affine in theta, the one on the side of the
    error holds for the true theta. What is left of the error after the gaps of the chords says in
    which half-space the true theta lies; the step goes onto its edge, which brings the estimate no
    farther from it. Errors of measurement find no dead zone here: the region, which allows for
    them, bounds what they can do. Source: skantze2000, cao2003 (the lower level).
    """
    x = e.speed**2
    slopes = (SX([1, 0, 0, 0]), ca.vertcat(0, 1, -x, 0), SX([1, 0, 0, 1]), ca.vertcat(0, 1, -x, 1))
    factors = (e.speed, e.speed, -e.dw, -e.dw)
    fc, fd, q, compliance = region
    fall = fd - q.times(x)
    exponents = (fc, fall, fc + compliance, fall + compliance)
    values = [ca.exp(ca.dot(slope, theta)) for slope in slopes]
    error = e.speed * e.w - sum(c * value for c, value in zip(factors, values, strict=True))
    side = ca.sign(error)
    direction, gape = SX(4, 1), SX(0)
    for slope, c, z, value in zip(slopes, factors, exponents, values, strict=True):
        width = ca.fmax(z.hi - z.lo, 1e-9)
        chord = (ca.exp(z.hi) - ca.exp(z.lo)) / width
        gap = ca.fmax(ca.exp(z.lo) + chord * (ca.dot(slope, theta) - z.lo) - value, 0)
        above = c * side > 0
        direction += slope * c * ca.if_else(above, chord, value)
        gape += ca.if_else(above, ca.fabs(c) * gap, 0)
    excess = ca.fmax(ca.fabs(error) - gape, 0)
    gain = ca.vertcat(*((each.hi - each.lo) ** 2 + 1e-12 for each in region))
    return theta + gain * direction * (side * excess / (ca.dot(direction, gain * direction) + TINY))


def widest(p: Namespace) -> list[Interval]:
    """Return the region at the start."""

    def between(name: str) -> Interval:
        return Interval(ca.log(p[f"{name}_least"]), ca.log(p[f"{name}_most"]))

    soft = between("sigma0")
    return [
        between("Fc"),
        between("Fd"),
        Interval(1 / p.v0_most**2, 1 / p.v0_least**2),
        Interval(-soft.hi, -soft.lo),
    ]


def upper(p: Namespace, e: Equation, steady: SX) -> tuple[SX, SX, SX]:
    """Return (lower bounds, upper bounds, whether the equation contradicts the region).

    What contradicts the region opens it by a share towards what it was at the start. Source:
    cao2003 (the upper level); the region is narrowed at every sample, not when the lower level has
    settled.
    """
    before = [Interval(p[f"least{i}"], p[f"most{i}"]) for i in INDICES]
    left = contract(e, before)
    whole = widest(p)

    def column(end: str, regions: list[Interval]) -> SX:
        return SX(ca.vertcat(*(getattr(each, end) for each in regions)))

    lo, hi = column("lo", before), column("hi", before)
    new_lo, new_hi = column("lo", left), column("hi", left)
    counts = ca.logic_and(steady, p.narrowing > 0)
    contradicts = ca.logic_and(counts, ca.mmax(new_lo - new_hi) > 0)
    opened_lo, opened_hi = (
        lo + p.opening * (column("lo", whole) - lo),
        hi + p.opening * (column("hi", whole) - hi),
    )
    return (
        ca.if_else(contradicts, opened_lo, ca.if_else(counts, new_lo, lo)),
        ca.if_else(contradicts, opened_hi, ca.if_else(counts, new_hi, hi)),
        contradicts,
    )


def _equations(context: EquationContext, s: Sample) -> Update:
    """Narrow the region (upper level), and take a step in it (lower level).

    Source: cao2003.
    """
    p = context.p
    known, steady = equation(p, s)
    lo, hi, contradicts = upper(p, known, steady)
    theta, region = stack(p, "theta", 4), [Interval(lo[i], hi[i]) for i in INDICES]
    moved = ca.if_else(steady, lower(known, region, theta), theta)
    theta_new = ca.fmin(ca.fmax(moved, lo), hi)
    doubt = p.doubt + s.period / ca.fmax(p.memory, s.period) * (contradicts - p.doubt)
    return Update(
        next={
            **unstack("theta", theta_new),
            **unstack("least", lo),
            **unstack("most", hi),
            "u_before": s.u,
            "v_before": s.y0,
            "doubt": doubt,
        },
        estimates=_estimates(p),
        **worth(p),
        adapted=narrowed(p),
        innovation=p.doubt / CONTRADICTION_SHARE,
    )


def narrowed(p: Namespace) -> SX:
    """Return whether the region is smaller than at the start, or the estimate left its middle."""
    changed = SX(0)
    for i, whole in enumerate(widest(p)):
        for name, start in (("least", whole.lo), ("most", whole.hi), ("theta", whole.middle)):
            changed = ca.logic_or(changed, p[f"{name}{i}"] != start)
    return changed


def worth(p: Namespace) -> dict[str, Any]:
    """Return standard deviations and validity: close to all of the region, while almost no samples
    contradict it.

    The bounds of the region count as two standard deviations.
    """
    fc, fd, q, soft = (
        ca.fmax(p[f"most{i}"] - p[f"theta{i}"], p[f"theta{i}"] - p[f"least{i}"]) for i in INDICES
    )
    # relative errors
    largest = {"sigma0": soft, "a0": fc + soft, "a1": fd + soft, "v0": q / (2 * p.theta2), "Fc": fc}
    close = {
        name: ca.logic_and(p.doubt < CONTRADICTION_SHARE, each < p.precision)
        for name, each in largest.items()
    }
    found = _estimates(p)
    return {"valid": close, "sd": {name: each * found[name] / 2 for name, each in largest.items()}}


def _estimates(p: Namespace) -> dict[str, SX]:
    """Return what theta says of the law."""
    return {
        "sigma0": ca.exp(-p.theta3),
        "a0": ca.exp(p.theta0 + p.theta3),
        "a1": ca.exp(p.theta1 + p.theta3),
        "v0": 1 / ca.sqrt(p.theta2),
        "Fc": ca.exp(p.theta0),
    }


_own = declaring("cao", CITATION)
METHOD = Method(
    "cao",
    "hierarchical min-max estimation of the original LuGre law; alpha2 and b known",
    "cao2003, skantze2000",
    "y_v",
    (
        *zhang.known_parameters("cao"),
        *(
            Parameter(
                f"cao.{name}_{end}",
                name,
                unit,
                value,
                1e-6,
                1e9,
                f"{end} that is possible of {what}",
                CITATION,
            )
            for name, (unit, least, most, what) in REGION.items()
            for end, value in (("least", least), ("most", most))
        ),
        _own(
            "tolerance",
            "epsilon",
            "1",
            (2e-3, 1e-9, 1.0),
            "error of each measured term over its size",
        ),
        _own(
            "steadiness",
            "s",
            "1",
            (0.05, 1e-6, 1.0),
            "change over speed up to which a pair of samples counts",
        ),
        _own(
            "narrowing",
            "n",
            "1",
            (1.0, 0.0, 1.0),
            "1: two levels; 0: the lower level alone, in a fixed region",
        ),
        _own(
            "opening", "o", "1", (0.01, 0.0, 1.0), "share by which a contradiction opens the region"
        ),
        _own("memory", "T", "s", (5.0, 1e-3, 1e6), "time over which contradictions are counted"),
        _own(
            "precision", "r", "1", (0.15, 0.0, 1e3), "relative error that a valid estimate may have"
        ),
    ),
    (
        *(
            State(f"theta{i}", "1", f"estimate ({i})", initial=lambda p, i=i: widest(p)[i].middle)
            for i in INDICES
        ),
        *(
            State(
                f"least{i}",
                "1",
                f"lower bound of the region ({i})",
                initial=lambda p, i=i: widest(p)[i].lo,
            )
            for i in INDICES
        ),
        *(
            State(
                f"most{i}",
                "1",
                f"upper bound of the region ({i})",
                initial=lambda p, i=i: widest(p)[i].hi,
            )
            for i in INDICES
        ),
        State("u_before", "V", "input before the last one"),
        State("v_before", "rad/s", "velocity before the last one"),
        State("doubt", "1", "share of samples that contradict the region"),
    ),
    _equations,
)
