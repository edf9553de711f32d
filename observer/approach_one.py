"""Approach I as printed: sliding-mode differentiators estimate v' and u', then Zhang's observer;
kept to show that it fails.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from bristle.model.basis import gaussian, width_parameter
from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import information, levant, zhang
from bristle.observer.method import (
    EquationContext,
    Method,
    Sample,
    Update,
    never_valid,
    stack,
    unstack,
    vector_states,
)

SX = ca.SX
CITATION = "dixit2008 eq. (19)-(22)"
APPROACH_ONE_ENTRIES = (
    units("alpha2", "b", "sigma0", "sigma1", "sigma2")
    | {"cb": "1/(s2.V)", "c_alpha2": "1/(rad.s)"}
    | units("c")
)
ESTIMATES = units("alpha2", "b", "sigma0", "sigma1", "sigma2", "c")
# expected of sigma_i and c: round numbers, not taken from a plant
SIZES_OF_FOUR = (1000.0, 1000.0, 1000.0, 100.0)
ENTRY_SIZES = (3.0, 10.0, 1000.0, 1000.0, 1000.0, 1000.0, 300.0, 100.0)  # the same of all eight
# of the published values; inside the recursion a bound would stop it
LOWEST = {"alpha2": 0.0, "sigma0": 1.0, "c": 1.0}


def regressor(v: SX, dv: SX, u: SX, du: SX, width: SX) -> SX:
    """G as a row, x2' = G theta with theta = [alpha2, b, sigma0, sigma1, sigma2, c b, c alpha2, c].

    Source: dixit2008 eq. (20) and (22), with u-dot for its first u.
    """
    shapes = (-phi * v for phi in gaussian(v / width))
    return ca.horzcat(-dv, du, -v, *shapes, ca.fabs(v) * u, -ca.fabs(v) * v, -ca.fabs(v) * dv)


@dataclass(frozen=True)
class Entries:
    """What x2' = G theta is adapted in: names and units, expected sizes, which of them are
    published, and what is known.

    Where alpha2 and b are known, their terms are an acceleration that is known, and those of c b, c
    alpha2 and c are one.
    """

    names: Mapping[str, str]
    sizes: Sequence[float]
    published: Iterable[str]
    known: bool = False

    def split(self, p: Namespace, g: SX) -> tuple[SX, SX]:
        """Return (regressor of the entries, acceleration that is known) from the row of all eight.

        Source: dixit2008 eq. (20) and section III, Approach II (Approach I with alpha2 and b as
        known parameters).
        """
        if not self.known:
            return g, SX(0)
        return ca.horzcat(g[2:5], p.b * g[5] + p.alpha2 * g[6] + g[7]), p.alpha2 * g[0] + p.b * g[1]

    def read(self, p: Namespace) -> SX:
        """Return theta."""
        return SX(ca.vertcat(*(p[f"theta_{name}"] for name in self.names)))

    def write(self, theta: SX) -> dict[str, SX]:
        """Return the next states."""
        return {f"theta_{name}": theta[i] for i, name in enumerate(self.names)}

    def estimates(self, p: Namespace) -> dict[str, SX]:
        """Return the entries that are parameters."""
        return {
            name: ca.fmax(p[f"theta_{name}"], LOWEST.get(name, -1e9)) for name in self.published
        }

    def states(self) -> tuple[State, ...]:
        """Declare the entries and their information."""
        return (
            *(
                State(f"theta_{name}", unit, f"estimate of {name}")
                for name, unit in self.names.items()
            ),
            *information.states(len(self.names)),
        )


ALL = Entries(APPROACH_ONE_ENTRIES, ENTRY_SIZES, ESTIMATES)
FOUR = Entries(zhang.ESTIMATES, SIZES_OF_FOUR, zhang.ESTIMATES, known=True)


def adapt(p: Namespace, entries: Entries, h: SX, error: SX, period: SX) -> tuple[SX, SX]:
    """Return (theta^ after the step, the information matrix) for the filtered regressor h and the
    output error.

    d theta = R^-1 h e with R the information of the last seconds, which forgets towards a prior, in
    place of a constant gain: eight entries are excited so unequally that no constant one tried came
    closer than 70 % in 10 s, even with u' exact. Source: zhang2002, with the gain of ljung1999
    section 11.2.
    """
    before, prior = (
        information.read(p, len(entries.names)),
        ca.diag(p.prior / SX(list(entries.sizes)) ** 2),
    )
    memory = ca.exp(-period / p.memory)
    r = memory * before + (1 - memory) * prior + h @ h.T
    return entries.read(p) + information.Factors(r).solve(h) * error, r


def gain_parameters(prefix: str, memory: float) -> tuple[Parameter, ...]:
    """Declare memory and prior of the gain, and the width of the basis functions."""
    return (
        Parameter(
            f"{prefix}.memory",
            "T",
            "s",
            memory,
            1e-3,
            1e6,
            "time over which data is forgotten",
            "ljung1999 section 11.2",
        ),
        Parameter(
            f"{prefix}.prior",
            "r",
            "1",
            1e-6,
            1e-12,
            1e6,
            "information that is never forgotten",
            "ljung1999 section 11.2",
        ),
        width_parameter(prefix),
    )


def update(context: EquationContext, s: Sample, entries: Entries) -> Update:
    """Differentiate the samples of k-1, then run the observer with v and v' as its measured state.

    With A - K C = -k I in zhang2002 the row of x1 = v carries no parameter, and the row of x2 = v'
    is Ups' = -k Ups + G,   x2^' = G theta^ + k (x2 - x2^) + Ups theta^',   held over a sample with
    G and x2 linear. Source: dixit2008 eq. (19)-(22); levant1998, levant2003, zhang2002.
    """
    p = context.p
    velocity, voltage = stack(p, "velocity", 3), stack(p, "voltage", 2)
    velocity_new = levant.second_order(velocity, s.y0, p.v_limit, s.period)
    voltage_new = levant.first_order(voltage, s.u, p.u_limit, s.period)
    start = regressor(velocity[0], velocity[1], voltage[0], voltage[1], p.width)
    end = regressor(velocity_new[0], velocity_new[1], voltage_new[0], voltage_new[1], p.width)
    g, push = entries.split(p, (start + end) / 2)
    theta = entries.read(p)
    decay = ca.exp(-p.k * s.period)
    upsilon = decay * stack(p, "upsilon", len(entries.names)) + (1 - decay) / p.k * g.T
    x2 = decay * p.x2 + (1 - decay) * (
        (velocity[1] + velocity_new[1]) / 2 + (g @ theta + push) / p.k
    )
    theta_new, r = adapt(p, entries, upsilon, velocity_new[1] - x2, s.period)
    return Update(
        next={
            **unstack("velocity", velocity_new),
            **unstack("voltage", voltage_new),
            **unstack("upsilon", upsilon),
            **information.write(r),
            **entries.write(theta_new),
            "x2": x2 + ca.dot(upsilon, theta_new - theta),
        },
        estimates=entries.estimates(p),
        **never_valid(entries.published),  # what it needs of the input is not seen in its signals
        signals={"v": p.velocity0},
        first={"velocity0": s.y1},
    )


def _equations(context: EquationContext, s: Sample) -> Update:
    return update(context, s, ALL)


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare filter, differentiators and gain under a method's name."""
    return (
        Parameter(f"{prefix}.k", "k", "1/s", 20.0, 1e-3, 1e4, "filter gain", "zhang2002"),
        Parameter(
            f"{prefix}.v_limit",
            "L_v",
            "rad/s4",
            1e5,
            1e-3,
            1e12,
            "bound on v''' that v' is exact for",
            "levant2003",
        ),
        Parameter(
            f"{prefix}.u_limit",
            "L_u",
            "V/s2",
            1e3,
            1e-3,
            1e12,
            "bound on u'' that u' is exact for",
            "levant1998",
        ),
        *gain_parameters(prefix, 5.0),
    )


def states(entries: Entries) -> tuple[State, ...]:
    """Declare differentiators, filter and entries."""
    return (
        *vector_states("velocity", "1", "estimate of v and its derivatives", 3),
        *vector_states("voltage", "1", "estimate of u and its derivative", 2),
        State("x2", "rad/s2", "estimate of v'"),
        *vector_states("upsilon", "1", "filtered regressor", len(entries.names)),
        *entries.states(),
    )


METHOD = Method(
    "approach_one",
    "Approach I with Levant's differentiators and Zhang's observer (fails: a held input has no"
    " derivative)",
    "dixit2008 eq. (19)-(22)",
    "y_v",
    parameters("approach_one"),
    states(ALL),
    _equations,
)
