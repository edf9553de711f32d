"""What all methods of Approach II share beside their laws: when step 2 begins, and what its
estimates are worth.

Beside the method runs filtered Approach I (swapping.py) on the same velocity and input, with alpha2
and b as step 1 knows them: not exactly, but with a standard deviation. So it knows what an error of
alpha2 or b, a load torque and a delay do to sigma_i and c, and the distance of a method's estimates
from it shows what they do to the method. Source: dixit2008 section III, Approach II; ljung1999
section 11.2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import kalman, rls, smoothing, step1, swapping
from bristle.observer.method import EquationContext, Sample, Update

SX = ca.SX
COMPANION = swapping.companion("step2_")
CORNER = 15.0  # rad/s, of the filter of the companion
# standard deviation of alpha2 and b over themselves at which step 1 has converged
START_SHARE = 0.01
VELOCITY_NOISE = 1e-3  # rad/s, standard deviation of a measured velocity
COMPANION_STATES = (
    *swapping.FILTER_STATES,
    *COMPANION.states,
    State("step2_u", "V", "input before"),
)
STATES = (*COMPANION_STATES, State("step2_runs", "1", "1 once step 2 has begun"))
SMOOTHING_STATES = tuple(state for state in smoothing.STATES if state not in rls.STATES)
ENCODER_STATES = (*rls.STATES, *SMOOTHING_STATES, *STATES)  # of `from_encoder`


@dataclass(frozen=True)
class Law:
    """A law of step 2 at a sample: its next states, what they are before it begins, and what it
    publishes.

    `first`: values of states at the very first sample.
    """

    next: dict[str, SX]
    waiting: dict[str, SX]
    estimates: dict[str, SX]
    signals: dict[str, SX]
    first: dict[str, SX] = field(default_factory=dict)


def start_parameter(prefix: str) -> Parameter:
    """Declare after which time in motion step 2 begins at the latest."""
    text = "step 2 begins when step 1 has converged, and after this time in motion at the latest"
    return Parameter(
        f"{prefix}.longest_wait", "T2", "s", 100.0, 0.0, 1e6, text, "dixit2008 section IV-E"
    )


def begun(
    p: Namespace, s: Sample, step1_fields: Mapping[str, Any], share: float = START_SHARE
) -> SX:
    """Return 1 from the start of step 2 on: alpha2 and b are known to this share, or the servo has
    moved for long enough.
    """
    known = step1_fields["adapted"]
    for name in ("alpha2", "b"):
        size = ca.fabs(step1_fields["estimates"][name])
        known = ca.logic_and(known, step1_fields["sd"][name] < share * size)
    # nothing is learnt in rest
    waited = ca.logic_and(step1_fields["adapted"], p.travelled >= p.longest_wait)
    return SX(ca.logic_or(p.step2_runs > 0, ca.logic_or(known, waited)))


def when(go: SX, update: dict[str, SX], rest: Mapping[str, SX]) -> dict[str, SX]:
    """Return the update while step 2 runs and `rest` before, together with whether it runs."""
    return {name: ca.if_else(go, value, rest[name]) for name, value in update.items()} | {
        "step2_runs": go
    }


def known(fields: Mapping[str, Any]) -> swapping.Prior:
    """Return what step 1 knows of alpha2 and b."""
    found, sd = fields["estimates"], fields["sd"]
    return swapping.Prior(found["alpha2"], found["b"], (sd["alpha2"], sd["b"]))


def from_velocity(s: Sample, noise: SX | float = VELOCITY_NOISE) -> swapping.Settings:
    """Return the settings of the companion for a measured velocity with that standard deviation."""
    return swapping.Settings(SX(CORNER), SX(step1.MEMORY), SX(noise) ** 2, s.period)


def from_position(p: Namespace, s: Sample) -> swapping.Settings:
    """Return the settings of the companion for a velocity that is smoothed from positions."""
    noise = smoothing.rounding_noise(p.resolution, p.smoothing, s.period)
    return swapping.Settings(SX(CORNER), SX(step1.MEMORY), noise, smoothing.lag(p, s))


def observe(
    context: EquationContext, s: Sample, prior: swapping.Prior | None, given: swapping.Settings
) -> dict[str, SX]:
    """Return the next states of the companion for a sample of velocity."""
    p = context.p
    change = s.u - p.step2_u
    ends = (
        swapping.signals(s.u, change, s.y0, p.width),
        swapping.signals(s.u, change, s.y1, p.width),
    )
    return swapping.observe(context, s, ends, given, COMPANION, prior) | {"step2_u": s.u}


def published(
    p: Namespace, step1_fields: Mapping[str, Any], own: Mapping[str, SX], given: swapping.Settings
) -> dict[str, Any]:
    """Return the fields of an `Update`: those of step 1, and the method's own estimates of step 2.

    A load torque is that of step 2, which sees it in all motion.
    """
    later = swapping.judge(p, COMPANION, swapping.worth(p, COMPANION, own, given), own)
    begun = p.step2_runs > 0
    return {
        "estimates": {**step1_fields["estimates"], **own},
        "sd": {**step1_fields["sd"], **later["sd"]},
        "valid": {
            **step1_fields["valid"],
            **{name: ca.logic_and(begun, each) for name, each in later["valid"].items()},
        },
        "adapted": step1_fields["adapted"],
        "innovation": ca.if_else(begun, later["innovation"], step1_fields["innovation"]),
    }


def from_encoder(
    context: EquationContext, s: Sample, law: Callable[[Sample, SX, SX], Law]
) -> Update:
    """Run least squares as step 1 and, on its alpha2 and b, the law of step 2 on smoothed velocity.

    Source: dixit2008 section III, Approach II and the remark on position measurement at its end.
    """
    p = context.p
    step1_fields = rls.published(p, s.period)
    velocity, filters = smoothing.smooth(p, s)
    own = law(velocity, *(step1_fields["estimates"][name] for name in ("alpha2", "b")))
    given = from_position(p, s)
    beside = observe(context, velocity, known(step1_fields), given)
    return Update(
        next=rls.fit(p, s)
        | filters
        | beside
        | when(begun(p, s, step1_fields), own.next, own.waiting),
        **published(p, step1_fields, own.estimates, given),
        signals=own.signals,
        first=own.first,
    )


def encoder_parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare what `from_encoder` needs under a method's name."""
    return (
        start_parameter(prefix),
        kalman.resolution_parameter(prefix),
        *rls.parameters(prefix),
        smoothing.parameter(prefix),
    )


def alone(
    context: EquationContext, s: Sample, own: Mapping[str, SX], given: swapping.Settings
) -> tuple[dict[str, SX], dict[str, Any]]:
    """Return (next states of the companion, fields of an `Update`) of a method that is given alpha2
    and b.

    The companion is not given them, so that it shows what wrong ones do to the method.
    """
    p = context.p
    judged = swapping.judge(p, COMPANION, swapping.worth(p, COMPANION, own, given), own)
    return observe(context, s, None, given), {"estimates": dict(own), **judged}
