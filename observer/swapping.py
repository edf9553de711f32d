"""Approach I without differentiators: the equation of v'' filtered, linear in eight entries; shared
by both sensors.

v'' = -alpha2 v' + b u' - K(v) v + c |v| (b u - alpha2 v - v') follows from (15) and (17), and |v|
v' = (v |v| / 2)'. Every term is a derivative of something known, so that after a filter L nothing
is left to differentiate:
    s^2 L v = [-s L v, s L u, -L v, -L phi1 v, -L phi2 v, L |v| u, -L v |v|, -s L v |v| / 2] theta,
    theta = [alpha2, b, sigma0, sigma1, sigma2, c b, c alpha2, c].
A constant load torque d over the inertia adds L |v| with the entry c d; an input that acts late by
delta samples, of which each changes it by u_d, adds s L u_d and L |v| u_d with the entries e = -b
delta and c e. Of these eleven entries eight are free. Source: dixit2008 eq. (20)-(22); filtering as
in kreisselmeier1977.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from bristle.model.basis import gaussian, width_parameter
from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter
from bristle.observer import consistency, information, step1, zhang
from bristle.observer.companion import Companion, Rest, Row, View
from bristle.observer.method import EquationContext, Sample, stack, unstack, vector_states

SX = ca.SX
CITATION = "dixit2008 eq. (20)-(22)"
ESTIMATES = units("alpha2", "b", "sigma0", "sigma1", "sigma2", "c")
SIGNAL_COUNT = 9  # v, u, phi1 v, phi2 v, |v| u, v |v|, |v|, u_d, |v| u_d
ENTRY_COUNT = 11
FREE = (*ESTIMATES, "c_load", "late_drive")
DERIVED = ("Fc", "load", "lateness")
# filter time constants after which the state before the first sample has decayed
SETTLED_AFTER = 10.0
LEAST = {"sigma0": 1.0, "c": 1.0}  # bounds of what is published, as in zhang.py
LARGEST_ENTRY = 1e9  # the same, for both signs
BOUND_SHARE = 0.5  # standard deviation over a bound
# standard deviation of sigma_i and c over themselves where friction relaxes within the smoothing
SMOOTHED_SHARE = 0.005
# 1/s, standard deviation of any estimate over itself, by the time over which v is smoothed or held
HELD_RATE = 1.0
JUDGED_BLOCKS = 3.0  # blocks of consistency.py after which it says something
LEAST_WEIGHT = 0.25  # of sigma0: size against which sigma1 and sigma2 are small
SPEED_ENTRY, LOAD_ENTRY = 2, 8  # the columns of L v and of L |v|
LEAST_DELAY_SD = 0.05  # samples, of a delay that is found
SMALLEST_SD = 1e-9  # of what is known beforehand, in its unit
EXACT = 1e9  # how many times what the samples say counts what is known exactly
LEAST_DRIVE = 1e-9  # rad/(s2.V), keeps the division by b defined


@dataclass(frozen=True)
class Prior:
    """What is known beforehand of alpha2 and b, with standard deviations; None: exactly."""

    alpha2: SX
    b: SX
    sd: tuple[SX, SX] | None = None


def signals(u: SX, change: SX, v: SX, width: SX) -> SX:
    """Return the signals to be filtered, as a row; `change` is that of u since a sample before."""
    phi, speed = gaussian(v / width), ca.fabs(v)
    return ca.horzcat(
        v, u, *(shape * v for shape in phi), speed * u, speed * v, speed, change, speed * change
    )


def advance(
    context: EquationContext, corner: SX, period: SX, start: SX, end: SX
) -> tuple[dict[str, SX], SX]:
    """Advance L = 1/(s + a)^2 on all signals over a sample, and return (its next states,
    [regressor, s^2 L v]).

    Every signal goes linearly from `start` to `end`, v like what is made of it: errors of second
    order, which largely cancel as long as all are held alike. A held u, which starts and ends a
    sample with the same value, is exact.
    """
    f = zhang.make_filter(context, SX([2.0, 1.0]), corner, period, "swap_")
    x = f.phi @ stack(context.p, "swap", 2, SIGNAL_COUNT) + f.m0[:, 1] @ start + f.m1[:, 1] @ end
    # x' = [x2 - k1 x1, f - k2 x1], so that s L is this
    once, k1, k2 = x[1, :] - f.k[0] * x[0, :], f.k[0], f.k[1]
    v, _, phi1, phi2, vu, vv, speed, _, vd = ca.horzsplit(x[0, :])
    twice = end[0] - k2 * v - k1 * once[0]
    regressor = (-once[0], once[1], -v, -phi1, -phi2, vu, -vv, -once[5] / 2, speed, once[7], vd)
    return unstack("swap", x), ca.horzcat(*regressor, twice)


def view(at: SX, prior: Prior | None, weight: SX) -> View:
    """Return how the equation looks near the free parameters `at`: linear in the eight of them.

    To first order g(theta) = g(at) + g'(at) (theta - at), g = [.., c b, c alpha2, c, c d, e, c e].
    What is known beforehand counts as further equations, in which `weight` is the variance of one
    of ours. Source: ljung1999 section 10.2 (Gauss-Newton) and 11.2 (a prior as information).
    """
    alpha2, b, _, _, _, c, _, late = ca.vertsplit(at)
    n = len(FREE)
    slope, rest = SX(ENTRY_COUNT, n), SX(ENTRY_COUNT, 1)  # g(theta) = slope theta + rest
    for i in range(5):
        slope[i, i] = 1
    slope[5, 1], slope[5, 5], rest[5] = c, b, -c * b
    slope[6, 0], slope[6, 5], rest[6] = c, alpha2, -c * alpha2
    slope[7, 5] = slope[8, 6] = slope[9, 7] = 1
    slope[10, 7], slope[10, 5], rest[10] = c, late, -c * late
    origin, certainty, exact = SX(n, 1), SX(n, 1), SX(n, 1)
    if prior:
        origin[0], origin[1] = prior.alpha2, prior.b
        if prior.sd is None:
            exact[0] = exact[1] = EXACT
        else:
            certainty[0], certainty[1] = (weight / ca.fmax(sd, SMALLEST_SD) ** 2 for sd in prior.sd)
    return View(slope, rest, origin, certainty, exact, derived)


def derived(fit: SX) -> tuple[SX, SX]:
    """Return (Coulomb friction, load torque and lateness that follow from the free parameters,
    their slopes, one a row).

    Source: dixit2008 eq. (18), at high speed.
    """
    symbol = SX.sym("free", len(FREE))
    c = ca.fmax(symbol[5], LEAST["c"])
    drive = symbol[1] / (symbol[1] ** 2 + LEAST_DRIVE**2)
    values = ca.vertcat(symbol[2] / c, symbol[6] / c, -symbol[7] * drive)
    values, slopes = ca.substitute([values, ca.jacobian(values, symbol)], [symbol], [fit])
    return values, slopes


@dataclass(frozen=True)
class Settings:
    """Corner of L, time of memory, variance of s^2 L v by the sensor alone, and the time over which
    v is smoothed or held.
    """

    corner: SX
    memory: SX
    noise: SX
    lag: SX


def companion(prefix: str = "") -> Companion:
    """Return the companion of this regression, or the regression itself."""
    return Companion(FREE, prefix=prefix, entries=ENTRY_COUNT, derived=DERIVED)


def observe(
    context: EquationContext,
    s: Sample,
    ends: tuple[SX, SX],
    given: Settings,
    fitted: Companion,
    prior: Prior | None = None,
) -> dict[str, SX]:
    """Return the next states of filters and companion for signals that go from the first to the
    second of `ends`.

    Errors of the rows of a filter with corner a are alike over 2/a, so that not every sample is a
    new observation.
    """
    p = context.p
    filters, line = advance(context, given.corner, s.period, *ends)
    counts = p.samples * s.period * given.corner > SETTLED_AFTER
    # of v, filtered, against that of v itself
    moves = given.corner**2 * ca.fabs(line[SPEED_ENTRY]) > ca.sqrt(given.noise)
    rest = Rest(moves, LOAD_ENTRY, "sigma0")  # c d against sigma0 = c Fc
    row = Row(
        line[-1], line[:-1].T, SX(0, 1), counts, given.noise, 2 / (given.corner * s.period), rest
    )
    weight = p[f"{fitted.prefix}residual"]

    def look(seen: SX) -> View:
        return view(free_of(information.Factors(seen).regression()), prior, weight)

    return filters | fitted.advance(p, row, ca.exp(-s.period / given.memory), s.period, look)


def free_of(entries: SX) -> SX:
    """Return the free parameters among the entries, by those entries that are one of them alone."""
    return ca.vertcat(entries[:5], entries[7:10])


@dataclass(frozen=True)
class Worth:
    """Standard deviations, limits of valid ones, and whether the model can be true."""

    sd: dict[str, SX]
    limits: dict[str, SX]
    possible: SX


def size_of(found: Mapping[str, SX], name: str) -> SX:
    """Return against what an estimate is small: itself, or what it belongs to if it may be 0."""
    if name == "load":
        return ca.fabs(found["Fc"])
    if name in ("sigma1", "sigma2"):
        return ca.fmax(ca.fabs(found[name]), LEAST_WEIGHT * ca.fabs(found["sigma0"]))
    return ca.fabs(found[name])


def worth(p: Namespace, fitted: Companion, own: Mapping[str, SX], given: Settings) -> Worth:
    """Return what estimates are worth: the least squares, where `own` has none.

    To how much they move, and to their distance from the least squares, comes what noise in v may
    do: it makes sigma_i and c too small, all by the same share; and what is lost where v is
    smoothed or held, which grows with the square of that time over the one in which friction
    relaxes. A friction, stiffness or distance that is negative for sure refutes the model; where c
    may be anything, nothing else is sure either. Source: frisch1934.
    """
    fit = fitted.fit(p)
    found, sd = fit | dict(own), fitted.deviations(p, fit | dict(own))
    sizes = {name: size_of(fit, name) for name in (*ESTIMATES, "Fc", "load")}
    bound = {name: fitted.dilution(p, name, size) for name, size in sizes.items()}
    common = ca.fmax(bound["sigma0"], bound["c"])
    speed = given.corner**2 * ca.sqrt(fitted.mean_square(p, SPEED_ENTRY))
    lost = SMOOTHED_SHARE * (given.lag * ca.fabs(fit["c"]) * speed) ** 2
    for name, size in sizes.items():
        shares = (common, lost) if name in zhang.ESTIMATES else (bound[name], SX(0))
        spread = (BOUND_SHARE * shares[0]) ** 2 + shares[1] ** 2 + (HELD_RATE * given.lag) ** 2
        sd[name] = ca.sqrt(sd[name] ** 2 + size**2 * spread)
    sd["delay"] = step1.delay_deviation(
        ca.sqrt(sd["lateness"] ** 2 + LEAST_DELAY_SD**2), found["b"], sd["b"]
    )
    possible = ca.logic_and(
        bound["c"] < 1, p[f"{fitted.prefix}counted"] > JUDGED_BLOCKS * consistency.BLOCK_TIME
    )
    for name in ("alpha2", "Fc", "sigma0", "c"):
        possible = ca.logic_and(possible, found[name] > -step1.IMPOSSIBLE_BY * sd[name])
    limits = {name: step1.VALID_SHARE * size for name, size in sizes.items()}
    limits["delay"] = step1.delay_limit(found["lateness"] + p.delay, sd["delay"])
    return Worth(sd, limits, possible)


def published(
    p: Namespace, fitted: Companion, given: Settings, names: Iterable[str] = ESTIMATES
) -> dict[str, Any]:
    """Return the fields of an `Update`: the least squares are the estimates."""
    found, judged = fitted.fit(p), worth(p, fitted, {}, given)
    shown = (*names, "Fc", "load")
    estimates = {
        name: ca.fmin(ca.fmax(found[name], LEAST.get(name, -LARGEST_ENTRY)), LARGEST_ENTRY)
        for name in shown
    }
    estimates["delay"] = (
        ca.fmin(ca.fmax(found["lateness"], -LARGEST_ENTRY), LARGEST_ENTRY) + p.delay
    )
    return {"estimates": estimates, **judge(p, fitted, judged, estimates)}


def judge(p: Namespace, fitted: Companion, judged: Worth, names: Iterable[str]) -> dict[str, Any]:
    """Return the fields of an `Update` that say what the estimates of these names are worth."""
    sd, limits = ({name: each[name] for name in names} for each in (judged.sd, judged.limits))
    return fitted.judge(p, sd, limits, judged.possible)


def parameters(prefix: str, cutoff: float) -> tuple[Parameter, ...]:
    """Declare filter, memory and width of the basis functions under a method's name."""
    return (
        Parameter(
            f"{prefix}.cutoff",
            "a",
            "rad/s",
            cutoff,
            0.1,
            1e3,
            "corner of the filter L, a double pole",
            CITATION,
        ),
        Parameter(
            f"{prefix}.memory",
            "T",
            "s",
            100.0,
            0.1,
            1e6,
            "time over which data is forgotten",
            "ljung1999 section 11.2",
        ),
        width_parameter(prefix),
    )


FILTER_STATES = vector_states("swap", "1", "filtered signal", 2 * SIGNAL_COUNT)
OWN = companion()
