"""The filter shared by Besancon's observer and its matrix-gain form, exact over a sample.

Besancon, Zhang and Hammouri's observer (6) is, in the coordinates Ups = lam^-n Lam^-1 G and K = lam
Lam^-1 K0,
    Ups' = (A0 - K C0) Ups + psi,   x^' = (A0 - K C0) x^ + phi + psi theta^ + K y + Ups theta^',
    theta^' = S Ups' C0' (y - C0 x^),
with S = lam^(2n) I as printed, or a matrix S.
Source: besancon2004 eq. (6), zhang2002, dixit2008 eq. (6).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca

from bristle.model.basis import gaussian, width_parameter
from bristle.model.linear import expm
from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer.method import EquationContext, stack, unstack, vector_states

SX = ca.SX
CITATION = "besancon2004 eq. (6); dixit2008 eq. (6)"
ESTIMATES = units("sigma0", "sigma1", "sigma2", "c")
ENTRIES = ESTIMATES | {"c_load": "1/s2"}  # c times the load torque over the inertia
Memory = tuple[SX, SX, SX]  # x^, Ups, theta^
ENTRY_SCALES = (1000.0, 1000.0, 1000.0, 100.0, 100.0)  # round numbers, not taken from a plant


@dataclass(frozen=True)
class Filter:
    """x_k = phi x_(k-1) + m0 f_(k-1) + m1 f_k for x' = (A0 - K C0) x + f with f linear over the
    sample; K itself.
    """

    phi: SX
    m0: SX
    m1: SX
    k: SX


def make_filter(context: EquationContext, k0: SX, lam: SX, period: SX, name: str = "") -> Filter:
    """Compute the exact filter once, at initialisation, from K0 and lam; its constants begin with
    `name`.

    The exponential is taken in the scaled coordinates of (6), where the matrix is smallest, with a
    first-order hold: exp of [[A, I, 0], [0, 0, I/Ts], [0, 0, 0]] Ts. Source: vanloan1978.
    """
    n = k0.shape[0]
    shift = SX(n, n)
    for i in range(n - 1):
        shift[i, i + 1] = 1
    a = lam * shift
    a[:, 0] = a[:, 0] - lam * k0
    scale = ca.vertcat(*(lam**i for i in range(n)))  # Lam^-1
    block = SX(3 * n, 3 * n)
    block[:n, :n] = a * period
    block[:n, n : 2 * n] = SX.eye(n) * period
    block[n : 2 * n, 2 * n :] = SX.eye(n)
    exponential = expm(block)
    back = ca.diag(scale)
    into = ca.diag(1 / scale)
    phi, held, ramp = (back @ exponential[:n, i * n : (i + 1) * n] @ into for i in range(3))
    # f = f0 + (f1 - f0) t/Ts
    return Filter(
        context.constant(f"{name}phi", phi),
        context.constant(f"{name}m0", held - ramp),
        context.constant(f"{name}m1", ramp),
        context.constant(f"{name}k", lam * scale * k0),
    )


def ahead(f: Filter, x: SX, f0: SX, f1: SX, rate: SX) -> SX:
    """Advance two states driven from f0 to f1 - [0, rate x2], whose x2 at the end is linear in
    itself and solved for.
    """
    free = f.phi @ x + f.m0 @ f0 + f.m1 @ f1
    x2 = free[1] / (1 + f.m1[1, 1] * rate)
    return ca.vertcat(free[0] - f.m1[0, 1] * rate * x2, x2)


Basis = Callable[[SX], list[SX]]  # phi_i of a velocity in the unit in which the observer computes


def basis(p: Namespace) -> Basis:
    """Return the basis functions of a velocity in rad/s."""
    return lambda v: gaussian(v / p.width)


def regressor(v: SX, x2: SX, phi: Basis) -> SX:
    """psi of step 2 as a row, -[v, phi1 v, phi2 v, |v| x2, -|v|].

    A constant load torque d over the inertia makes x2 = d - w, which obeys x2' = -K(v) v + c |v| (d
    - x2). Source: dixit2008 section IV-E, with the sign of x2 = -w kept in psi.
    """
    speed = ca.fabs(v)
    return -ca.horzcat(v, *(each * v for each in phi(v)), speed * x2, -speed)


LOWEST = (1.0, -1e9, -1e9, 1.0, -1e9)  # projection: sigma0 [1/s2] and c [1/rad] stay positive


def gradient(ups: SX, theta: SX, error: SX, gain: SX, period: SX, *, low: bool) -> SX:
    """Return theta^ after the gradient step on the output error, normalised implicitly, projected
    where `low` is set.

    d theta = Ts S h e / (1 + Ts h' S h) with h the first row of Ups is the step that an implicit
    Euler of theta^' = S h (e - h' d theta) takes, so that no gain is too large. x^ has to follow by
    Ups d theta.
    """
    h = ups[0, :].T
    step = period * gain * h
    new = theta + step * (error / (1 + ca.dot(h, step)))
    return ca.fmax(new, ca.vertcat(*LOWEST)) if low else new


def estimate_states(prefix: str, entries: Mapping[str, str] = ENTRIES) -> tuple[State, ...]:
    """Declare the estimates with their starts; that of the load is 0."""
    return tuple(
        State(
            f"{prefix}_{n}",
            unit,
            f"estimate of {n}",
            initial=(lambda p, n=n: p[f"{n}_start"]) if n in ESTIMATES else 0.0,
        )
        for n, unit in entries.items()
    )


def states(order: int, entries: Mapping[str, str] = ENTRIES) -> tuple[State, ...]:
    """Declare x^, Ups, theta^ and its published average."""
    return (
        *vector_states("x", "1", "state estimate", order),
        *vector_states("upsilon", "1", "filtered regressor", len(entries) * order),
        *estimate_states("raw", entries),
        *estimate_states("mean", entries),
    )


def read(p: Namespace, order: int, entries: Mapping[str, str] = ENTRIES) -> tuple[SX, SX, SX, SX]:
    """Return (x^, Ups, theta^, averaged theta^)."""
    raw, mean = read_estimates(p, "raw", entries), read_estimates(p, "mean", entries)
    return stack(p, "x", order), stack(p, "upsilon", order, len(entries)), raw, mean


def read_estimates(p: Namespace, prefix: str, entries: Mapping[str, str] = ENTRIES) -> SX:
    """Return the estimates as a vector."""
    return SX(ca.vertcat(*(p[f"{prefix}_{name}"] for name in entries)))


def write_estimates(prefix: str, theta: SX) -> dict[str, SX]:
    """Return a vector of estimates as states."""
    return {
        f"{prefix}_{name}": value for name, value in zip(ENTRIES, ca.vertsplit(theta), strict=False)
    }


def write(x: SX, ups: SX, theta: SX, mean: SX, weight: SX) -> dict[str, SX]:
    """Return the next states; the published average moves by `weight` towards the estimate."""
    average = mean + weight * (theta - mean)
    return {
        **unstack("x", x),
        **unstack("upsilon", ups),
        **write_estimates("raw", theta),
        **write_estimates("mean", average),
    }


def estimates(p: Namespace, prefix: str) -> dict[str, SX]:
    """Return what is published of the estimates: parameters and load torque over inertia."""
    return {name: p[f"{prefix}_{name}"] for name in ESTIMATES} | {
        "load": p[f"{prefix}_c_load"] / ca.fmax(p[f"{prefix}_c"], 1)
    }


def known_parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare alpha2 and b, which a step-2 method takes as known."""
    return (
        Parameter(
            f"{prefix}.alpha2",
            "alpha2",
            "1/s",
            1.0,
            0.0,
            1e6,
            "viscous friction over inertia, known",
            "dixit2008 eq. (15)",
        ),
        Parameter(
            f"{prefix}.b",
            "b",
            "rad/(s2.V)",
            3.0,
            -1e6,
            1e6,
            "drive gain over inertia, known",
            "dixit2008 eq. (15)",
        ),
    )


