"""Approach I without differentiators: the equation of v'' filtered, linear in eight entries; shared by both sensors.

v'' = -alpha2 v' + b u' - K(v) v + c |v| (b u - alpha2 v - v') follows from (15) and (17), and |v| v' = (v |v| / 2)'. Every
term is a derivative of something known, so that after a filter L nothing is left to differentiate:
    s^2 L v = [-s L v, s L u, -L v, -L phi1 v, -L phi2 v, L |v| u, -L v |v|, -s L v |v| / 2] theta,
    theta = [alpha2, b, sigma0, sigma1, sigma2, c b, c alpha2, c].
Where alpha2 and b are known the first two terms go to the left and the last three become one: four entries, all of them free.
Source: dixit2008 eq. (20)-(22); filtering as in kreisselmeier1977.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca

from bristle.model.basis import gaussian, width_parameter
from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import information, zhang
from bristle.observer.method import EquationContext, Sample, stack, unstack, vector_states

SX = ca.SX
CITATION = "dixit2008 eq. (20)-(22)"
ESTIMATES = units("alpha2", "b", "sigma0", "sigma1", "sigma2", "c")
SIGNAL_COUNT = 6  # v, u, phi1 v, phi2 v, |v| u, v |v|
ENTRY_COUNT = 8
ROW = ENTRY_COUNT + 1  # the regressor, followed by the signal that it explains
KNOWN_ROW = len(zhang.ESTIMATES) + 1  # the same where alpha2 and b are known
SETTLED_AFTER = 10.0  # filter time constants after which the state before the first sample has decayed
LOWEST = (0.0, -1e6, 1.0, -1e9, -1e9, 1.0)  # projection, as in zhang.py; alpha2 is not negative either


def signals(u: SX, v: SX, width: SX) -> SX:
    """Return the signals to be filtered, as a row."""
    phi = gaussian(v / width)
    return ca.horzcat(v, u, *(shape * v for shape in phi), ca.fabs(v) * u, ca.fabs(v) * v)


def advance(context: EquationContext, s: Sample, start: SX, end: SX) -> tuple[SX, SX]:
    """Advance L = 1/(s + a)^2 on all signals over a sample, and return (its states, [regressor, s^2 L v]).

    Every signal goes linearly from `start` to `end`, v like what is made of it: errors of second order, which largely cancel as
    long as all are held alike. A held u, which starts and ends a sample with the same value, is exact.
    """
    p = context.p
    f = zhang.make_filter(context, SX([2.0, 1.0]), p.cutoff, s.period)
    x = f.phi @ stack(p, "filtered", 2, SIGNAL_COUNT) + f.m0[:, 1] @ start + f.m1[:, 1] @ end
    once, k1, k2 = x[1, :] - f.k[0] * x[0, :], f.k[0], f.k[1]  # x' = [x2 - k1 x1, f - k2 x1], so that s L is this
    v, _, phi1, phi2, vu, vv = ca.horzsplit(x[0, :])
    twice = end[0] - k2 * v - k1 * once[0]
    return x, ca.horzcat(-once[0], once[1], -v, -phi1, -phi2, vu, -vv, -once[5] / 2, twice)


def estimate(r: SX) -> tuple[SX, SX, SX, SX]:
    """Return (six estimates, diagonal of their inverse information, sum of squares left unexplained, least share of an entry).

    The eight entries follow linearly, from no start. c is the last of them; c b and c alpha2 are then not thrown away: one
    Gauss-Newton step from the six takes the entries g = [.., c b, c alpha2, c] to the smallest sum of squares, in which each
    of the eight counts by its information.
    Source: dixit2008 eq. (22); ljung1999 section 10.2 (Gauss-Newton).
    """
    eight = information.Factors(r)
    theta = eight.regression()
    alpha2, b, c = theta[0], theta[1], theta[7]
    slope = SX(ENTRY_COUNT, len(ESTIMATES))  # of g by the six
    for i in range(5):
        slope[i, i] = 1
    slope[5, 1] = slope[6, 0] = c
    slope[5, 5], slope[6, 5], slope[7, 5] = b, alpha2, 1
    weighted = r[:ENTRY_COUNT, :ENTRY_COUNT] @ slope
    six = information.Factors(slope.T @ weighted)
    inconsistent = weighted[5, :].T * (theta[5] - c * b) + weighted[6, :].T * (theta[6] - c * alpha2)
    least = ca.mmin(ca.vertcat(*eight.shares[:ENTRY_COUNT]))
    return ca.vertcat(theta[:5], c) + six.solve(inconsistent), six.inverse_diagonal(), eight.d[-1], least


@dataclass(frozen=True)
class Known:
    """alpha2 and b, where they are known."""

    alpha2: SX
    b: SX


def reduced(row: SX, known: Known) -> SX:
    """Return [regressor, signal that it explains] for theta = [sigma0, sigma1, sigma2, c] from the row of all eight entries.

    Source: dixit2008 section III, Approach II (Approach I with alpha2 and b as known parameters).
    """
    c = known.b * row[5] + known.alpha2 * row[6] + row[7]
    return ca.horzcat(row[2:5], c, row[8] - known.alpha2 * row[0] - known.b * row[1])


def estimate_known(r: SX) -> tuple[SX, SX, SX, SX]:
    """Return what `estimate` does, for the four that are left where alpha2 and b are known.

    Source: dixit2008 section III, Approach II; ljung1999 section 11.2.
    """
    n, factors = len(zhang.ESTIMATES), information.Factors(r)
    diagonal = information.Factors(r[:n, :n]).inverse_diagonal()
    return factors.regression(), diagonal, factors.d[-1], ca.mmin(ca.vertcat(*factors.shares[:n]))


def step(context: EquationContext, s: Sample, start: SX, end: SX, known: Known | None = None) -> dict[str, SX]:
    """Return the next states for signals that go from `start` to `end`.

    Errors of the rows of a filter with corner a are alike over 2/a, so that not every sample is a new observation: the
    variance of an estimate is that of as many fewer. Where no noise tells that the entries are not excited, their shares do.
    """
    p = context.p
    x, row = advance(context, s, start, end)
    row = reduced(row, known) if known else row
    found, lowest = (zhang.ESTIMATES, zhang.LOWEST[:-1]) if known else (ESTIMATES, LOWEST)
    counts = p.samples * s.period * p.cutoff > SETTLED_AFTER
    memory = ca.exp(-s.period / p.memory)
    before = information.read(p, row.numel())
    r = ca.if_else(counts, memory * before + row.T @ row, before)
    rows = ca.if_else(counts, memory * p.rows + 1, p.rows)
    theta, inverse, left, least = estimate_known(r) if known else estimate(r)
    free = rows * p.cutoff * s.period / 2 - (row.numel() - 1)  # observations beyond the unknowns
    variance = left * inverse / ca.fmax(free, 1e-9)
    kept = ca.fmin(ca.fmax(theta, ca.vertcat(*lowest)), 1e9)
    excited = ca.logic_and(free > 0, least > p.excitation)
    sharp = ca.logic_and(excited, variance < (p.precision * kept) ** 2)
    return {
        **unstack("filtered", x),
        **information.write(r),
        "rows": rows,
        **{f"theta_{name}": kept[i] for i, name in enumerate(found)},
        **{f"sharp_{name}": sharp[i] for i, name in enumerate(found)},
    }


def estimates(p: Namespace, names: Iterable[str] = ESTIMATES) -> dict[str, SX]:
    """Return the estimates by name; Fc follows from sigma0 and c at high speed, as in (18)."""
    return {name: p[f"theta_{name}"] for name in names} | {"Fc": p.theta_sigma0 / ca.fmax(p.theta_c, 1.0)}


def valid(p: Namespace, names: Iterable[str] = ESTIMATES) -> dict[str, SX]:
    """Return which estimates are precise enough to be valid."""
    return {name: p[f"sharp_{name}"] for name in names} | {"Fc": p.sharp_sigma0 * p.sharp_c}


def parameters(prefix: str, cutoff: float) -> tuple[Parameter, ...]:
    """Declare filter, memory and the precision asked for under a method's name."""
    return (
        Parameter(f"{prefix}.cutoff", "a", "rad/s", cutoff, 0.1, 1e3, "corner of the filter L, a double pole", CITATION),
        Parameter(f"{prefix}.memory", "T", "s", 100.0, 0.1, 1e6, "time over which data is forgotten", "ljung1999 section 11.2"),
        Parameter(
            f"{prefix}.excitation",
            "e",
            "1",
            1e-9,
            0.0,
            1.0,
            "share of each entry that the others must leave unexplained",
            "ljung1999 section 13.2",
        ),
        Parameter(
            f"{prefix}.precision",
            "r",
            "1",
            0.1,
            0.0,
            1e3,
            "standard error over estimate up to which an estimate is valid",
            "ljung1999 section 9.6",
        ),
        width_parameter(prefix),
    )


def states(estimated: Mapping[str, str] = ESTIMATES, row: int = ROW) -> tuple[State, ...]:
    """Declare the filters, the information of rows of this length, and the estimates with their units."""
    return (
        *vector_states("filtered", "1", "filtered signal", 2 * SIGNAL_COUNT),
        *information.states(row),
        State("rows", "1", "rows in the information matrix"),
        *(State(f"theta_{name}", unit, f"estimate of {name}") for name, unit in estimated.items()),
        *(State(f"sharp_{name}", "1", f"1 where {name} is known well enough") for name in estimated),
    )
