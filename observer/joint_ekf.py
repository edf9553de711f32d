"""The joint extended Kalman filter as it is commonly set up: constant process noise, the paper's parameters as entries.

Least squares at high speed give alpha2 and b first; the filter then runs on all parameters, from position alone.
"""

from __future__ import annotations

from functools import partial

import casadi as ca

from bristle.model.basis import width_parameter
from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter
from bristle.observer import kalman, rls
from bristle.observer.kalman import MOTION_STATES
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX
JOINT_ENTRIES = units("alpha2", "b", "sigma0", "sigma1", "sigma2", "c", "tau")
START_VALUES = {"sigma0": 300.0, "sigma1": 0.0, "sigma2": 0.0, "c": 100.0, "tau": 0.0}  # round numbers, not taken from a plant
SPREADS = {"alpha2": 1.0, "b": 1.0, "sigma0": 500.0, "sigma1": 500.0, "sigma2": 500.0, "c": 100.0, "tau": 0.01}
STATE_SPREADS = (1e-3, 1.0, 5.0)  # rad, rad/s, rad/s2
LOWEST = {"alpha2": 0.0, "sigma0": 1.0, "c": 1.0, "tau": 0.0}
HIGHEST = {"tau": 1.0}


def _servo(p: Namespace, entries: SX) -> kalman.Servo:
    """Read the parameters as they stand."""
    alpha2, b, *sigma, c, tau = ca.vertsplit(entries)
    return kalman.Servo(alpha2, b, sigma, c, tau, width=p.width)


def _filter(p: Namespace, s: Sample) -> tuple[SX, SX]:
    """Return (vector, covariance) after a sample, with constant process noise.

    Source: jazwinski1970 chapter 8; ljung1979 (parameters as states).
    """
    z, covariance = kalman.predict(partial(_servo, p), *kalman.read(p, kalman.JOINT_ORDER), s.u, s.period)
    rates = [SX(0), p.noise_v, p.noise_w, *(p.noise_parameters * spread**2 for spread in SPREADS.values())]
    error = s.y1 + p.resolution / 2 - z[0]
    noisy = kalman.noisy(covariance, rates, s.period)
    z, covariance, _ = kalman.correct(z, noisy, error, kalman.rounding(p.resolution), p.gate)
    place = {name: MOTION_STATES + i for i, name in enumerate(JOINT_ENTRIES)}
    low = {place[name]: SX(least) for name, least in LOWEST.items()}
    return kalman.bounded(z, covariance, low, {place[name]: SX(most) for name, most in HIGHEST.items()}), covariance


def _equations(context: EquationContext, s: Sample) -> Update:
    p = context.p
    go = p.samples * s.period >= p.start_time
    z, covariance = _filter(p, s)
    step1 = rls.estimates(p)
    fixed = [p[f"{name}_start"] for name in START_VALUES]
    waiting = ca.vertcat(s.y1 + p.resolution / 2, p.last_v, 0, step1["alpha2"], step1["b"], *fixed)
    joint, cov = kalman.read(p, kalman.JOINT_ORDER)
    servo = _servo(p, joint[MOTION_STATES:])
    friction = servo.sigma[0] / ca.fmax(servo.c, LOWEST["c"])
    return Update(
        next=rls.fit(p, s) | kalman.write(ca.if_else(go, z, waiting), ca.if_else(go, covariance, cov)),
        estimates={**{name: p[f"joint{MOTION_STATES + i}"] for i, name in enumerate(JOINT_ENTRIES)}, "Fc": friction},
        signals=kalman.signals(joint, servo),
        first={"joint0": s.y1},
        valid={name: SX(go) for name in (*JOINT_ENTRIES, "Fc")},
    )


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare the start, the noise and the sensor's step."""
    noise = "jazwinski1970 chapter 8"
    return (
        *kalman.parameters(prefix),
        *rls.parameters(prefix),
        width_parameter(prefix),
        Parameter(f"{prefix}.start_time", "T0", "s", 10.0, 0.0, 1e6, "when the filter begins", "ljung1999 section 11.2"),
        *(
            Parameter(
                f"{prefix}.{name}_start", name, JOINT_ENTRIES[name], start, -1e9, 1e9, f"start of the estimate of {name}", noise
            )
            for name, start in START_VALUES.items()
        ),
        Parameter(f"{prefix}.noise_v", "q_v", "rad2/s3", 0.1, 0.0, 1e9, "process noise of v", noise),
        Parameter(f"{prefix}.noise_w", "q_w", "rad2/s5", 10.0, 0.0, 1e9, "process noise of w", noise),
        Parameter(f"{prefix}.noise_parameters", "q_p", "1/s", 1e-7, 0.0, 1.0, "process noise of a parameter over its sd", noise),
    )


METHOD = Method(
    "joint_ekf",
    "joint extended Kalman filter from position with constant noise, after 10 s of least squares",
    "jazwinski1970 chapter 8 with the model of dixit2008 eq. (15)-(17)",
    "y_theta",
    parameters("joint_ekf"),
    (
        *rls.STATES,
        *kalman.states(
            "theta, v, w, alpha2, b, sigma0, sigma1, sigma2, c, tau",
            "covariance of the vector",
            kalman.JOINT_ORDER,
            (*STATE_SPREADS, *SPREADS.values()),
        ),
    ),
    _equations,
)
