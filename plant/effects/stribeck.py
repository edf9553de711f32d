"""More dry friction at low speed."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence, power


def factor(c: Context) -> tuple[ca.SX, ca.SX]:
    """Fc (1 + e exp(-|v/vs|^n)), with e = Fs/Fc - 1.

    Source: armstrong1994 (Stribeck curve: Gaussian for n = 2, exponential for n = 1).
    """
    value = 1 + c.p.excess * ca.exp(-power(c.v / c.p.speed, c.p.exponent))
    return value, value


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return a little more friction below speeds from creep to a third of the fastest."""
    top = float(np.quantile(np.abs(e.v), 0.98))
    return [{"excess": 0.05, "speed": top * share} for share in (0.006, 0.02, 0.06, 0.2)]


EFFECT = Effect(
    "stribeck",
    "more dry friction at low speed",
    "armstrong1994",
    title="Stribeck friction",
    group="stribeck",
    equation="Fc (1 + e exp(-|v/vs|^n)) sgn v",
    residual=("v",),
    excitation="creep and reversals",
    confounded=("quadratic_drag", "dead_zone", "presliding"),
    parameters=(
        Parameter("stribeck.excess", "e", "1", 0.5, -1.0, 100.0, "static over Coulomb friction, less one", "armstrong1994"),
        Parameter("stribeck.speed", "vs", "rad/s", 0.3, 1e-6, 1e6, "Stribeck velocity", "armstrong1994"),
        Parameter("stribeck.exponent", "n", "1", 2.0, 0.5, 4.0, "of the velocity in the Stribeck curve", "armstrong1994"),
    ),
    form=({"exponent": 2.0},),
    factor=factor,
    starts=starts,
)