def gain_parameters(
    prefix: str, k0: tuple[float, ...], lam: float, starts: tuple[float, ...]
) -> tuple[Parameter, ...]:
    """Declare K0, lam, the starts and the width of the basis functions."""
    return (
        *(
            Parameter(f"{prefix}.k{i}", f"K0[{i}]", "1", k, 0.0, 1e6, f"filter gain {i}", CITATION)
            for i, k in enumerate(k0, start=1)
        ),
        Parameter(f"{prefix}.lam", "lambda", "1/s", lam, 1e-3, 1e4, "filter bandwidth", CITATION),
        *start_parameters(prefix, starts),
    )


def start_parameters(
    prefix: str, starts: tuple[float, ...], source: str = CITATION
) -> tuple[Parameter, ...]:
    """Declare the starts of the estimates, and the width of the basis functions that they are the
    weights of.
    """
    return (
        *(
            Parameter(
                f"{prefix}.{name}_start",
                name,
                unit,
                start,
                -1e9,
                1e9,
                f"start of the estimate of {name}",
                source,
            )
            for (name, unit), start in zip(ESTIMATES.items(), starts, strict=True)
        ),
        width_parameter(prefix),
    )


def scale_parameters(prefix: str, source: str = "zhang2002") -> tuple[Parameter, ...]:
    """Declare the sizes expected of the parameters."""
    return tuple(
        Parameter(f"{prefix}.{n}_scale", n, unit, s, 0.0, 1e9, f"size expected of {n}", source)
        for (n, unit), s in zip(ENTRIES.items(), ENTRY_SCALES, strict=True)
    )


def scales(p: Namespace) -> SX:
    """Return the sizes expected of the parameters."""
    return SX(ca.vertcat(*(p[f"{name}_scale"] for name in ENTRIES)))


def matrix_parameters(
    prefix: str, gain: float = 1e6, averaging: float = 10.0
) -> tuple[Parameter, ...]:
    """Declare the matrix gain, S = gain diag(scale)^2, and the averaging."""
    average = "time constant of the published average"
    return (
        Parameter(
            f"{prefix}.gain", "g", "1", gain, 0.0, 1e15, "overall adaptation gain", "zhang2002"
        ),
        *scale_parameters(prefix),
        Parameter(f"{prefix}.averaging", "T_a", "s", averaging, 0.0, 1e6, average, "polyak1992"),
    )


def matrix_gain(p: Namespace) -> SX:
    """Return the diagonal of S."""
    return SX(p.gain * scales(p) ** 2)


def averaging_weight(p: Namespace, period: SX) -> SX:
    """Return the weight of a new value in the published average; no averaging if the time constant
    is 0.
    """
    return period / ca.fmax(p.averaging, period)
