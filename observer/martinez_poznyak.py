"""Step 2 with a switching state observer and least squares, after Martinez and Poznyak; alpha2 and
b known.

The text of the source was not to be had; taken from it is what others say of it, a
variable-structure estimator of states and parameters. Assumed is the usual form: a linear and a
switching correction of the measured state, and least squares with forgetting for the parameters.
For v' = x2 - alpha2 v + b u, x2' = psi theta, x2 = -w, with e = v - v^,
    v^' = x2^ - alpha2 v + b u + k e + rho sgn e.
While it slides, e = 0 and the correction nu is the error of x2^ itself. There remains an observer
of order one and, behind a low-pass filter, through which a switching term shows its equivalent
value, the regression for theta:
    x2^' = psi theta^ + kappa nu + Ups theta^',   Ups' = -(kappa + c^ |v|) Ups + psi,
    nu + Ups theta^ = Ups theta,
where c^ |v| stands for what psi theta loses to the error of x2^ in psi. Until it has slid for a
while the parameters wait. Source: martinez2001; utkin1992; dixit2008 eq. (15) to (17).
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State, declaring
from bristle.observer import step2, zhang
from bristle.observer.besancon import START_VALUES
from bristle.observer.method import (
    EquationContext,
    Method,
    Sample,
    Update,
    stack,
    unstack,
    vector_states,
)
from bristle.observer.rls import least_squares

SX = ca.SX
CITATION = "martinez2001"
N = len(zhang.ENTRIES)


def switching(e: SX, k: SX, rho: SX, period: SX) -> tuple[SX, SX]:
    """Return (mean of nu over a sample, 1 if it slides) for e' = -nu, nu = k e + rho sgn e, the
    sign that of the end.

    At e = 0 the sign is whatever keeps it there, so that there is no chatter to filter away.
    Source: acary2008.
    """
    left = e * ca.exp(-k * period)
    stopped = ca.fmin(ca.fmax(left, -rho * period), rho * period)
    return (e - left + stopped) / period, SX(ca.fabs(left) <= rho * period)


def predict(x2: SX, ups: SX, theta: SX, s: Sample, phi: zhang.Basis) -> tuple[SX, SX]:
    """Advance x2' = psi theta and Ups' = psi - c |v| Ups over a sample; what holds the value at its
    end is solved for.

    Source: dixit2008 section IV-E.
    """
    half = s.period / 2
    psi0, psi1 = zhang.regressor(s.y0, x2, phi), zhang.regressor(s.y1, SX(0), phi)
    kept, lost = 1 - half * theta[3] * ca.fabs(s.y0), 1 + half * theta[3] * ca.fabs(s.y1)
    ahead = (x2 + half * (psi0 + psi1) @ theta) / lost
    return ahead, (kept * ups + half * (psi0 + zhang.regressor(s.y1, ahead, phi)).T) / lost


def step(p: Namespace, s: Sample, alpha2: SX, b: SX) -> dict[str, SX]:
    """Return the next states of the observer with the given alpha2 and b; sigma0 and c stay
    positive by projection.

    Source: martinez2001.
    """
    theta = zhang.read_estimates(p, "step2")
    ups, covariance, filtered = (
        stack(p, "upsilon", N),
        stack(p, "step2_p", N, N),
        stack(p, "filtered", N + 1),
    )
    x2, ahead = predict(p.x1, ups, theta, s, zhang.basis(p))
    v = p.x0 + s.period * (b * s.u - alpha2 * (s.y0 + s.y1) / 2 + (p.x1 + x2) / 2)
    nu, slides = switching(s.y1 - v, p.k, p.rho, s.period)
    mean = (ups + ahead) / 2
    clear = ca.if_else(slides, p.step2_clear + s.period, 0)
    learns = clear > p.sliding_time
    low = 1 - ca.exp(-p.bandwidth * s.period)
    filtered = ca.if_else(
        learns, filtered + low * (ca.vertcat(nu + ca.dot(mean, theta), mean) - filtered), 0
    )
    z, h = filtered[0], filtered[1:]
    scale = zhang.scales(p)
    kept = ca.exp(-p.fading * s.period)
    change, spread = least_squares(
        covariance, scale * h, z - ca.dot(h, theta), p.noise**2, kept, N * p.uncertainty
    )
    new = ca.if_else(learns, ca.fmax(theta + scale * change, ca.vertcat(*zhang.LOWEST)), theta)
    gain = 1 - ca.exp(-p.kappa * s.period)
    ups_new = ahead - gain * mean
    return {
        "x0": v + s.period * nu,
        "x1": x2 + gain * nu + ca.dot(ups_new, new - theta),
        **unstack("upsilon", ups_new),
        **unstack("filtered", filtered),
        **unstack("step2_p", ca.if_else(learns, spread, covariance)),
        "step2_clear": clear,
        **zhang.write_estimates("step2", new),
    }


def published(p: Namespace, alpha2: SX) -> tuple[dict[str, SX], dict[str, SX]]:
    """Return (estimates, signals)."""
    return zhang.estimates(p, "step2"), {"v": p.x0, "w": -p.x1, "F": -p.x1 + alpha2 * p.x0}


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    estimates, signals = published(p, p.alpha2)
    beside, fields = step2.alone(context, s, estimates, step2.from_velocity(s))
    return Update(step(p, s, p.alpha2, p.b) | beside, **fields, signals=signals, first={"x0": s.y1})


def parameters(prefix: str, bandwidth: float, noise: float) -> tuple[Parameter, ...]:
    """Declare gains, least squares and starts under a method's name."""
    waits = "time it must slide before the parameters move"
    filtered = "corner of the low-pass filter of nu"
    spread = "standard deviation of nu that least squares expect"
    start = "start of the covariance, in squares of the scales"
    own, sliding = declaring(prefix, CITATION), declaring(prefix, "utkin1992")
    return (
        own("k", "k", "1/s", (10.0, 0.0, 1e4), "linear correction of v^"),
        own("rho", "rho", "rad/s2", (100.0, 0.0, 1e6), "switching correction of v^"),
        own("kappa", "kappa", "1/s", (50.0, 1e-3, 1e4), "rate at which the error of x2^ decays"),
        own("sliding_time", "t_s", "s", (0.2, 0.0, 10.0), waits),
        sliding("bandwidth", "a", "1/s", (bandwidth, 1e-3, 1e5), filtered),
        own("fading", "q", "1/s", (0.05, 0.0, 1e3), "rate at which least squares forget"),
        own("noise", "r", "rad/s2", (noise, 1e-6, 1e6), spread),
        own("uncertainty", "P0", "1", (1.0, 1e-9, 1e9), start),
        *zhang.scale_parameters(prefix, CITATION),
        *zhang.start_parameters(prefix, START_VALUES, CITATION),
    )


STATES = (
    *vector_states("x", "1", "state estimate", 2),
    *vector_states("upsilon", "1", "filtered regressor", N),
    *vector_states("filtered", "1", "regression behind the low-pass filter", N + 1),
    *(
        State(
            f"step2_p{N * i + j}",
            "1",
            "covariance of the estimates",
            initial=(lambda p: p.uncertainty) if i == j else 0.0,
        )
        for i in range(N)
        for j in range(N)
    ),
    State("step2_clear", "s", "time since it slides"),
    *zhang.estimate_states("step2"),
)

METHOD = Method(
    "martinez_poznyak",
    "switching observer with least squares for step 2, after Martinez and Poznyak; alpha2 and b"
    " known",
    CITATION,
    "y_v",
    (*zhang.known_parameters("martinez_poznyak"), *parameters("martinez_poznyak", 1000.0, 0.1)),
    (*STATES, *step2.COMPANION_STATES),
    _equations,
)
