"""Step 2 by dynamic regressor extension and mixing: one scalar equation for each parameter; alpha2
and b known.

With alpha2, b and v known, w = b u - alpha2 v - v' and |v| v' = (|v| v)'/2, so that w' = [v, phi1
v, phi2 v, -|v| w] theta is a linear regression in measured signals once both sides pass a low-pass
filter; no state needs an observer. Source: aranovskiy2017; dixit2008 eq. (15) and (16).
"""

from __future__ import annotations

import math
from itertools import combinations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import extension, step2, zhang
from bristle.observer.besancon import START_VALUES
from bristle.observer.method import (
    EquationContext,
    Method,
    Sample,
    Update,
    stack,
    unstack,
    vector_states,
)

SX = ca.SX
CITATION = "aranovskiy2017"
N = len(zhang.ENTRIES)
SETTLED_AFTER = 10.0  # time constants after which the start of two sections is below a thousandth


def means(s: Sample, alpha2: SX, b: SX, phi: zhang.Basis) -> SX:
    """Return the means over a sample of w, v, phi1 v, phi2 v, -|v| w and -|v|, for v linear over it
    and u held.

    With a constant load torque d over the inertia, w - d stands in the place of w; the last entry
    of theta is then c d. Those of v' and of |v| v' are differences, which are exact. Source:
    dixit2008 eq. (15) and (16).
    """
    springs = [
        (f0 * s.y0 + f1 * s.y1) / 2
        for f0, f1 in zip([SX(1), *phi(s.y0)], [SX(1), *phi(s.y1)], strict=True)
    ]
    area0, area1 = s.y0 * ca.fabs(s.y0), s.y1 * ca.fabs(s.y1)
    speed = (ca.fabs(s.y0) + ca.fabs(s.y1)) / 2
    w = b * s.u - alpha2 * springs[0] - (s.y1 - s.y0) / s.period
    worn = b * speed * s.u - alpha2 * (area0 + area1) / 2 - (area1 - area0) / (2 * s.period)
    return ca.vertcat(w, *springs, -worn, -speed)


def regression(p: Namespace, signals: SX, period: SX) -> tuple[SX, SX, dict[str, SX]]:
    """Return (z, h, next states) of z = h' theta at a sampling instant from the means over the
    samples around it.

    Two equal low-pass sections act on all signals; the difference of two means of w is the mean of
    two means of w'. Source: aranovskiy2017; dixit2008 eq. (16).
    """
    once, twice = stack(p, "step2_once", N + 1), stack(p, "step2_twice", N + 1)
    gain = 1 - ca.exp(-p.bandwidth * period)
    once_new = once + gain * (signals - once)
    new = twice + gain * (once_new - twice)
    filters = {**unstack("step2_once", once_new), **unstack("step2_twice", new)}
    return (new[0] - twice[0]) / period, (new[1:] + twice[1:]) / 2, filters


def mix(phi: SX, y: SX) -> tuple[SX, SX]:
    """Return (Delta, adj(Phi) Y), Delta = det Phi: one equation Delta theta_i = (adj(Phi) Y)_i for
    each parameter.

    Source: aranovskiy2017.
    """
    n = y.numel()
    everything = tuple(range(n))
    minors = [_minors(phi, [i for i in everything if i != row]) for row in everything]
    cofactor = [
        [(-1) ** (i + j) * minors[i][_without(everything, j)] for j in everything]
        for i in everything
    ]
    delta = sum(phi[0, j] * cofactor[0][j] for j in everything)
    return SX(delta), ca.vertcat(
        *(sum(cofactor[i][j] * y[i] for i in everything) for j in everything)
    )


def _minors(matrix: SX, rows: list[int]) -> dict[tuple[int, ...], SX]:
    """Return the determinants of the rows by the columns they keep, each expanded along a row in
    those of the rows below.
    """
    found: dict[tuple[int, ...], SX] = {(): SX(1)}
    for k, i in enumerate(reversed(rows), start=1):
        found = {
            columns: SX(
                sum(
                    (-1) ** j * matrix[i, c] * found[_without(columns, j)]
                    for j, c in enumerate(columns)
                )
            )
            for columns in combinations(range(matrix.shape[1]), k)
        }
    return found


def _without(columns: tuple[int, ...], place: int) -> tuple[int, ...]:
    return columns[:place] + columns[place + 1 :]


