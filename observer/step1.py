"""What all methods of step 1 share beside their laws: the companion, which also finds a load torque
and a delay.

Above the gate, all filtered alike: v' = -alpha2 v + b u(t - d) - Fc sgn v + load, and what friction
still falls with speed. Source: dixit2008 eq. (23), with a constant load and b u(t - d) = b u - b d
u' to first order.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import excitation
from bristle.observer.companion import Companion, Row
from bristle.observer.method import LARGEST_SD, Sample

SX = ca.SX
COMPANION = Companion(("alpha2", "b", "Fc", "load", "late_drive"), extra=1)  # the last is -b d
GATE_SHARE = 0.7  # of the rms speed in motion, above which samples count
LEAST_SPEED = 1e-9  # rad/s, below which nothing moves
MEMORY = 100.0  # s, in which the companion of a gradient law forgets
GATE_POWER = 4  # power of the gate with which a sample counts that came from a lower one
VALID_SHARE = 0.08  # standard deviation of a valid estimate over its size, of the load over Fc
LOAD_ENTRY = COMPANION.names.index("load")
STATES = (
    *excitation.STATES,
    *COMPANION.states,
    State("gate_reached", "rad/s", "highest gate of a sample that counted", initial=LEAST_SPEED),
)
VALID_DELAY = 0.1  # samples, standard deviation of a valid delay
IMPOSSIBLE_BY = 2.0  # standard deviations below zero at which a friction refutes the model
LONGEST_FOUND = 1e3  # samples, beyond which a delay is no delay
SMALLEST_DRIVE = 1e-9  # rad/(s2.V), keeps a division by b defined


def gate_parameter(prefix: str, vc: float = 0.0) -> Parameter:
    """Declare the gate in rad/s under a method's name."""
    text = f"speed above which step 1 adapts; 0: {GATE_SHARE:g} of the rms speed in motion so far"
    return Parameter(f"{prefix}.vc", "vc", "rad/s", vc, 0.0, 1e3, text, "dixit2008 eq. (23)")


def speed_gate(p: Namespace, noise: SX) -> SX:
    """Return the speed above which samples count: `vc`, or a share of the rms speed in motion so
    far, above the sensor's noise.
    """
    own = ca.fmax(ca.fmax(GATE_SHARE * excitation.rms_speed(p), noise), LEAST_SPEED)
    return SX(ca.if_else(p.vc > 0, p.vc, own))


def kept(s: Sample) -> SX:
    """Return the share that a sample leaves of what was known, for laws without memory."""
    return SX(ca.exp(-s.period / MEMORY))


def fit(p: Namespace, sample: Row, gate: SX, kept: SX, period: SX) -> dict[str, SX]:
    """Return the next states of the companion; what came from below the highest gate so far is
    forgotten as that rises.

    `kept`: share that a sample leaves of what was known.
    """
    reached = {
        "gate_reached": ca.fmax(p.gate_reached, ca.if_else(sample.counts, gate, LEAST_SPEED))
    }
    return COMPANION.advance(p, sample, kept * left(p, reached), period) | reached


def left(p: Namespace, shared: Mapping[str, SX]) -> SX:
    """Return the share of what was known that a rise of the gate leaves; `shared`: next states of
    the methods of step 1.
    """
    return SX((p.gate_reached / shared["gate_reached"]) ** GATE_POWER)


def falling(speed: SX, gate: SX) -> SX:
    """Return a friction that falls with the inverse square of the speed above the gate, over its
    value at the gate.
    """
    return SX((gate / ca.fmax(ca.fabs(speed), gate)) ** 2)


def delay_deviation(sd: SX, b: SX, sd_b: SX) -> SX:
    """Return the standard deviation of a delay for the one at this b; where b may be 0, the delay
    may be anything.
    """
    return SX(ca.if_else(ca.fabs(b) > IMPOSSIBLE_BY * sd_b, sd, LARGEST_SD))


def delay_limit(delay: SX, sd: SX) -> SX:
    """Return up to which standard deviation a delay is valid: none where it is surely negative."""
    return SX(ca.if_else(delay > -IMPOSSIBLE_BY * sd, VALID_DELAY, 0))


def published(p: Namespace, own: Mapping[str, SX], period: SX) -> dict[str, Any]:
    """Return the fields of an `Update` for a method's own estimates; load and delay are the
    companion's where it has none.

    A least squares whose friction is negative for sure refutes the model, and then nothing is
    valid.
    """
    fitted = COMPANION.narrow(p)
    spread, found = COMPANION.deviations(p, fitted), fitted | dict(own)
    possible = SX(1)
    for name in ("alpha2", "Fc"):
        possible = ca.logic_and(possible, fitted[name] > -IMPOSSIBLE_BY * spread[name])
    missed = {name: COMPANION.misfit(p, name) for name in found}
    sd = {
        name: ca.sqrt(each**2 + missed[name] ** 2)
        for name, each in COMPANION.deviations(p, found).items()
    }
    alpha2, b, friction, load, late = (found[name] for name in COMPANION.names)
    samples = b / (b**2 + SMALLEST_DRIVE**2) / period
    delay = ca.fmax(ca.fmin(-late * samples, LONGEST_FOUND), -LONGEST_FOUND) + p.delay
    sd["delay"] = delay_deviation(sd.pop("late_drive") * ca.fabs(samples), b, sd["b"])
    sizes = {"alpha2": alpha2, "b": ca.fabs(b), "Fc": friction, "load": friction}
    limits = {name: VALID_SHARE * size for name, size in sizes.items()} | {
        "delay": delay_limit(delay, sd["delay"])
    }
    estimates = {"alpha2": alpha2, "b": b, "Fc": friction, "load": load, "delay": delay}
    return {"estimates": estimates, **COMPANION.judge(p, sd, limits, possible)}
