"""Inputs to choose from: motions planned within the range of the records and the torque that they
take, ramps, and own inputs.

Each effect shows in another kind of motion: rests and reversals, slow and fast motion, small and
large steps, a wide band.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bristle.common.metrics import rms
from bristle.common.table import Array
from bristle.diagnosis.answer import Finding, Reason, finding

DRAWS = 24  # inputs of random steps to choose from
# of ramps and recorded inputs: the first at which the motion keeps to the limits is taken
INPUT_SCALES = (1.0, 0.8, 0.6, 0.4)
USED_RANGE = (0.3, 0.85)  # of the range that was travelled: what steps are planned in
USED_TORQUE = (0.3, 0.95)  # of what the input gives beyond friction: what steps are planned with
ACCELERATING = 0.75  # of that: what accelerates; the rest is for viscous friction
SHORTEST = 0.02  # of the reach: shortest step
RESTS = (0.1, 1.0)  # s: mean length of the rests between steps
SWEEP_SHARE, RAMP_SHARE = 0.1, 0.1  # of the steps: a sweep, or a ramp through zero, in place of one
SWEEP_SECONDS = 2.0  # s: length of a sweep
BAND = (1.0, 40.0)  # Hz: of a sweep
RAMP_SECONDS = 2.0  # s: of one ramp through zero, there and back
RAMP_PEAKS = (0.5, 1.3)  # of the dry friction: peaks of the first and of the last ramp
QUICKER = 1.5  # by how much a recorded input is quickened
VARIED_DRAWS = 2  # inputs to choose from for each recorded one whose pace and size are varied
# over the recorded ones: no slower than that keeps a motion within its range
VARIED_PACE, VARIED_SIZE = (0.8, 3.0), (0.3, 1.0)
VARIED_SECONDS = 2.0  # s: from one drawn pace and size to the next
Follow = Callable[[float, Array], float]  # position at rest and an input (n,) -> position after it


@dataclass(frozen=True)
class Limits:
    """What records keep to: ends of input and of position (SI), and the largest rms of an input."""

    u: tuple[float, float]
    theta: tuple[float, float]
    rms: float

    @property
    def middle(self) -> float:
        """Middle of the positions."""
        return 0.5 * sum(self.theta)

    def allow_input(self, u: Array) -> bool:
        """True if an input (n,) stays within that of the records, in its rms too."""
        return bool(self.u[0] <= u.min() and u.max() <= self.u[1] and rms(u) <= self.rms)

    def allow_motion(self, theta: Array, margin: float) -> bool:
        """True if positions (n,) stay within those of the records less a margin, a share of their
        range on each side.
        """
        room = margin * (self.theta[1] - self.theta[0])
        return bool(self.theta[0] + room <= theta.min() and theta.max() <= self.theta[1] - room)


@dataclass(frozen=True)
class Axis:
    """What a motion takes: inertia, viscous and dry friction, torque over input (SI)."""

    inertia: float
    damping: float
    friction: float
    gain: float

    def input_for(self, theta: Array, h: float) -> Array:
        """Return the input (n,) for a motion (n,). Source: janot2019 (inverse dynamic model)."""
        v = np.gradient(theta, h)
        torque = (
            self.inertia * np.gradient(v, h)
            + self.damping * v
            + self.friction * np.sign(np.round(v, 9))
        )
        return np.asarray(torque / self.gain)


@dataclass(frozen=True)
class Plan:
    """What steps are drawn within: samples of length h [s], `reach` to either side of `middle`,
    speed, acceleration, mean rest.
    """

    h: float
    middle: float
    reach: float
    speed: float
    acceleration: float
    rest: float


def move(distance: float, speed: float, acceleration: float, h: float) -> Array:
    """Return a smooth step (samples,) within limits of speed and acceleration.

    Source: flash1985 (minimum-jerk profile: top speed 15/8 D/T, top acceleration 5.7735 D/T^2).
    """
    seconds = max(
        1.875 * abs(distance) / speed, math.sqrt(5.7735 * abs(distance) / acceleration), 8 * h
    )
    s = np.linspace(0.0, 1.0, math.ceil(seconds / h) + 1)
    return np.asarray(distance * (10 * s**3 - 15 * s**4 + 6 * s**5))


def sweep(plan: Plan) -> Array:
    """Return a sine of rising frequency, its acceleration about even where the reach allows it."""
    t = plan.h * np.arange(round(SWEEP_SECONDS / plan.h))
    rate = math.log(max(2.0, min(BAND[1], 0.1 / plan.h) / BAND[0])) / t[-1]
    omega = 2 * math.pi * BAND[0] * np.exp(rate * t)
    size = np.minimum(
        0.3 * plan.reach, np.minimum(plan.speed / omega, plan.acceleration / omega**2)
    )
    fade = np.minimum(1.0, 5.0 * np.minimum(t, t[-1] - t) / t[-1])
    return np.asarray(size * fade**2 * np.sin((omega - omega[0]) / rate))


def steps(rng: np.random.Generator, axis: Axis, plan: Plan, n: int, follow: Follow) -> Array:
    """Return an input (n,) for steps of all sizes and speeds with rests, ramps and sweeps between
    them.

    Each step begins where a model stands at rest after the one before (`follow`): open loop, errors
    of position would add up.
    """
    parts, at, total = [np.zeros(round(0.2 / plan.h))], plan.middle, 0
    while total < n:
        kind = rng.random()
        size = plan.reach * math.exp(rng.uniform(math.log(SHORTEST), 0.0))
        side = float(rng.choice([-1.0, 1.0]))
        if abs(at + side * size - plan.middle) > plan.reach:
            side = -math.copysign(1.0, at - plan.middle)
        if kind < SWEEP_SHARE:
            part = axis.input_for(sweep(plan), plan.h)
        elif kind < SWEEP_SHARE + RAMP_SHARE:
            part = side * ramps(axis, round(RAMP_SECONDS / plan.h), plan.h)
        else:
            quick = rng.uniform(0.15, 1.0)
            part = axis.input_for(
                move(side * size, quick * plan.speed, quick * plan.acceleration, plan.h), plan.h
            )
        part = np.concatenate([part, np.zeros(round(plan.rest * rng.uniform(0.5, 1.5) / plan.h))])
        at = follow(at, part)
        parts.append(part)
        total += len(part)
    return np.concatenate(parts)[:n]


def ramps(axis: Axis, n: int, h: float) -> Array:
    """Return slow ramps of the input through zero, growing until they break the axis loose in both
    directions.
    """
    phase = h * np.arange(n) / RAMP_SECONDS
    triangle = np.interp(phase % 1.0, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])
    peaks = np.interp(np.floor(phase), [0.0, max(1.0, math.floor(phase[-1]))], RAMP_PEAKS)
    return np.asarray(axis.friction / axis.gain * peaks * triangle)


def varied(rng: np.random.Generator, u: Array, n: int, h: float) -> Array:
    """Return a recorded input (n,) played at a pace and size that vary: what repeated one motion
    then shows many.
    """
    t = h * np.arange(n)
    knots = np.arange(0.0, t[-1] + 2 * VARIED_SECONDS, VARIED_SECONDS)
    pace, size = (
        np.interp(t, knots, rng.uniform(*ends, len(knots))) for ends in (VARIED_PACE, VARIED_SIZE)
    )
    return np.asarray(
        size * np.interp(np.cumsum(pace) - pace[0], np.arange(len(u)), u, period=len(u))
    )


@dataclass(frozen=True)
class Input:
    """An input to choose from: the kind of motion, and its values (n,) at one scale or several,
    the strongest first.
    """

    motion: Finding
    scaled: tuple[Array, ...]

    @classmethod
    def at_scales(cls, motion: Finding, u: Array) -> Input:
        """Return an input (n,) at all `INPUT_SCALES`."""
        return cls(motion, tuple(scale * u for scale in INPUT_SCALES))


def inputs(
    axis: Axis,
    limits: Limits,
    recorded: Sequence[Array],
    samples: tuple[int, float],
    follow: Follow,
) -> list[Input]:
    """Return inputs of so many samples of length h [s] to choose from, the same each time; `follow`
    as of `steps`.
    """
    n, h = samples
    spare = min(limits.u[1], -limits.u[0]) * abs(axis.gain) - axis.friction
    proposed = []
    for seed in range(DRAWS if spare > 0 else 0):
        rng = np.random.default_rng(seed)
        plan = planned(rng, axis, limits, spare, h)
        drawn = steps(rng, axis, plan, n, follow)
        proposed.append(Input(finding(Reason.MANY_STEPS), (drawn,)))
    if axis.friction > 0:
        proposed.append(Input.at_scales(finding(Reason.SLOW_RAMPS), ramps(axis, n, h)))
    for u in recorded:
        quick = np.interp(QUICKER * np.arange(int(len(u) / QUICKER)), np.arange(len(u)), u)
        proposed.append(Input.at_scales(finding(Reason.RECORDED_INPUT), np.resize(u, n)))
        proposed.append(Input.at_scales(finding(Reason.QUICKENED_INPUT), np.resize(quick, n)))
        for seed in range(VARIED_DRAWS):
            other = varied(np.random.default_rng(seed), u, n, h)
            proposed.append(Input.at_scales(finding(Reason.VARIED_INPUT), other))
    return proposed


def planned(rng: np.random.Generator, axis: Axis, limits: Limits, spare: float, h: float) -> Plan:
    """Return what steps are drawn within, `spare` being the torque that the input has beyond dry
    friction [N.m].
    """
    torque = rng.uniform(*USED_TORQUE) * spare
    reach = rng.uniform(*USED_RANGE) * 0.5 * (limits.theta[1] - limits.theta[0])
    speed = (1 - ACCELERATING) * torque / axis.damping if axis.damping > 0 else math.inf
    return Plan(
        h,
        limits.middle,
        reach,
        min(speed, reach / (8 * h)),
        ACCELERATING * torque / axis.inertia,
        rng.uniform(*RESTS),
    )