def adapt(p: Namespace, z: SX, h: SX, period: SX) -> dict[str, SX]:
    """Extend, mix and advance theta_i' = gamma Delta (mixed_i - Delta theta_i) / (Delta^2 + (kappa
    D)^2) over a sample.

    D is the product of the diagonal of Phi, lifted by the squares of the smallest regressors that
    count, for 1 s: those that move z by its noise with a parameter of the size expected. By
    Hadamard's inequality Delta <= D, and Delta / D tells how far the record separates the
    parameters: well below kappa little moves. sigma0 and c stay positive by projection. Source:
    aranovskiy2017, with the extension of kreisselmeier1977.
    """
    theta = zhang.read_estimates(p, "step2")
    phi, y = extension.extend(p, h, z, period)
    delta, mixed = mix(phi, y)
    least = (p.noise / zhang.scales(p)) ** 2
    largest = math.prod((phi[i, i] + least[i] for i in range(N)), start=SX(1))
    share = (1 - ca.exp(-p.gain * period)) * delta / (delta**2 + (p.kappa * largest) ** 2)
    new = ca.fmax(theta + share * (mixed - delta * theta), ca.vertcat(*zhang.LOWEST))
    return {**extension.write(phi, y), **zhang.write_estimates("step2", new)}


def step(p: Namespace, s: Sample, alpha2: SX, b: SX) -> dict[str, SX]:
    """Return the next states of DREM on velocity with the given alpha2 and b.

    Nothing counts until the filters have forgotten that they began from zero, where w may be
    anything.
    """
    z, h, filters = regression(p, means(s, alpha2, b, zhang.basis(p)), s.period)
    counts = p.step2_clear > SETTLED_AFTER / p.bandwidth
    new = {
        name: ca.if_else(counts, value, p[name]) for name, value in adapt(p, z, h, s.period).items()
    }
    return filters | new | {"step2_clear": p.step2_clear + s.period}


def published(p: Namespace, v: SX, alpha2: SX) -> tuple[dict[str, SX], dict[str, SX]]:
    """Return (estimates, signals); w is the filtered one."""
    w = p.step2_twice0
    return zhang.estimates(p, "step2"), {"v": v, "w": w, "F": w + alpha2 * v}


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    estimates, signals = published(p, p.last_y, p.alpha2)
    beside, fields = step2.alone(context, s, estimates, step2.from_velocity(s))
    return Update(step(p, s, p.alpha2, p.b) | beside, **fields, signals=signals)


def parameters(prefix: str, bandwidth: float) -> tuple[Parameter, ...]:
    """Declare filter, extension, gain and starts under a method's name."""
    return (
        Parameter(
            f"{prefix}.bandwidth",
            "a",
            "1/s",
            bandwidth,
            1e-3,
            1e5,
            "corner of each of the two low-pass sections",
            CITATION,
        ),
        extension.parameter(prefix, 0.02),
        Parameter(f"{prefix}.gain", "gamma", "1/s", 2.0, 0.0, 1e6, "adaptation rate", CITATION),
        Parameter(
            f"{prefix}.kappa",
            "kappa",
            "1",
            1e-6,
            1e-12,
            1.0,
            "Delta / D below which little moves",
            CITATION,
        ),
        Parameter(
            f"{prefix}.noise",
            "r",
            "rad/s3",
            1.0,
            1e-3,
            1e6,
            "noise of z, the filtered w'",
            CITATION,
        ),
        *zhang.scale_parameters(prefix, CITATION),
        *zhang.start_parameters(prefix, START_VALUES, CITATION),
    )


FILTER_STATES = (
    *vector_states("step2_once", "1", "signals of step 2 after one section", N + 1),
    *vector_states("step2_twice", "1", "signals of step 2 after two sections", N + 1),
    State("step2_clear", "s", "time since the filters of step 2 began"),
)
STATES = (
    *FILTER_STATES,
    *extension.states(N),
    *zhang.estimate_states("step2"),
)

METHOD = Method(
    "drem",
    "dynamic regressor extension and mixing for step 2; alpha2 and b known",
    CITATION,
    "y_v",
    (*zhang.known_parameters("drem"), *parameters("drem", 20.0)),
    (*STATES, *step2.COMPANION_STATES),
    _equations,
)
