"""Step 1 as a filtered regression: z = F' theta with F' = a (f - F), f = [-v, u, -sgn v], z the same filter on v'.

What adapts on it (Kreisselmeier, Luders and Narendra) does not see whether velocity or position was measured: from
position the regression of rls.py takes the place of this one.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer.bastin_gevers import fast, gate_parameter, regressor
from bristle.observer.method import Sample, stack, unstack, vector_states
from bristle.observer.rls import ESTIMATES, Regression

SX = ca.SX
STATES = vector_states("filtered", "1", "filtered v', -v, u, -sgn v", 4)


def parameters(prefix: str, cutoff: float) -> tuple[Parameter, ...]:
    """Declare gate and filter under a method's name."""
    source = "luders1973; dixit2008 eq. (23)"
    return (gate_parameter(prefix), Parameter(f"{prefix}.cutoff", "a", "1/s", cutoff, 1e-3, 1e5, "corner of the filter", source))


def regression(p: Namespace, s: Sample) -> Regression:
    """Filter both sides of v' = f' theta alike, which leaves the equation exact; at gate entry the filters start from zero.

    Over a sample v' is the difference of two velocities and f its mean.
    Source: luders1973; dixit2008 eq. (23).
    """
    raw = ca.vertcat((s.y1 - s.y0) / s.period, regressor(s))
    before = stack(p, "filtered", 4)
    after = before + (1 - ca.exp(-p.cutoff * s.period)) * (raw - before)
    counts = fast(s, p.vc)
    return Regression(after[0], after[1:], counts, unstack("filtered", ca.if_else(counts, after, 0)))


def velocity(p: Namespace, theta: SX) -> SX:
    """Return the observer's velocity x0 + F' theta / a, with x0 = v - z / a the measured velocity after the filter."""
    filtered = stack(p, "filtered", 4)
    return SX(p.last_y + (ca.dot(filtered[1:], theta) - filtered[0]) / p.cutoff)


def estimate_states() -> tuple[State, ...]:
    """Declare the estimates with their starts."""
    return tuple(
        State(f"theta{i}", unit, f"estimate of {name}", initial=lambda p, name=name: p[f"{name}_start"])
        for i, (name, unit) in enumerate(ESTIMATES.items())
    )
