"""Step 1 of Approach II: Bastin-Gevers' observer for alpha2, b and Fc at high speed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import filtered, step1
from bristle.observer.filtered import fast, regressor
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX
DEGREE = math.pi / 180.0
CITATION = "bastin1988 eq. (3); dixit2008 eq. (3) and (23)"
ESTIMATES = units("alpha2", "b", "Fc")


@dataclass(frozen=True)
class Tuning:
    """Gate vc in deg/s, c1 in 1/s, Gamma for (alpha2, b, Fc), in the units in which the step
    computes.
    """

    vc: float
    c1: float
    gamma: tuple[float, float, float]


REPAIRED = Tuning(vc=0.0, c1=100.0, gamma=(400.0, 400.0, 800.0))
PRINTED = Tuning(vc=50.0, c1=100.0, gamma=(1e-3, 1e-3, 1e-4))


def gamma_parameters(
    prefix: str, gains: tuple[float, float, float], source: str = CITATION
) -> tuple[Parameter, ...]:
    """Declare the diagonal of Gamma for (alpha2, b, Fc)."""
    return tuple(
        Parameter(
            f"{prefix}.gamma{i}",
            f"Gamma{i}",
            "1",
            gain,
            0.0,
            1e9,
            f"adaptation gain of {name}",
            source,
        )
        for i, (name, gain) in enumerate(zip(ESTIMATES, gains, strict=True), start=1)
    )


def start_parameters(prefix: str, source: str = CITATION) -> tuple[Parameter, ...]:
    """Declare the starts of the estimates."""
    return tuple(
        Parameter(
            f"{prefix}.{name}_start",
            name,
            unit,
            0.0,
            -1e6,
            1e6,
            f"start of the estimate of {name}",
            source,
        )
        for name, unit in ESTIMATES.items()
    )


def parameters(prefix: str, settings: Tuning) -> tuple[Parameter, ...]:
    """Declare gate, gains and starts under a method's name."""
    return (
        step1.gate_parameter(prefix, settings.vc * DEGREE),
        Parameter(
            f"{prefix}.c1", "c1", "1/s", settings.c1, 1e-3, 1e6, "output-error gain", CITATION
        ),
        *gamma_parameters(prefix, settings.gamma),
        *start_parameters(prefix),
    )


def states(velocity_unit: float = 1.0, input_unit: float = 1.0) -> tuple[State, ...]:
    """Declare the states of step 1, which computes with v / velocity_unit and u / input_unit."""
    scale = {"alpha2": 1.0, "b": input_unit / velocity_unit, "Fc": 1.0 / velocity_unit}
    return (
        *(
            State(
                f"step1_{name}",
                unit,
                f"estimate of {name}",
                initial=lambda p, n=name, k=scale[name]: p[f"{n}_start"] * k,
            )
            for name, unit in ESTIMATES.items()
        ),
        State("step1_v", "rad/s", "velocity estimate of step 1"),
        State("step1_gate", "1", "1 while step 1 adapts"),
    )


def adapt(p: Namespace, s: Sample, vc: SX, entry: SX | None = None) -> dict[str, SX]:
    """Advance x^ and theta^ over one sample: x' = phi theta, phi = [-v, u, -sgn v], while |v| > vc.

    Held over a sample: phi takes the mean of the two velocities (an Euler step on y_(k-1) biases b
    by c1 Ts/2), the gradient is taken at the error that the new theta^ leaves, and of that error
    exp(-c1 Ts) remains: with theta~ for the error of theta^, theta~' Gamma^-1 theta~ plus the
    square of the error never grows, whatever the gain. At gate entry x^ is set to `entry`, or to
    the measured velocity.

    Source: bastin1988 eq. (3); dixit2008 eq. (3) with n = 1, R = 0 and section IV-E.
    """
    theta = ca.vertcat(p.step1_alpha2, p.step1_b, p.step1_Fc)
    gamma = ca.vertcat(p.gamma1, p.gamma2, p.gamma3)
    gate = fast(s, vc)
    x = ca.if_else(p.step1_gate > 0, p.step1_v, s.y0 if entry is None else entry)
    phi = regressor(s)
    predicted = x + s.period * ca.dot(phi, theta)
    error = (s.y1 - predicted) / (1 + s.period**2 * ca.dot(phi, gamma * phi))
    theta_new = ca.if_else(gate, theta + s.period * gamma * phi * error, theta)
    x_new = ca.if_else(gate, s.y1 - ca.exp(-p.c1 * s.period) * error, s.y1)
    names = [f"step1_{name}" for name in ESTIMATES]
    return dict(zip(names, ca.vertsplit(theta_new), strict=True)) | {
        "step1_v": x_new,
        "step1_gate": gate,
    }


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    own = {name: p[f"step1_{name}"] for name in ESTIMATES}
    shared = filtered.observe(p, s, step1.kept(s))[1]
    return Update(
        next=shared | adapt(p, s, filtered.gate(p)),
        **step1.published(p, own, s.period),
        signals={"v": p.step1_v},
        first={"step1_v": s.y1},
    )


METHOD = Method(
    "bastin_gevers",
    "Bastin-Gevers observer of alpha2, b and Fc, gated to high speed",
    "bastin1988 eq. (3)",
    "y_v",
    (*parameters("bastin_gevers", REPAIRED), *filtered.filter_parameters("bastin_gevers", 20.0)),
    (*states(), *filtered.STATES),
    _equations,
)
