"""More dry friction at low speed."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence, Limits, RecordedMotion, power
from bristle.plant.law import FrictionLaw


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


def limits(m: RecordedMotion) -> Limits:
    """A curve that has fallen well within the speeds that are seen: otherwise it is a drag by
    another name.
    """
    return {"speed": m.slow}


def excluded(law: FrictionLaw) -> str:
    """Laws with a static friction have the curve already."""
    own = any(p.name.endswith(".Fs") for p in law.parameters)
    return f"the law '{law.name}' has a Stribeck curve of its own" if own else ""


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
        Parameter(
            "stribeck.excess",
            "e",
            "1",
            0.5,
            -1.0,
            100.0,
            "static over Coulomb friction, less one",
            "armstrong1994",
        ),
        Parameter(
            "stribeck.speed", "vs", "rad/s", 0.3, 1e-6, 1e6, "Stribeck velocity", "armstrong1994"
        ),
        Parameter(
            "stribeck.exponent",
            "n",
            "1",
            2.0,
            0.5,
            4.0,
            "of the velocity in the Stribeck curve",
            "armstrong1994",
        ),
    ),
    shape_starts=({"exponent": 2.0},),
    factor=factor,
    without_truth=("sigma0", "sigma1", "sigma2", "a1", "v0", "vc"),
    off={"excess": 0.0},
    search_interval={"excess": (0.0, 100.0)},
    limits=limits,
    excluded=excluded,
    starts=starts,
)
