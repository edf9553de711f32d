"""The velocity controller with its seeded reference."""

from __future__ import annotations

import math

import casadi as ca

from bristle.fmus.controller.compensation import (
    ASSUMED_C,
    FADE_TIME,
    TEST_TIME,
    compensation,
    estimates,
)
from bristle.model.generator import MODULUS, draw, normal, scrambled
from bristle.model.program import Program
from bristle.model.system import SAMPLE_TIME, System
from bristle.model.variables import Namespace, Parameter, State, Variable

SX = ca.SX

KP = Parameter("kp", "kp", "V.s/rad", 4.0, 0.0, 1e6, "proportional gain", "astrom2008 section 10.1")
KI = Parameter("ki", "ki", "V/rad", 20.0, 0.0, 1e6, "integral gain", "astrom2008 section 10.1")
CONTROLLER_U_MAX = Parameter(
    "u_max", "u_max", "V", 24.0, 0.0, 1e6, "largest voltage asked for", "dixit2008 section IV-A"
)
REFERENCE_SEED = Parameter(
    "seed",
    "seed",
    "1",
    1.0,
    1.0,
    MODULUS - 1.0,
    "whole number that chooses the reference",
    "park1988 section 2",
)
REFERENCE_ORDER = Parameter(
    "order",
    "order",
    "1",
    1.0,
    1.0,
    2.0,
    "low-pass sections of the reference, 1 or 2",
    "dixit2008 section IV-C",
)
RMS = Parameter(
    "rms",
    "rms",
    "rad/s",
    math.radians(120.0),
    0.0,
    1e4,
    "rms of the reference, not clipped",
    "dixit2008 section IV-C",
)
CLIP = Parameter(
    "clip",
    "clip",
    "rad/s",
    math.radians(300.0),
    0.0,
    1e4,
    "largest reference",
    "dixit2008 section IV-C",
)
CUTOFF = Parameter(
    "cutoff",
    "omega_c",
    "rad/s",
    5.0,
    1e-3,
    1e3,
    "cut-off of each section",
    "dixit2008 section IV-C",
)


def _constants(system: System, p: Namespace) -> Namespace:
    """Filter coefficients, and the stationary covariance P of two sections for the rms asked for.

    Section i: x_i' = a x_i + (1 - a) w_i with w_1 = g n (n white, variance 1) and w_2 = x_1'.
    """
    two = p.order >= 1.5
    a = system.constant({"a": ca.exp(-p.cutoff * p.sample_time)}).a
    one, squared = 1 - a, a * a
    gain = p.rms * ca.sqrt(ca.if_else(two, (1 + a) ** 3 / (one * (1 + squared)), (1 + a) / one))
    p11 = (one * gain) ** 2 / (1 - squared)
    p12 = one * p11 / (1 - squared)
    names = system.constant({"g": gain, "p11": p11, "p12": p12, "two": two})
    return Namespace({**names.symbols, "a": a})


def _reference(system: System, p: Namespace, scale: SX) -> tuple[SX, SX, SX]:
    """Declare the generator and the low-pass sections; return the reference now, after one sample
    and after two.
    """
    k = _constants(system, p)
    z1, s = normal(scrambled(p.seed))
    z2, s = normal(s)
    deviation = ca.sqrt(k.p11)
    slope = ca.if_else(deviation > 0, k.p12 / deviation, 0)
    rest = ca.sqrt(ca.fmax(p.rms**2 - slope**2, 0))
    random = system.sampled(State("random", "1", "state of the random generator", initial=s))
    x1 = system.sampled(State("x1", "rad/s", "first section", initial=deviation * z1))
    x2 = system.sampled(State("x2", "rad/s", "second section", initial=slope * z1 + rest * z2))

    def advance(random: SX, x1: SX, x2: SX) -> tuple[SX, SX, SX]:
        following = draw(random)
        noise = math.sqrt(3) * (2 * following / MODULUS - 1)
        x1_next = k.a * x1 + (1 - k.a) * k.g * noise
        return following, x1_next, k.a * x2 + (1 - k.a) * x1_next

    def shown(x1: SX, x2: SX) -> SX:
        return scale * ca.fmin(ca.fmax(ca.if_else(k.two, x2, x1), -p.clip), p.clip)

    following = advance(random, x1, x2)
    for name, value in zip(("random", "x1", "x2"), following, strict=True):
        system.update(name, value)
    return shown(x1, x2), shown(*following[1:]), shown(*advance(*following)[1:])


def _control(system: System, p: Namespace, error: SX, forward: SX) -> SX:
    """Declare the controller u = sat(kp e + I + forward), whose integral stops while u is saturated
    and e would drive it further.

    Source: astrom2008 section 10.1; conditional integration, section 10.4.
    """
    integral = system.sampled(State("integral", "V", "integral part"))
    voltage = system.sampled(State("voltage", "V", "voltage asked for"))
    wanted = p.kp * error + integral + forward
    free = ca.logic_or(ca.fabs(wanted) < p.u_max, wanted * error < 0)
    system.update("voltage", ca.fmin(ca.fmax(wanted, -p.u_max), p.u_max))
    system.update("integral", ca.if_else(free, integral + p.ki * p.sample_time * error, integral))
    return voltage


def program() -> Program:
    """Return Controller: it ticks at t_k with the y_v of t_k and publishes u at t_k+1.

    That voltage acts from t_k+1 to t_k+2, and the compensation is for the reference of that time.
    """
    system = System(
        "controller",
        "velocity controller with a seeded random reference and compensation of friction",
    )
    tuning = (KP, KI, CONTROLLER_U_MAX, FADE_TIME, ASSUMED_C, TEST_TIME)
    for parameter in (*tuning, REFERENCE_SEED, REFERENCE_ORDER, RMS, CLIP, CUTOFF, SAMPLE_TIME):
        system.parameter(parameter)
    y_v = system.input(Variable("y_v", "rad/s", "measured velocity"))
    u_ff = system.input(
        Variable(
            "u_ff", "V", "voltage that is added to the controller's own", minimum=-1e9, maximum=1e9
        )
    )
    scale = system.input(
        Variable("reference_scale", "1", "factor of the reference", 1.0, minimum=-1e6, maximum=1e6)
    )
    given = estimates(system)
    p = system.namespace()
    reference, *ahead = _reference(system, p, scale)
    compensated = compensation(system, p, given, reference - y_v, (ahead[0], ahead[1]))
    voltage = _control(system, p, reference - y_v, u_ff + compensated)
    forward = system.sampled(State("forward", "V", "voltage of the compensation"))
    system.update("forward", compensated)
    system.output(Variable("u", "V", "voltage asked of the drive"), voltage)
    system.output(Variable("reference", "rad/s", "velocity to follow"), reference)
    system.output(
        Variable("u_compensation", "V", "part of u that compensates friction, inertia and load"),
        forward,
    )
    return Program("Controller", [system])
