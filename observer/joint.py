"""What the joint filters with constant noise share: step 1 before them, their covariance as
standard deviations, and validity.

Least squares at high speed give alpha2, b, Fc and the load torque; when these are known well enough
the filter starts with them. What it claims to know is its covariance, enlarged as much as its
estimates move more than that allows (consistency.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from bristle.model.basis import width_parameter
from bristle.model.variables import Namespace, Parameter, State, declaring
from bristle.observer import consistency, excitation, kalman, rls, smoothing, step1, step2, swapping
from bristle.observer.kalman import MOTION_STATES
from bristle.observer.method import EquationContext, Sample, Update, stack

SX = ca.SX
NOISE_CITATION = "jazwinski1970 chapter 8"
# s, over which the innovations are compared with the sensor: at a start, and late
SENSOR_TIME = (0.3, 20.0)
LARGEST_RATIO = 100.0  # most that one squared innovation counts over the variance of the sensor
PREFIX = "joint_"  # of what consistency.py keeps of the filter, beside what it keeps of step 1
# standard deviation of alpha2 and b over themselves at which the filter begins: it improves them
JOINT_START_SHARE = 0.05
JUDGED_FROM = 5.0  # s after a start from which estimates may be valid


@dataclass(frozen=True)
class JointFilter:
    """A joint filter: its entries behind (theta, v, w), what they mean, where they start, and their
    bounds.

    `start` returns entries and standard deviations, `bounds` the least and the largest value of
    some of them, by place in the vector.
    """

    names: tuple[str, ...]
    servo: Callable[[Namespace, SX], kalman.ServoParameters]
    estimates: Callable[[SX], dict[str, SX]]
    start: Callable[[Namespace, Mapping[str, SX]], tuple[SX, SX]]
    predict: Callable[[Namespace, SX, SX, Sample], tuple[SX, SX]]
    bounds: Callable[[Namespace], tuple[dict[int, SX], dict[int, SX]]]

    @property
    def load(self) -> int | None:
        """Place of the load torque, which may change unseen in rest, among the entries."""
        return self.names.index("load") if "load" in self.names else None

    @property
    def order(self) -> int:
        """Length of the vector."""
        return MOTION_STATES + len(self.names)


@dataclass(frozen=True)
class _Moved:
    """What a sample makes of a filter; `lost`: variance that it took from each entry, `drifted`:
    state of a load that may have changed in rest.
    """

    z: SX
    covariance: SX
    lost: SX
    innovation: SX
    drifted: dict[str, SX]


def update(context: EquationContext, s: Sample, f: JointFilter) -> Update:
    """Advance step 1 and, once it has converged, the filter.

    Source: jazwinski1970 chapter 8; ljung1979 (parameters as states).
    """
    p, h = context.p, s.period
    fields = rls.published(p, h)
    go = step2.begun(p, s, fields, JOINT_START_SHARE)
    runs = p.step2_runs > 0
    moved = _moved(p, s, f, runs)
    # until it begins it waits where it would start
    entries, spread = f.start(p, fields["estimates"])
    waiting = ca.vertcat(s.y1 + p.resolution / 2, p.last_v, 0, entries)
    level = ca.fabs(fields["estimates"]["Fc"])
    motion = ca.vertcat(p.resolution, 0.5 * ca.fabs(p.last_v) + 1, level + 1)
    uncertain = ca.diag(ca.vertcat(motion, spread) ** 2)
    velocity, beside = smoothing.smooth(p, s)
    beside |= step2.observe(context, velocity, step2.known(fields), step2.from_position(p, s))
    now = kalman.read(p, f.order)[0]
    return Update(
        next={
            **rls.fit(p, s),
            **beside,
            **kalman.write(
                ca.if_else(runs, moved.z, waiting), ca.if_else(runs, moved.covariance, uncertain)
            ),
            **consistency.blocks(
                p, moved.z[MOTION_STATES:], moved.lost, (p.age, h, runs), prefix=PREFIX
            ),
            **{
                f"spread{i}": ca.if_else(runs, p[f"spread{i}"], spread[i])
                for i in range(len(f.names))
            },
            "age": ca.if_else(runs, p.age + h, 0),
            "innovation_sensor": ca.if_else(runs, moved.innovation, 1),
            "step2_runs": go,
            **moved.drifted,
        },
        **_published(p, s, f, fields),
        signals=kalman.signals(now, f.servo(p, now[MOTION_STATES:])),
        first={"joint0": s.y1},
    )


def _moved(p: Namespace, s: Sample, f: JointFilter, runs: SX) -> _Moved:
    """Advance the filter by a sample: prediction, correction, bounds.

    Source: jazwinski1970 chapter 8.
    """
    h = s.period
    now, uncertainty = kalman.read(p, f.order)
    z, covariance = f.predict(p, now, uncertainty, s)
    noise = p.noise_parameters * stack(p, "spread", len(f.names)) ** 2
    rates = ca.vertcat(0, p.noise_v, p.noise_w, noise)
    quantum = kalman.rounding(p.resolution)
    error = s.y1 + p.resolution / 2 - z[0]
    before = kalman.noisy(covariance, ca.vertsplit(rates), h)
    # the load may have changed in rest
    rests = p.rest >= excitation.FRESH_TIME
    drifted: dict[str, SX] = {}
    if f.load is not None:
        before = kalman.moved_again(before, ca.if_else(rests, 0, p.drifted), MOTION_STATES + f.load)
        square = f.estimates(now[MOTION_STATES:])["Fc"] ** 2
        drifted["drifted"] = ca.if_else(runs, excitation.drifted(p.drifted, rests, square, h), 0)
    z, covariance, size = kalman.correct(z, before, error, quantum, p.gate)
    counted = (before[0, 0] + quantum) * ca.fmax(1, size / p.gate**2)
    lost = before[MOTION_STATES:, 0] ** 2 / counted
    # the innovations of late, over the variance of the sensor
    first, last = SENSOR_TIME
    share = h / (first + ca.fmin(p.age, last))
    ratio = ca.fmin(error**2 / quantum, LARGEST_RATIO)
    innovation = p.innovation_sensor + share * (ratio - p.innovation_sensor)
    return _Moved(
        kalman.bounded(z, covariance, *f.bounds(p)), covariance, lost, innovation, drifted
    )


def _published(
    p: Namespace, s: Sample, f: JointFilter, fields: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the fields of an `Update`; an estimate is valid while the innovations are about what
    the sensor explains.

    The doubts of the least squares of step 2, on the same record, are added to those of the filter.
    Source: jazwinski1970 chapter 8; mehra1970.
    """
    z, covariance = kalman.read(p, f.order)
    factors = ca.diag(consistency.inflation(p, len(f.names), PREFIX))
    spread = factors @ covariance[MOTION_STATES:, MOTION_STATES:] @ factors
    if f.load is not None:
        spread[f.load, f.load] = spread[f.load, f.load] + p.drifted
    entries = z[MOTION_STATES:]
    estimates = f.estimates(entries)
    sd = kalman.deviations(f.estimates, entries, spread)
    sound = ca.logic_and(p.age > JUDGED_FROM, p.innovation_sensor < p.innovation_limit)
    common = {name: x for name, x in estimates.items() if name != "tau"}
    judged = swapping.worth(p, step2.COMPANION, common, step2.from_position(p, s))
    sd |= {
        name: ca.sqrt(sd[name] ** 2 + judged.sd[name] ** 2) for name in sd if name in judged.limits
    }
    sound = ca.logic_and(sound, judged.possible)
    limits = {name: step1.VALID_SHARE * swapping.size_of(estimates, name) for name in estimates}
    return {
        "estimates": estimates,
        "sd": sd,
        "valid": {name: ca.logic_and(sound, sd[name] < limit) for name, limit in limits.items()},
        "adapted": ca.logic_or(p.age > 0, fields["adapted"]),
        "innovation": ca.if_else(p.age > 0, p.innovation_sensor, 0),
    }


