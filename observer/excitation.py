"""The clock of an estimator that learns from reversals: it runs for a while after each, and stands
still in rest and slow arcs.

Friction shows near zero velocity, and what a record teaches of it comes in passages through zero.
Schedules that run by this clock (early noise, memory, a start) depend on what has been excited, not
on how long the record is. Source: ljung1999 section 13.2 (persistent excitation).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from bristle.model.variables import Namespace, State

SX = ca.SX
CLEAR_SHARE = 0.1  # of the rms speed, above which the direction of motion counts
FRESH_TIME = 1.0  # s after a reversal in which time counts
# 1/s, variance over Fc^2 by which a load torque may drift while the servo rests, when nothing shows
# it
LOAD_DRIFT = 1e-3
# steps of the sensor within the filter's time constant, below which a speed is noise
COUNTS_OF_NOISE = 2.0


@dataclass(frozen=True)
class SampleExcitation:
    """What a sample adds: `time` that counts (s), whether the motion `reverses`, rms speed so far,
    and the next states.
    """

    time: SX
    reverses: SX
    rms: SX
    next: dict[str, SX]


STATES = (
    State("direction", "1", "direction of motion, when it last was clear"),
    State("since_reversal", "s", "time since the motion last reversed"),
    State("travelled", "s", "time in motion"),
    State("mean_square", "rad2/s2", "mean squared speed in motion"),
    State("reversals", "1", "reversals so far"),
)


def noise_speed(p: Namespace) -> SX:
    """Return the speed below which a velocity from filtered positions is the sensor's noise."""
    return SX(COUNTS_OF_NOISE * p.resolution * p.cutoff)


def rms_speed(p: Namespace) -> SX:
    """Return the rms speed in motion so far."""
    return SX(ca.sqrt(p.mean_square))


def advance(p: Namespace, speed: SX, period: SX) -> SampleExcitation:
    """Follow a velocity from filtered positions by one sample."""
    return follow(p, speed, period, noise_speed(p))


def follow(p: Namespace, speed: SX, period: SX, noise: SX) -> SampleExcitation:
    """Follow a velocity by one sample; up to `noise` it is none."""
    moving = ca.fabs(speed) > noise
    square = p.mean_square + period / (p.travelled + period) * (speed**2 - p.mean_square)
    clear = ca.logic_and(moving, ca.fabs(speed) > CLEAR_SHARE * ca.sqrt(square))
    reverses = ca.logic_and(clear, ca.sign(speed) != p.direction)
    since = ca.if_else(reverses, 0, p.since_reversal + period)
    # the first one is the beginning of the motion
    counts = ca.logic_and(since < FRESH_TIME, p.reversals > 1)
    states = {
        "direction": ca.if_else(clear, ca.sign(speed), p.direction),
        "since_reversal": since,
        "travelled": p.travelled + ca.if_else(moving, period, 0),
        "mean_square": ca.if_else(moving, square, p.mean_square),
        "reversals": p.reversals + ca.if_else(reverses, 1, 0),
    }
    return SampleExcitation(ca.if_else(counts, period, 0), reverses, rms_speed(p), states)


def rest(before: SX, moves: SX, period: SX) -> tuple[SX, SX]:
    """Return (time since motion was last seen, whether the servo rests) after a sample.

    In rest nothing is learnt or forgotten, and what acts from outside may change unseen. A record
    begins in rest.
    """
    since = ca.if_else(moves, 0, ca.fmin(before + period, FRESH_TIME))
    return since, since >= FRESH_TIME


def drifted(before: SX, rests: SX, square: SX, period: SX) -> SX:
    """Return the variance by which the load may have changed in this rest, up to `square`, that of
    dry friction; 0 in motion.
    """
    return SX(ca.if_else(rests, ca.fmin(before + period * LOAD_DRIFT * square, square), 0))


def drifted_state() -> State:
    """Declare the variance by which the load may have changed in a rest."""
    return State("drifted", "rad2/s4", "variance by which the load may have changed in this rest")


def rest_state(name: str = "rest") -> State:
    """Declare the time since motion was last seen."""
    return State(
        name,
        "s",
        "time since motion was last seen, up to that from which the servo rests",
        initial=FRESH_TIME,
    )
