"""Approach I as printed: sliding-mode differentiators estimate v' and u', then Zhang's observer; kept to show that it fails."""

from __future__ import annotations

import casadi as ca

from bristle.model.basis import gaussian
from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import information, levant
from bristle.observer.method import EquationContext, Method, Sample, Update, stack, unstack, vector_states

SX = ca.SX
CITATION = "dixit2008 eq. (19)-(22)"
APPROACH_ONE_ENTRIES = units("alpha2", "b", "sigma0", "sigma1", "sigma2") | {"cb": "1/(s2.V)", "c_alpha2": "1/(rad.s)"} | units("c")
ESTIMATES = units("alpha2", "b", "sigma0", "sigma1", "sigma2", "c")
ENTRY_SIZES = (
    3.0,
    10.0,
    1000.0,
    1000.0,
    1000.0,
    1000.0,
    300.0,
    100.0,
)  # expected sizes of the entries: round numbers, not taken from a plant
LOWEST = {
    "alpha2": 0.0,
    "sigma0": 1.0,
    "c": 1.0,
}  # lower bounds of the published values; inside the recursion a bound would stop it


def regressor(v: SX, dv: SX, u: SX, du: SX) -> SX:
    """G as a row, x2' = G theta with theta = [alpha2, b, sigma0, sigma1, sigma2, c b, c alpha2, c].

    Source: dixit2008 eq. (20) and (22), with u-dot for its first u.
    """
    shapes = (-phi * v for phi in gaussian(v))
    return ca.horzcat(-dv, du, -v, *shapes, ca.fabs(v) * u, -ca.fabs(v) * v, -ca.fabs(v) * dv)


def adapt(p: Namespace, h: SX, error: SX, period: SX) -> tuple[SX, SX]:
    """Return (theta^ after the step, the information matrix) for the filtered regressor h and the output error.

    d theta = R^-1 h e with R the information of the last seconds, which forgets towards a prior, in place of a constant gain:
    eight entries are excited so unequally that no constant one tried came closer than 70 % in 10 s, even with u' exact.
    Source: zhang2002, with the gain of ljung1999 section 11.2.
    """
    before, prior = information.read(p, len(APPROACH_ONE_ENTRIES)), ca.diag(p.prior / SX(ENTRY_SIZES) ** 2)
    memory = ca.exp(-period / p.memory)
    r = memory * before + (1 - memory) * prior + h @ h.T
    theta = ca.vertcat(*(p[f"theta_{name}"] for name in APPROACH_ONE_ENTRIES))
    return theta + information.Factors(r).solve(h) * error, r


def estimates(p: Namespace) -> dict[str, SX]:
    """Return the six of the eight entries that are parameters."""
    return {name: ca.fmax(p[f"theta_{name}"], LOWEST.get(name, -1e9)) for name in ESTIMATES}


def gain_parameters(prefix: str, memory: float) -> tuple[Parameter, ...]:
    """Declare memory and prior of the gain."""
    return (
        Parameter(f"{prefix}.memory", "T", "s", memory, 1e-3, 1e6, "time over which data is forgotten", "ljung1999 section 11.2"),
        Parameter(f"{prefix}.prior", "r", "1", 1e-6, 1e-12, 1e6, "information that is never forgotten", "ljung1999 section 11.2"),
    )


def gain_states() -> tuple[State, ...]:
    """Declare the entries and their information."""
    return (
        *(State(f"theta_{name}", unit, f"estimate of {name}") for name, unit in APPROACH_ONE_ENTRIES.items()),
        *information.states(len(APPROACH_ONE_ENTRIES)),
    )


def _equations(context: EquationContext, s: Sample) -> Update:
    """Differentiate the samples of k-1, then run the observer with v and v' as its measured state.

    With A - K C = -k I in zhang2002 the row of x1 = v carries no parameter, and the row of x2 = v' is
    Ups' = -k Ups + G,   x2^' = G theta^ + k (x2 - x2^) + Ups theta^',   held over a sample with G and x2 linear.
    Source: dixit2008 eq. (19)-(22); levant1998, levant2003, zhang2002.
    """
    p = context.p
    velocity, voltage = stack(p, "velocity", 3), stack(p, "voltage", 2)
    velocity_new = levant.second_order(velocity, s.y0, p.v_limit, s.period)
    voltage_new = levant.first_order(voltage, s.u, p.u_limit, s.period)
    g = (regressor(velocity[0], velocity[1], voltage[0], voltage[1])
         + regressor(velocity_new[0], velocity_new[1], voltage_new[0], voltage_new[1])).T / 2  # fmt: skip
    decay = ca.exp(-p.k * s.period)
    theta = ca.vertcat(*(p[f"theta_{name}"] for name in APPROACH_ONE_ENTRIES))
    upsilon = decay * stack(p, "upsilon", len(APPROACH_ONE_ENTRIES)) + (1 - decay) / p.k * g
    x2 = decay * p.x2 + (1 - decay) * ((velocity[1] + velocity_new[1]) / 2 + ca.dot(g, theta) / p.k)
    theta_new, r = adapt(p, upsilon, velocity_new[1] - x2, s.period)
    return Update(
        next={
            **unstack("velocity", velocity_new),
            **unstack("voltage", voltage_new),
            **unstack("upsilon", upsilon),
            **information.write(r),
            **{f"theta_{name}": theta_new[i] for i, name in enumerate(APPROACH_ONE_ENTRIES)},
            "x2": x2 + ca.dot(upsilon, theta_new - theta),
        },
        estimates=estimates(p),
        signals={"v": p.velocity0},
        first={"velocity0": s.y1},
    )


METHOD = Method(
    "approach_one",
    "Approach I with Levant's differentiators and Zhang's observer (fails: a held input has no derivative)",
    "dixit2008 eq. (19)-(22)",
    "y_v",
    (
        Parameter("approach_one.k", "k", "1/s", 20.0, 1e-3, 1e4, "filter gain", "zhang2002"),
        Parameter("approach_one.v_limit", "L_v", "rad/s4", 1e5, 1e-3, 1e12, "bound on v''' that v' is exact for", "levant2003"),
        Parameter("approach_one.u_limit", "L_u", "V/s2", 1e3, 1e-3, 1e12, "bound on u'' that u' is exact for", "levant1998"),
        *gain_parameters("approach_one", 5.0),
    ),
    (
        *vector_states("velocity", "1", "estimate of v and its derivatives", 3),
        *vector_states("voltage", "1", "estimate of u and its derivative", 2),
        State("x2", "rad/s2", "estimate of v'"),
        *vector_states("upsilon", "1", "filtered regressor", len(APPROACH_ONE_ENTRIES)),
        *gain_states(),
    ),
    _equations,
)
