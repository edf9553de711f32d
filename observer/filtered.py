"""Step 1 as a filtered regression: z = F' theta with F' = a (f - F), f = [-v, u, -sgn v], z the
same filter on v'.

What adapts on it (Kreisselmeier, Luders and Narendra) does not see whether velocity or position was
measured: from position the regression of rls.py takes the place of this one.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import excitation, step1
from bristle.observer.companion import Rest, Row
from bristle.observer.method import Sample, stack, unstack, vector_states
from bristle.observer.rls import ESTIMATES

SX = ca.SX
COLUMNS = 7
STATES = (
    *vector_states(
        "filtered",
        "1",
        "filtered v', -v, u, -sgn v, 1, u', -sgn v times what falls with speed",
        COLUMNS,
    ),
    State("input_before", "V", "input before the last one"),
    *step1.STATES,
)
NOISES = 3.0  # standard deviations of the velocity below which it is noise


def noise_parameter(prefix: str) -> Parameter:
    """Declare the noise of the measured velocity under a method's name."""
    text = "standard deviation of the measured velocity"
    return Parameter(
        f"{prefix}.noise", "sd(v)", "rad/s", 1e-3, 0.0, 1e3, text, "ljung1999 section 11.2"
    )


def filter_parameters(prefix: str, cutoff: float) -> tuple[Parameter, ...]:
    """Declare filter and noise of the sensor under a method's name."""
    source = "luders1973; dixit2008 eq. (23)"
    corner = Parameter(
        f"{prefix}.cutoff", "a", "1/s", cutoff, 1e-3, 1e5, "corner of the filter", source
    )
    return (corner, noise_parameter(prefix))


def parameters(prefix: str, cutoff: float) -> tuple[Parameter, ...]:
    """Declare gate, filter and noise of the sensor under a method's name."""
    return (step1.gate_parameter(prefix), *filter_parameters(prefix, cutoff))


def fast(s: Sample, vc: SX) -> SX:
    """Return 1 where the speed is above vc, in one direction, over the whole sample."""
    return SX(ca.logic_and(ca.fmin(ca.fabs(s.y0), ca.fabs(s.y1)) > vc, s.y0 * s.y1 > 0))


def regressor(s: Sample) -> SX:
    """Return phi = [-v, u, -sgn v] as the mean over a sample in which v keeps its sign.

    Source: dixit2008 eq. (23).
    """
    return ca.vertcat(-(s.y0 + s.y1) / 2, s.u, -ca.sign(s.y0))


def gate(p: Namespace) -> SX:
    """Return the speed above which samples count."""
    return step1.speed_gate(p, NOISES * p.noise)


def observe(p: Namespace, s: Sample, kept: SX) -> tuple[Row, dict[str, SX]]:
    """Return (sample, next states of what all methods of step 1 from velocity share); `kept`: share
    that a sample leaves.

    Both sides of v' = f' theta are filtered alike, which leaves the equation exact; at gate entry
    the filters start from zero. Over a sample v' is the difference of two velocities and f its
    mean. The filtered difference of white noise has the variance g^2 / Ts^2 (1 + g / (2 - g)) of
    the noise, g = 1 - exp(-a Ts). Source: luders1973; dixit2008 eq. (23); widrow2008 chapter 1.
    """
    h, vc = s.period, gate(p)
    f = regressor(s)
    input_rate = ca.if_else(p.samples > 1, (s.u - p.input_before) / h, 0)
    raw = ca.vertcat((s.y1 - s.y0) / h, f, 1, input_rate, f[2] * step1.falling(f[0], vc))
    gain = 1 - ca.exp(-p.cutoff * h)
    before = stack(p, "filtered", COLUMNS)
    after = before + gain * (raw - before)
    counts = fast(s, vc)
    noise = (p.noise * gain / h) ** 2 * (1 + gain / (2 - gain))
    rest = Rest(ca.fabs(s.y1) > NOISES * p.noise, step1.LOAD_ENTRY)
    sample = Row(after[0], after[1:6], after[6], counts, noise, 2 / (p.cutoff * h), rest)
    shared = {
        **unstack("filtered", ca.if_else(counts, after, 0)),
        "input_before": s.u,
        **excitation.follow(p, s.y1, h, NOISES * p.noise).next,
        **step1.fit(p, sample, vc, kept, h),
    }
    return sample, shared


def velocity(p: Namespace, theta: SX) -> SX:
    """Return the observer's velocity x0 + F' theta / a, with x0 = v - z / a the measured velocity
    after the filter.
    """
    filtered = stack(p, "filtered", 4)
    return SX(p.last_y + (ca.dot(filtered[1:], theta) - filtered[0]) / p.cutoff)


def estimate_states() -> tuple[State, ...]:
    """Declare the estimates with their starts."""
    return tuple(
        State(
            f"theta{i}",
            unit,
            f"estimate of {name}",
            initial=lambda p, name=name: p[f"{name}_start"],
        )
        for i, (name, unit) in enumerate(ESTIMATES.items())
    )


def estimates(p: Namespace) -> dict[str, SX]:
    """Return the estimates by name."""
    return {name: p[f"theta{i}"] for i, name in enumerate(ESTIMATES)}
