"""Approach II as a whole: Bastin-Gevers, then Besancon with a matrix gain on its alpha2 and b; both
are published.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from bristle.observer import bastin_gevers, besancon, filtered, step1, step2, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX


def waiting(
    context: EquationContext, y: SX, order: int = 2, entries: Mapping[str, str] = zhang.ENTRIES
) -> dict[str, SX]:
    """Return the states of step 2 before it starts, the first one following the measurement."""
    x, ups, theta, mean = zhang.read(context.p, order, entries)
    return zhang.write(ca.vertcat(y, x[1:]), ups, theta, mean, SX(0))


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    alpha2, b = p.step1_alpha2, p.step1_b
    step1_fields = step1.published(
        p, {name: p[f"step1_{name}"] for name in bastin_gevers.ESTIMATES}, s.period
    )
    go = step2.begun(p, s, step1_fields)
    own = besancon.step(context, s, besancon.filter_of(context, s), alpha2, b)
    estimates, signals = besancon.published(p, alpha2)
    shared = filtered.observe(p, s, step1.kept(s))[1]
    given = step2.from_velocity(s, p.noise)
    beside = step2.observe(context, s, step2.known(step1_fields), given)
    return Update(
        next=shared
        | beside
        | bastin_gevers.adapt(p, s, filtered.gate(p))
        | step2.when(go, own, waiting(context, s.y1)),
        **step2.published(p, step1_fields, estimates, given),
        signals=signals,
        first={"step1_v": s.y1, "x0": s.y1},
    )


METHOD = Method(
    "two_step",
    "Approach II: Bastin-Gevers, then Besancon-Zhang-Hammouri with a matrix gain on its alpha2"
    " and b",
    "dixit2008 section III, Approach II",
    "y_v",
    (
        step2.start_parameter("two_step"),
        *bastin_gevers.parameters("two_step", bastin_gevers.REPAIRED),
        *filtered.filter_parameters("two_step", 20.0),
        *zhang.gain_parameters("two_step", besancon.K0, besancon.LAM, besancon.START_VALUES),
        *zhang.matrix_parameters("two_step"),
    ),
    (*bastin_gevers.states(), *filtered.STATES, *zhang.states(2), *step2.STATES),
    _equations,
)
