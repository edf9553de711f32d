"""Elements side by side, as Maxwell-slip friction has them, by least squares: linear once their
distances are chosen.

w = sum w_i, w_i' = [sigma_i0 + sum_j sigma_ij phi_j(v)] v - c_i |v| w_i, with the c_i of a grid.
Then w_i = sum_j sigma_ij chi_ij with chi_ij' = phi_j(v) v - c_i |v| chi_ij, which needs nothing but
the velocity; and v' = b u - alpha2 v - w is a regression.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from bristle.model.basis import BASIS_COUNT, gaussian, width_parameter
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import filtered, step1, swapping
from bristle.observer.companion import Companion, Rest, Row, View
from bristle.observer.method import (
    EquationContext,
    Method,
    Sample,
    Update,
    stack,
    unstack,
    vector_states,
)
from bristle.observer.swapping import LEAST_DRIVE, SETTLED_AFTER

SX = ca.SX
CITATION = "dixit2008 eq. (15) and (17), elements side by side as in iwan1966"
FIT_CITATION = "ljung1999 section 11.2"
GRID = (30.0, 100.0, 300.0)  # 1/rad
WEIGHTS = BASIS_COUNT + 1
ELEMENT_COUNT = len(GRID)
# width of what friction may still fall beside the basis functions, over that of the first
WIDER = 8.0
# the last is that of the middle element with the wider basis function
CHI = ELEMENT_COUNT * WEIGHTS + 1
STIFFNESSES = tuple(f"sigma0_{i}" for i in range(1, len(GRID) + 1))
SIGMAS = tuple(f"sigma{j}_{i}" for i in range(1, len(GRID) + 1) for j in range(WEIGHTS))
# the last is -b times the delay in samples
ENTRIES = ("alpha2", "b", *SIGMAS, "load", "late_drive")
COMPANION = Companion(ENTRIES, extra=1, derived=("Fc", "lateness"))
BESIDE = 4  # signals that are filtered beside chi: v', -v, u, change of u


def _distances(p: Namespace) -> SX:
    return SX(ca.vertcat(*(p[f"c{i}"] for i in range(1, len(GRID) + 1))))


def _relaxed(p: Namespace, s: Sample) -> SX:
    """Advance chi over a sample, exactly at its mean velocity; row by row, one after the other.

    Source: dixit2008 eq. (17); hochbruck2010 section 2 (exponential step).
    """
    v = (s.y0 + s.y1) / 2
    basis = ca.vertcat(1, *gaussian(v / p.width))
    c = _distances(p)
    driven = ca.vertcat(*([basis] * ELEMENT_COUNT), gaussian(v / p.width / WIDER)[0])
    travel = ca.vertcat(
        *(ca.repmat(each, WEIGHTS, 1) for each in ca.vertsplit(c)), c[ELEMENT_COUNT // 2]
    )
    travel = ca.fmax(travel * ca.fabs(v) * s.period, 1e-9)
    kept = ca.exp(-travel)
    return SX(stack(p, "chi", CHI) * kept + driven * v * s.period * (1 - kept) / travel)


def _view(c: SX) -> View:
    """Return the regression as it is, with Coulomb friction sum sigma_i0 / c_i and the delay beside
    its entries.
    """
    n = COMPANION.columns
    slope = SX.zeros(1, n)
    for i, name in enumerate(STIFFNESSES):
        slope[ENTRIES.index(name)] = 1 / c[i]

    def derived(fit: SX) -> tuple[SX, SX]:
        drive = fit[1] / (fit[1] ** 2 + LEAST_DRIVE**2)
        late = SX.zeros(1, n)
        late[len(ENTRIES) - 1] = -drive
        both = ca.vertcat(slope, late)
        return both[:, : len(ENTRIES)] @ fit, both

    nothing = SX(n, 1)
    return View(SX.eye(n), nothing, nothing, nothing, nothing, derived)


def _equations(context: EquationContext, s: Sample) -> Update:
    """Filter v' = -alpha2 v + b u - sum sigma_ij chi_ij + d on both sides, and fit.

    Source: ljung1999 section 11.2.
    """
    p, c = context.p, _distances(context.p)
    chi, new = stack(p, "chi", CHI), _relaxed(p, s)
    size = BESIDE + CHI
    raw = ca.vertcat(
        (s.y1 - s.y0) / s.period, -(s.y0 + s.y1) / 2, s.u, s.u - p.u_before, -(chi + new) / 2
    )
    gain = 1 - ca.exp(-p.cutoff * s.period)
    once, twice = stack(p, "once", size), stack(p, "twice", size)
    once_new = once + gain * (raw - once)
    row_new = twice + gain * (once_new - twice)
    h = ca.vertcat(row_new[1:3], row_new[BESIDE:-1], 1, row_new[3])
    noise = 2 * (p.noise * gain / s.period) ** 2
    rest = Rest(ca.fabs(row_new[1]) > filtered.NOISES * p.noise, ENTRIES.index("load"))
    settled = p.samples * s.period * p.cutoff > SETTLED_AFTER
    row = Row(row_new[0], h, row_new[-1], settled, noise, 2 / (p.cutoff * s.period), rest)
    view = _view(c)
    fitted = COMPANION.advance(p, row, ca.exp(-s.period / p.memory), s.period, lambda _: view)
    found = COMPANION.narrow(p)
    w = ca.dot(ca.vertcat(*(found[name] for name in SIGMAS)), chi[:-1])
    return Update(
        next={
            **unstack("chi", new),
            **unstack("once", once_new),
            **unstack("twice", row_new),
            "u_before": s.u,
            **fitted,
        },
        **_published(p, found, s.period),
        signals={"v": p.last_y, "w": w, "F": w + found["alpha2"] * p.last_y},
    )


def _published(p: Namespace, found: dict[str, SX], period: SX) -> dict[str, Any]:
    """Return the fields of an `Update`: the stiffness of each element counts as known against that
    of all of them.

    To how much the estimates move comes what noise in their regressors may do. A friction that is
    negative for sure refutes the model. Source: frisch1934.
    """
    sd = COMPANION.deviations(p, found)
    stiffness = ca.fabs(sum(found[name] for name in STIFFNESSES))
    sizes = {name: stiffness for name in STIFFNESSES}
    sizes |= {name: ca.fabs(found[name]) for name in ("alpha2", "b", "Fc")} | {
        "load": ca.fabs(found["Fc"])
    }
    for name, size in sizes.items():
        share = swapping.BOUND_SHARE * COMPANION.dilution(p, name, size)
        sd[name] = ca.sqrt(
            sd[name] ** 2 + size**2 * (share**2 + (swapping.HELD_RATE * period) ** 2)
        )
    delay = found["lateness"] + p.delay
    sd["delay"] = step1.delay_deviation(
        ca.sqrt(sd["lateness"] ** 2 + swapping.LEAST_DELAY_SD**2), found["b"], sd["b"]
    )
    possible = ca.logic_and(
        *(found[name] > -step1.IMPOSSIBLE_BY * sd[name] for name in ("alpha2", "Fc"))
    )
    limits = {name: step1.VALID_SHARE * size for name, size in sizes.items()} | {
        "delay": step1.delay_limit(delay, sd["delay"])
    }
    estimates = {name: found[name] for name in sizes} | {"delay": delay}
    return {"estimates": estimates, **COMPANION.judge(p, sd, limits, possible)}


METHOD = Method(
    "parallel_elements",
    f"least squares of alpha2, b and {len(GRID)} friction elements side by side, whose distances"
    " are chosen",
    CITATION,
    "y_v",
    (
        *(
            Parameter(
                f"parallel_elements.c{i}",
                f"c{i}",
                "1/rad",
                c,
                1e-6,
                1e9,
                f"inverse distance of element {i}",
                CITATION,
            )
            for i, c in enumerate(GRID, start=1)
        ),
        Parameter(
            "parallel_elements.cutoff",
            "a",
            "rad/s",
            150.0,
            1e-3,
            1e5,
            "corner of each of two low-pass sections",
            FIT_CITATION,
        ),
        Parameter(
            "parallel_elements.memory",
            "T",
            "s",
            100.0,
            0.1,
            1e6,
            "time over which data is forgotten",
            FIT_CITATION,
        ),
        filtered.noise_parameter("parallel_elements"),
        width_parameter("parallel_elements"),
    ),
    (
        *vector_states("chi", "1", "filtered basis functions", CHI),
        *vector_states("once", "1", "signals after one section", BESIDE + CHI),
        *vector_states("twice", "1", "signals after two sections", BESIDE + CHI),
        State("u_before", "V", "input before the last one"),
        *COMPANION.states,
    ),
    _equations,
)
