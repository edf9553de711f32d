"""Approach II from an encoder with mixing that torques and noise do not bias: least squares, then
DREM with instrumental variables.

The regressor of `drem` contains w, and with it every torque that is not in the model: what disturbs
z = h' theta also disturbs h, and least squares and mixing are biased for good. In the place of one
factor h of Phi = h h' stands here a vector zeta that is like h but knows nothing of the
disturbance, the w in it being that of the model driven by the velocity alone. Then the averages of
zeta h' and zeta z obey Phi theta = Y but for the average of zeta times the disturbance, which tends
to zero.
"""

from __future__ import annotations

import math

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import drem, step2, two_step_drem, zhang
from bristle.observer.method import (
    EquationContext,
    Method,
    Sample,
    Update,
    stack,
    unstack,
    vector_states,
)

SX = ca.SX
CITATION = "glushchenko2024"
N = len(zhang.ENTRIES)
IV_BANDWIDTH = 15.0  # 1/s


def instruments(p: Namespace, s: Sample, phi: zhang.Basis) -> tuple[SX, SX]:
    """Return (w of the model at the end of a sample, means of v, phi1 v, phi2 v, -|v| w and -|v|
    over it).

    w' = K(v) v - c |v| w with the estimates there are; it forgets where it came from, whatever the
    estimates are. Source: glushchenko2024 (instruments from an auxiliary model); dixit2008 eq.
    (17).
    """
    theta = zhang.read_estimates(p, "step2")
    ends = [ca.vertcat(v, *(each * v for each in phi(v))) for v in (s.y0, s.y1)]
    springs = (ends[0] + ends[1]) / 2
    speed = (ca.fabs(s.y0) + ca.fabs(s.y1)) / 2
    travel = ca.fmax(theta[3] * speed * s.period, 1e-9)
    kept = ca.exp(-travel)
    w = p.model_w * kept + ca.dot(theta[:3], springs) * s.period * (1 - kept) / travel
    return w, ca.vertcat(springs, -speed * (p.model_w + w) / 2, -speed)


def step(p: Namespace, s: Sample, alpha2: SX, b: SX) -> dict[str, SX]:
    """Extend with instruments, average, mix, and advance theta as `drem` does.

    The averages are over the record, at most its last `reach`. D is what Delta would be at most, by
    the inequalities of Hadamard and of Cauchy and Schwarz. Source: glushchenko2024; aranovskiy2017.
    """
    phi, h = zhang.basis(p), s.period
    z, row, filters = drem.regression(p, drem.means(s, alpha2, b, phi), h)
    w, signals = instruments(p, s, phi)
    once, before = stack(p, "tool_once", N), stack(p, "tool_twice", N)
    low = 1 - ca.exp(-p.bandwidth * h)
    once_new = once + low * (signals - once)
    after = before + low * (once_new - before)
    zeta = (before + after) / 2
    share = h / (ca.fmin(p.averaged, p.reach) + h)
    mixed_phi, mixed_y, sizes = (
        stack(p, "iv_phi", N, N),
        stack(p, "iv_y", N),
        stack(p, "iv_sizes", 2 * N),
    )
    mixed_phi += share * (zeta @ row.T - mixed_phi)
    mixed_y += share * (zeta * z - mixed_y)
    sizes += share * (ca.vertcat(zeta**2, row**2) - sizes)
    delta, mixed = drem.mix(mixed_phi, mixed_y)
    least = (p.noise / zhang.scales(p)) ** 2
    largest = math.prod(
        (ca.sqrt((sizes[i] + least[i]) * (sizes[N + i] + least[i])) for i in range(N)), start=SX(1)
    )
    gain = (1 - ca.exp(-p.gain * h)) * delta / (delta**2 + (p.kappa * largest) ** 2)
    theta = zhang.read_estimates(p, "step2")
    new = ca.fmax(theta + gain * (mixed - delta * theta), ca.vertcat(*zhang.LOWEST))
    adapted = {
        **unstack("iv_phi", mixed_phi),
        **unstack("iv_y", mixed_y),
        **unstack("iv_sizes", sizes),
        "averaged": p.averaged + h,
        **zhang.write_estimates("step2", new),
    }
    counts = p.step2_clear > drem.SETTLED_AFTER / p.bandwidth
    return {
        **filters,
        **unstack("tool_once", once_new),
        **unstack("tool_twice", after),
        "model_w": w,
        "step2_clear": p.step2_clear + h,
        **{name: ca.if_else(counts, value, p[name]) for name, value in adapted.items()},
    }


def _equations(context: EquationContext, s: Sample) -> Update:
    """Run both steps as `two_step_drem`, the second with instruments.

    Source: dixit2008 section III, Approach II; glushchenko2024.
    """
    return two_step_drem.equations(context, s, step)


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare filter, averaging and gain under a method's name."""
    text = "time over which the averages reach back"
    return (
        *(
            each
            for each in drem.parameters(prefix, IV_BANDWIDTH)
            if each.name != f"{prefix}.fading"
        ),
        Parameter(f"{prefix}.reach", "T_m", "s", 20.0, 0.1, 1e6, text, CITATION),
    )


STATES = (
    *drem.FILTER_STATES,
    *vector_states("tool_once", "1", "instruments after one section", N),
    *vector_states("tool_twice", "1", "instruments after two sections", N),
    State("model_w", "rad/s2", "friction acceleration of the model"),
    *vector_states("iv_phi", "1", "average of instruments times regressor", N * N),
    *vector_states("iv_y", "1", "average of instruments times the signal explained", N),
    *vector_states("iv_sizes", "1", "mean squares of instruments and regressor", 2 * N),
    State("averaged", "s", "time in the averages"),
    *zhang.estimate_states("step2"),
)

METHOD = Method(
    "two_step_iv_drem",
    "Approach II from position: least squares, then mixing with instrumental variables, which"
    " torques and noise do not bias",
    "dixit2008 section III, Approach II; glushchenko2024",
    "y_theta",
    (*step2.encoder_parameters("two_step_iv_drem"), *parameters("two_step_iv_drem")),
    (*step2.ENCODER_STATES, *STATES),
    _equations,
)
