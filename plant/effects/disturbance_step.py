"""A torque that sets in at some time and stays."""

from __future__ import annotations

import casadi as ca
import numpy as np

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect, Evidence, Limits, RecordedMotion

LEAST_SHARE_BESIDE = 0.05  # least share of the samples before the onset, and after it (1)


def torque(c: Context) -> ca.SX:
    """T = D clip((t - t0)/rise, 0, 1): a step with a short ramp, so that it can be differentiated
    by t0.

    Source: astrom2008 (load disturbance).
    """
    return ca.SX(c.p.torque * ca.fmin(ca.fmax((c.time - c.p.onset) / c.p.rise, 0), 1))


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return the onsets that explain most of what is left."""
    onsets = np.quantile(e.time, np.linspace(0.0, 1.0, 42)[1:-1])
    found = e.best([float(t) for t in onsets], lambda t: (e.time > t)[:, None].astype(float), 2)
    return [{"torque": float(d), "onset": onset} for onset, (d,) in found]


def limits(m: RecordedMotion) -> Limits:
    """An onset with enough before and after it: otherwise the step is a bias with some outliers."""
    first, last = np.quantile(m.time, [LEAST_SHARE_BESIDE, 1 - LEAST_SHARE_BESIDE])
    return {"onset": (float(first), float(last))}


EFFECT = Effect(
    "disturbance_step",
    "a {torque} that sets in at some time and stays",
    "astrom2008",
    title="step in the load {torque}",
    group="disturbance_step",
    equation="T = D clip((t - t0)/rise, 0, 1)",
    residual=("t",),
    timing="event",
    nonsmooth=True,
    excitation="a record that lasts beyond the onset",
    confounded=("friction_drift", "bias"),
    parameters=(
        Parameter(
            "disturbance_step.torque",
            "D",
            "N.m",
            0.005,
            -1e6,
            1e6,
            "{torque} after the onset",
            "astrom2008",
        ),
        Parameter(
            "disturbance_step.onset", "t0", "s", 0.5, -1e6, 1e6, "time of the onset", "astrom2008"
        ),
        Parameter(
            "disturbance_step.rise",
            "rise",
            "s",
            1e-3,
            1e-6,
            1e3,
            "duration of the ramp",
            "astrom2008",
        ),
    ),
    load_side=True,
    torque=torque,
    without_truth=("load",),
    off={"torque": 0.0},
    limits=limits,
    starts=starts,
)
