"""Approach II with gains, gate and zero starts as printed; kept to show that it does not converge.

Three details are repaired, and can be chosen as printed: what x^ of step 1 is set to at gate entry,
|v| in the basis functions, and the implicit step of the gradient.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter
from bristle.observer import bastin_gevers, besancon_scalar, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update, never_valid
from bristle.observer.two_step import waiting

SX = ca.SX
# v in deg/s, and u is scaled alike, so that both entries of the regressor have the same weight
UNIT = besancon_scalar.UNIT


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run step 1 on (v, u) / UNIT, then step 2 in deg/s on its estimates.

    Source: dixit2008 eq. (3), (6), (23), (24) and section IV-E.
    """
    p = context.p
    go = p.samples * s.period >= p.step2_start
    scaled = Sample(s.u / UNIT, s.y0 / UNIT, s.y1 / UNIT, s.period)
    alpha2, b = p.step1_alpha2, p.step1_b
    entry = ca.if_else(p.measured_entry > 0, scaled.y0, ca.sign(scaled.y0) * p.vc / UNIT)
    held = waiting(context, s.y1 / UNIT, entries=zhang.ESTIMATES)
    step2 = besancon_scalar.step(context, s, alpha2, b)
    estimates, signals = besancon_scalar.published(context, alpha2)
    return Update(
        next=bastin_gevers.adapt(p, scaled, p.vc / UNIT, entry)
        | {name: ca.if_else(go, value, held[name]) for name, value in step2.items()},
        estimates={"alpha2": alpha2, "b": b, "Fc": p.step1_Fc * UNIT} | estimates,
        signals=signals,
        first={"step1_v": s.y1 / UNIT, "x0": s.y1 / UNIT},
        **never_valid(("alpha2", "b", "Fc", *zhang.ESTIMATES)),
    )


METHOD = Method(
    "two_step_printed",
    "Approach II with the printed gains, gate and zero starts (does not converge)",
    "dixit2008 section IV-E",
    "y_v",
    (
        Parameter(
            "two_step_printed.step2_start",
            "T2",
            "s",
            100.0,
            0.0,
            1e6,
            "when step 2 begins",
            "dixit2008 section IV-E",
        ),
        *bastin_gevers.parameters("two_step_printed", bastin_gevers.PRINTED),
        *zhang.gain_parameters(
            "two_step_printed", besancon_scalar.K0, besancon_scalar.LAM, (0.0, 0.0, 0.0, 0.0)
        ),
        Parameter(
            "two_step_printed.measured_entry",
            "e",
            "1",
            1.0,
            0.0,
            1.0,
            "x^ of step 1 at gate entry: 1: the measured velocity; 0: +-vc, as printed",
            "dixit2008 section IV-E",
        ),
        *besancon_scalar.printed_parameters("two_step_printed"),
    ),
    (*bastin_gevers.states(UNIT, UNIT), *zhang.states(2, zhang.ESTIMATES)),
    _equations,
)
