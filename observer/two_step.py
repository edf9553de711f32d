"""Approach II as a whole: Bastin-Gevers, then Besancon with a matrix gain on its alpha2 and b; both are published."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from bristle.model.variables import Parameter
from bristle.observer import bastin_gevers, besancon, filtered, step1, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX


def start_parameter(prefix: str, start: float = 100.0) -> Parameter:
    """Declare when step 2 begins, in s."""
    return Parameter(f"{prefix}.step2_start", "T2", "s", start, 0.0, 1e6, "when step 2 begins", "dixit2008 section IV-E")


def begun(context: EquationContext, s: Sample) -> SX:
    """Return 1 from the start of step 2 on."""
    return SX(context.p.samples * s.period >= context.p.step2_start)


def when(go: SX, update: dict[str, SX], rest: dict[str, SX]) -> dict[str, SX]:
    """Return the update while step 2 runs and `rest` before."""
    return {name: ca.if_else(go, value, rest[name]) for name, value in update.items()}


def waiting(context: EquationContext, y: SX, order: int = 2, entries: Mapping[str, str] = zhang.ENTRIES) -> dict[str, SX]:
    """Return the states of step 2 before it starts, with the first one following the measurement."""
    x, ups, theta, mean = zhang.read(context.p, order, entries)
    return zhang.write(ca.vertcat(y, x[1:]), ups, theta, mean, SX(0))


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    go = begun(context, s)
    alpha2, b = p.step1_alpha2, p.step1_b
    step2 = besancon.step(context, s, besancon.filter_of(context, s), alpha2, b)
    estimates, signals = besancon.published(p, alpha2)
    shared = filtered.observe(p, s, step1.kept(s))[1]
    return Update(
        next=shared | bastin_gevers.adapt(p, s, filtered.gate(p)) | when(go, step2, waiting(context, s.y1)),
        estimates={name: p[f"step1_{name}"] for name in bastin_gevers.ESTIMATES} | estimates,
        signals=signals,
        first={"step1_v": s.y1, "x0": s.y1},
        valid={name: begun(context, s) for name in zhang.ESTIMATES},
    )


METHOD = Method(
    "two_step",
    "Approach II: Bastin-Gevers, then Besancon-Zhang-Hammouri with a matrix gain on its alpha2 and b",
    "dixit2008 section III, Approach II",
    "y_v",
    (
        start_parameter("two_step"),
        *bastin_gevers.parameters("two_step", bastin_gevers.REPAIRED),
        *filtered.filter_parameters("two_step", 20.0),
        *zhang.gain_parameters("two_step", besancon.K0, besancon.LAM, besancon.START_VALUES),
        *zhang.matrix_parameters("two_step"),
    ),
    (*bastin_gevers.states(), *filtered.STATES, *zhang.states(2)),
    _equations,
)
