"""Step 2 of Approach II from position alone: x0' = v put before the model, n = 3, matrix gain."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter
from bristle.observer import besancon, kalman, smoothing, step2, zhang
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX
LAM = 85.0
GAIN = 1e9
AVERAGING = 20.0
MAX_REGRESSOR_SPEED = 10.0  # rad/s; larger velocity estimates are not used in the regressor


def chain(h: SX) -> tuple[SX, SX, SX]:
    """Return (F, M0, M1): the exact step of three integrators, driven on rows v and w by inputs
    linear over the step.

    Source: vanloan1978, in closed form for a nilpotent matrix.
    """
    f = ca.vertcat(ca.horzcat(1, h, h**2 / 2), ca.horzcat(0, 1, h), ca.horzcat(0, 0, 1))
    m0 = ca.vertcat(
        ca.horzcat(h**2 / 3, h**3 / 8), ca.horzcat(h / 2, h**2 / 3), ca.horzcat(0, h / 2)
    )
    m1 = ca.vertcat(
        ca.horzcat(h**2 / 6, h**3 / 24), ca.horzcat(h / 2, h**2 / 6), ca.horzcat(0, h / 2)
    )
    return f, m0, m1


def innovation_gain(lam: SX, h: SX) -> SX:
    """Return the gain that puts all error poles at exp(-lam h): K0 = [3, 3, 1] of (6), sampled.

    A filter that holds the *position* linear between samples, as the second-order observer holds
    the velocity, loses v' h^2/12, which its gain turns into an error of b; an innovation at the
    sampling instants loses nothing. Source: besancon2004 eq. (6); poles by comparison of
    coefficients.
    """
    p = ca.exp(-lam * h)
    return ca.vertcat(1 - p**3, 1.5 * (1 - p) ** 2 * (1 + p) / h, (1 - p) ** 3 / h**2)


def _limited(v: SX) -> SX:
    return ca.fmin(ca.fmax(v, -MAX_REGRESSOR_SPEED), MAX_REGRESSOR_SPEED)


def predict(memory: zhang.Memory, s: Sample, alpha2: SX, b: SX, phi: zhang.Basis) -> tuple[SX, SX]:
    """Advance x^ = (theta^, v^, -w^) and Ups over one sample without correction.

    The velocity at the end is predicted twice, the second time with the regressor of the first; the
    term c |v| x2 is solved for, as in the second-order observer. Source: dixit2008 eq. (15), (17)
    and the remark on position measurement at the end of section III.
    """
    x, ups, theta = memory
    f, m0, m1 = chain(s.period)
    va = _limited(x[1])
    psi0 = zhang.regressor(va, x[2], phi)
    vb, psi1, ahead = va, psi0, x
    for _ in range(2):
        psi1 = zhang.regressor(vb, SX(0), phi)
        f0 = ca.vertcat(-alpha2 * va + b * s.u, psi0 @ theta)
        f1 = ca.vertcat(-alpha2 * vb + b * s.u, psi1 @ theta)
        free = f @ x + m0 @ f0 + m1 @ f1
        rate = ca.fabs(vb) * theta[3]
        x2 = free[2] / (1 + m1[2, 1] * rate)
        ahead = free - m1[:, 1] * rate * x2
        psi1 = zhang.regressor(vb, x2, phi)
        vb = _limited(ahead[1])
    return ahead, f @ ups + m0[:, 1] @ psi0 + m1[:, 1] @ psi1


def step(context: EquationContext, s: Sample, alpha2: SX, b: SX) -> dict[str, SX]:
    """Return the next states of the observer with the given alpha2 and b."""
    p = context.p
    x, ups, theta, mean = zhang.read(p, 3)
    x, ups = predict((x, ups, theta), s, alpha2, b, zhang.basis(p))
    error = s.y1 - x[0]
    theta_new = zhang.gradient(ups, theta, error, zhang.matrix_gain(p), s.period, low=True)
    gain = innovation_gain(p.lam, s.period)
    ups = ups - gain @ ups[0, :]
    x = x + gain * error + ups @ (theta_new - theta)
    return zhang.write(x, ups, theta_new, mean, zhang.averaging_weight(p, s.period))


def published(p: Namespace, alpha2: SX) -> tuple[dict[str, SX], dict[str, SX]]:
    """Return (estimates, signals)."""
    signals = {"theta": p.x0, "v": p.x1, "w": -p.x2, "F": -p.x2 + alpha2 * p.x1}
    return zhang.estimates(p, "mean"), signals


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    estimates, signals = published(p, p.alpha2)
    velocity, filters = smoothing.smooth(p, s)
    beside, fields = step2.alone(context, velocity, estimates, step2.from_position(p, s))
    own = step(context, s, p.alpha2, p.b)
    return Update(own | filters | beside, **fields, signals=signals, first={"x0": s.y1})


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare gains, starts and averaging under a method's name."""
    return (
        *zhang.gain_parameters(prefix, (), LAM, besancon.START_VALUES),
        *zhang.matrix_parameters(prefix, gain=GAIN, averaging=AVERAGING),
    )


METHOD = Method(
    "besancon_position",
    "Besancon-Zhang-Hammouri observer from position, n = 3, with a matrix gain; alpha2 and b known",
    "besancon2004 eq. (6) with the gain of zhang2002",
    "y_theta",
    (
        *zhang.known_parameters("besancon_position"),
        kalman.resolution_parameter("besancon_position"),
        smoothing.parameter("besancon_position"),
        *parameters("besancon_position"),
    ),
    (*zhang.states(3), *smoothing.STATES, *step2.COMPANION_STATES),
    _equations,
)