def parameters(prefix: str, noise_v: float, noise_w: float, limit: float) -> tuple[Parameter, ...]:
    """Declare sensor, step 1, noise and the width of the basis functions under a method's name."""
    most = "mean squared innovation over the variance of the sensor up to which estimates are valid"
    share = "process noise of a parameter over its sd at the start"
    own, checked = declaring(prefix, NOISE_CITATION), declaring(prefix, "mehra1970")
    return (
        *kalman.parameters(prefix),
        *rls.parameters(prefix),
        width_parameter(prefix),
        step2.start_parameter(prefix),
        smoothing.parameter(prefix),
        own("noise_v", "q_v", "rad2/s3", (noise_v, 0.0, 1e9), "process noise of v"),
        own("noise_w", "q_w", "rad2/s5", (noise_w, 0.0, 1e9), "process noise of w"),
        own("noise_parameters", "q_p", "1/s", (1e-7, 0.0, 1.0), share),
        checked("innovation_limit", "r_v", "1", (limit, 1.0, 1e12), most),
    )


def states(f: JointFilter) -> tuple[State, ...]:
    """Declare step 1, vector and covariance, and how far the filter can be trusted."""
    n = len(f.names)
    return (
        *rls.STATES,
        *kalman.states(f"theta, v, w, {', '.join(f.names)}", "covariance of the vector", f.order),
        *consistency.states(n, PREFIX),
        *(
            State(f"spread{i}", "1", f"standard deviation of {name} at the start")
            for i, name in enumerate(f.names)
        ),
        State("age", "s", "time since the filter began"),
        State(
            "innovation_sensor",
            "1",
            "mean squared innovation over the variance of the sensor, of late",
            initial=1.0,
        ),
        *((excitation.drifted_state(),) if f.load is not None else ()),
        *step2.SMOOTHING_STATES,
        *step2.STATES,
    )
