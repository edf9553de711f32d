"""The controller of a servo that is given a goal: part of a model whose input is a setpoint.

It joins a servo like the effects of `plant/effects`, in front of them: what acts on an input then
acts on the torque that it asks for. A diagnosis fits it with the servo, and never names it.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import State, declaring
from bristle.plant.effect import Context, Effect

__all__ = ["CONTROLLER"]

SOURCE = "astrom1997"
LEAST_LAG = 1e-4  # s: least time constant of the velocity that is simulated
WINDUP = 1e-9  # N.m: overshoot of the limit from which on the integral waits
_parameter = declaring("controller", f"{SOURCE} section 3.4")


def _error(c: Context) -> ca.SX:
    """Return the error of the position that the controller sees: a lag behind, as its velocity."""
    return ca.SX(c.u + c.p.offset - (c.theta - c.p.lag * c.p.speed))


def _asked(c: Context) -> ca.SX:
    """Return what the controller asks for before its limit [N.m]."""
    error = _error(c)
    dead = ca.sign(error) * ca.fmax(ca.fabs(error) - c.p.dead_band, 0)
    rate = (c.p.goal - c.p.goal_before) / c.p.sample_time
    opposed = c.p.friction * rate / ca.fmax(ca.fabs(rate), c.p.slow)
    # integral action has settled before: what the weight leaves out at the start, it holds
    settled = ca.if_else(c.p.ki > 0, c.p.goal_first, 0)
    weighted = dead + (c.p.weight - 1) * (c.u - settled)
    damped = c.p.kd * (c.p.forward * rate - c.p.speed)
    return ca.SX(c.p.kp * weighted + c.p.integral_torque + damped + opposed)


def command(c: Context) -> ca.SX:
    """T = kp (w r - y) + ki int(r - y) + kd (f r' - y') + c sgn(r'), at most the limit, with y the
    position behind a lag: y' = (theta - y)/tau. The integral is T_0 more at the start than what
    balances a goal that was there before, kp (1 - w) r.

    A cascade of a position and a velocity loop is this law too: kd is the gain of its velocity
    loop, kp that times the gain of its position loop, more by its integral action. Source:
    astrom1997 section 3.4 (setpoint weights), section 3.5 (windup).
    """
    return ca.SX(ca.fmin(ca.fmax(_asked(c), -c.p.limit), c.p.limit))


def rates(c: Context) -> dict[str, ca.SX]:
    """Integrate the error, as long as the limit does not hold the torque back."""
    asked, error = _asked(c), _error(c)
    beyond = ca.logic_and(ca.fabs(asked) > c.p.limit + WINDUP, asked * error > 0)
    return {
        "integral_torque": ca.if_else(beyond, 0, c.p.ki * error),
        "speed": (c.v - c.p.speed) / ca.fmax(c.p.lag, LEAST_LAG),
    }


def updates(c: Context) -> dict[str, ca.SX]:
    """Keep the goal of the sample before, for its rate, and the first one."""
    # no step before the first sample
    before, first = (ca.if_else(c.p.begun > 0.5, x, c.u) for x in (c.p.goal, c.p.goal_first))
    return {"begun": ca.SX(1), "goal": c.u, "goal_before": before, "goal_first": first}


def recorded(c: Context) -> dict[str, ca.SX]:
    """Return what the controller holds, from the recorded setpoint and position."""
    integral = c.p.integral + c.p.ki * c.p.error_sum
    speed = c.v - c.p.lag * c.p.a
    return {
        "integral_torque": integral,
        "speed": speed,
        "begun": ca.SX(1),
        "goal": c.u,
        "goal_before": c.p.u_before,
        "goal_first": c.p.u_first,
    }


CONTROLLER = Effect(
    "controller",
    "the controller that follows the setpoint",
    SOURCE,
    title="controller",
    group="controller",
    equation="kp (w r - y) + ki int(r - y) + kd (f r' - y') + c sgn(r')",
    residual=("u",),
    excitation="steps of the setpoint",
    confounded=(),
    parameters=(
        _parameter("kp", "kp", "N.m/rad", (1.0, 1e-12, 1e12), "{torque} over error of position"),
        _parameter("ki", "ki", "N.m/(rad.s)", (0.0, 0.0, 1e12), "{torque} over its integral"),
        _parameter("kd", "kd", "N.m.s/rad", (0.0, 0.0, 1e12), "{torque} over error of velocity"),
        _parameter("lag", "tau", "s", (0.0, 0.0, 0.05), "lag of the position that it sees"),
        _parameter("offset", "e_1", "rad", (0.0, -1e3, 1e3), "what its position reads too little"),
        _parameter("limit", "T_max", "N.m", (1e12, 1e-12, 1e12), "largest {torque} it asks for"),
        _parameter("weight", "w", "1", (1.0, 0.0, 2.0), "weight of the setpoint beside kp"),
        _parameter("forward", "f", "1", (1.0, 0.0, 2.0), "weight of the setpoint's rate beside kd"),
        _parameter("friction", "c", "N.m", (0.0, 0.0, 1e12), "{torque} along the setpoint's rate"),
        _parameter("slow", "v_0", "rad/s", (1e-3, 1e-12, 1e6), "rate from which on it is whole"),
        _parameter("dead_band", "e_0", "rad", (0.0, 0.0, 1e6), "error that is not answered"),
        _parameter("integral", "T_0", "N.m", (0.0, -1e12, 1e12), "integral {torque} at the start"),
    ),
    order=1,
    states=(
        State("integral_torque", "N.m", "integral torque", initial=lambda p: p.integral),
        State("speed", "rad/s", "velocity that the controller sees", initial=lambda p: p.v_start),
    ),
    rates=rates,
    sampled=(
        State("begun", "1", "1 from the first sample on"),
        State("goal", "rad", "setpoint"),
        State("goal_before", "rad", "setpoint of the sample before"),
        State("goal_first", "rad", "setpoint of the first sample"),
    ),
    updates=updates,
    recorded=recorded,
    command=command,
    unused={
        "limit": 1e12,
        "weight": 1.0,
        "forward": 1.0,
        "friction": 0.0,
        "slow": 1e-3,
        "dead_band": 0.0,
        "ki": 0.0,
        "kd": 0.0,
        "lag": 0.0,
    },
)
