"""The joint filter of servo and friction, shared by the extended Kalman filters: states and
parameters as one vector.

The vector is (theta, v, w) and seven entries that say what the parameters are; only position is
measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import casadi as ca

from bristle.model.basis import BASIS_COUNT, gaussian
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer.method import (
    delayed,
    stack,
    stack_symmetric,
    symmetric_states,
    unstack,
    unstack_symmetric,
    vector_states,
)

SX = ca.SX
MOTION_STATES = 3  # theta, v, w
# alpha2, b, tau, c and one weight more than there are basis functions
JOINT_ORDER = MOTION_STATES + 5 + BASIS_COUNT
CITATION = "jazwinski1970 chapter 8"
# internal steps a sample; with one, the model error would bias the parameters measurably
SUBSTEPS = 4


@dataclass(frozen=True)
class ServoParameters:
    """The parameters of the modified model with bristle damping, as expressions of the entries."""

    alpha2: SX
    b: SX
    sigma: Sequence[SX]
    c: SX
    tau: SX
    load: SX = field(default_factory=lambda: SX(0))  # rad/s2, load torque over the inertia
    delay: SX = field(default_factory=lambda: SX(0))  # samples
    width: SX = field(default_factory=lambda: SX(1))  # of the basis functions, over the nominal one

    def push(self, inputs: SX) -> SX:
        """Return the acceleration by drive and load, from the last inputs, the latest first."""
        return SX(self.b * delayed(ca.vertsplit(inputs), self.delay) + self.load)

    def gain(self, v: SX) -> SX:
        """Return K(v) = sigma0 + sum sigma_i phi_i(v)."""
        return self.sigma[0] + sum(
            s * phi for s, phi in zip(self.sigma[1:], gaussian(v / self.width), strict=True)
        )

    def friction(self, v: SX, w: SX) -> SX:
        """Return the friction acceleration w + tau w' + alpha2 v, w' = K(v) v - c |v| w."""
        return w + self.tau * (self.gain(v) * v - self.c * ca.fabs(v) * w) + self.alpha2 * v


def resolution_parameter(prefix: str) -> Parameter:
    """Declare the sensor's step under a method's name."""
    step = "step of the position sensor; 0: none"
    return Parameter(
        f"{prefix}.resolution",
        "LSB",
        "rad",
        2 * math.pi / 40000,
        0.0,
        1.0,
        step,
        "dixit2008 section IV-A",
    )


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare the parameters of the sensor."""
    most = (
        "largest error that counts in full, in standard deviations; a larger one e counts as g^2/e"
    )
    return (
        resolution_parameter(prefix),
        Parameter(f"{prefix}.gate", "g", "1", 3.0, 0.1, 1e6, most, "huber1981"),
    )


def states(
    vector: str, covariance: str, order: int, spreads: Sequence[float] = ()
) -> tuple[State, ...]:
    """Declare the vector and its covariance, from these standard deviations or from zero."""
    squares = [spread**2 for spread in spreads]
    return (
        *vector_states("joint", "1", vector, order),
        *symmetric_states("cov", "1", covariance, order, squares),
    )


def read(p: Namespace, order: int) -> tuple[SX, SX]:
    """Return (vector, covariance)."""
    return stack(p, "joint", order), stack_symmetric(p, "cov", order)


def write(z: SX, covariance: SX) -> dict[str, SX]:
    """Return vector and covariance as states."""
    return unstack("joint", z) | unstack_symmetric("cov", covariance)


def signals(z: SX, servo: ServoParameters) -> dict[str, SX]:
    """Return position, velocity and friction from the vector."""
    return {"theta": z[0], "v": z[1], "w": z[2], "F": servo.friction(z[1], z[2])}


def rounding(resolution: SX) -> SX:
    """Return the variance of a position that is rounded to a grid, evenly distributed; of 1e-6 rad
    if there is none.

    Source: widrow2008 chapter 1.
    """
    return SX(ca.fmax(resolution, 1e-6) ** 2 / 12)


def advance(x: SX, servo: ServoParameters, push: SX, h: SX) -> SX:
    """Advance (theta, v, w) over a sample of held acceleration by drive and load; accurate to
    second order.

    w relaxes exactly at the mean velocity, however large c |v| h. What tau w' adds to v over the
    sample is tau times the change of w. Source: dixit2008 eq. (15) and (17), tau after remark 5;
    hochbruck2010 section 2 (exponential step).
    """
    theta, v, w = ca.vertsplit(x)
    mean = v + h / 2 * (push - servo.friction(v, w))
    travel = ca.fmax(servo.c * ca.fabs(mean) * h, 1e-9)
    kept = ca.exp(-travel)
    w_new = w * kept + h * servo.gain(mean) * mean * (1 - kept) / travel
    damping = servo.alpha2 * h / 2
    v_new = (v * (1 - damping) + h * (push - (w + w_new) / 2) - servo.tau * (w_new - w)) / (
        1 + damping
    )
    return ca.vertcat(theta + h / 2 * (v + v_new), v_new, w_new)


def sample(x: SX, servo: ServoParameters, inputs: SX, h: SX) -> SX:
    """Advance (theta, v, w) over a sample in `SUBSTEPS` steps."""
    push = servo.push(inputs)
    for _ in range(SUBSTEPS):
        x = advance(x, servo, push, h / SUBSTEPS)
    return x


def moved_again(covariance: SX, variance: SX, load: int) -> SX:
    """Return P at the end of a rest in which the load may have changed by that variance: the
    bristle has held it.

    `load`: its place in the vector, as an acceleration. Source: jazwinski1970 chapter 8.
    """
    new, w = SX(covariance), MOTION_STATES - 1
    for i, j in ((w, w), (w, load), (load, w), (load, load)):
        new[i, j] = new[i, j] + variance
    return new


def deviations(
    estimates: Callable[[SX], dict[str, SX]], entries: SX, covariance: SX
) -> dict[str, SX]:
    """Return the standard deviations, to first order, of estimates that are functions of entries
    with this covariance.

    Source: jazwinski1970 chapter 8.
    """
    symbol = SX.sym("entries", entries.numel())
    found = estimates(symbol)
    slopes = ca.substitute(ca.jacobian(ca.vertcat(*found.values()), symbol), symbol, entries)
    return {
        name: ca.sqrt(ca.fmax(ca.dot(slopes[i, :].T, covariance @ slopes[i, :].T), 0))
        for i, name in enumerate(found)
    }


def predict(
    meaning: Callable[[SX], ServoParameters], z: SX, covariance: SX, inputs: SX, h: SX
) -> tuple[SX, SX]:
    """Return (z, P) at the end of a sample, without noise; the entries behind the states stay.

    Source: jazwinski1970 chapter 8 (extended Kalman filter).
    """
    symbol = SX.sym("z", z.numel())
    moved = sample(symbol[:MOTION_STATES], meaning(symbol[MOTION_STATES:]), inputs, h)
    moved, slope = ca.substitute([moved, ca.jacobian(moved, symbol)], [symbol], [z])
    crossed = slope @ covariance
    new = SX(covariance)
    new[:MOTION_STATES, MOTION_STATES:], new[MOTION_STATES:, :MOTION_STATES] = (
        crossed[:, MOTION_STATES:],
        crossed[:, MOTION_STATES:].T,
    )
    new[:MOTION_STATES, :MOTION_STATES] = crossed @ slope.T
    return ca.vertcat(moved, z[MOTION_STATES:]), new


def correct(z: SX, covariance: SX, error: SX, variance: SX, gate: SX) -> tuple[SX, SX, SX]:
    """Return (z, P, squared error over its variance) after a position whose prediction was wrong by
    `error`.

    An error of e standard deviations beyond `gate` counts as gate^2 / e: less, the further it is
    out. Source: jazwinski1970 chapter 8; huber1981 (influence that redescends).
    """
    expected = covariance[0, 0] + variance
    size = error**2 / expected
    gain = covariance[:, 0] / (expected * ca.fmax(1, size / gate**2))
    return z + gain * error, covariance - gain @ covariance[0, :], size


def noisy(covariance: SX, rates: Sequence[SX], h: SX) -> SX:
    """Return P with what the process noise of each entry adds over a sample."""
    return covariance + h * ca.diag(ca.vertcat(*rates))


def bounded(z: SX, covariance: SX, low: dict[int, SX], high: dict[int, SX]) -> SX:
    """Return z with some entries kept inside their bounds, and the others moved as the covariance
    relates them.

    An entry that was set back alone would leave the others where they had followed it: a bias that
    grows with each sample. Source: simon2010 section 3 (projection of the estimate, weighted by the
    inverse covariance).
    """
    new = SX(z)
    for i in sorted({*low, *high}):
        kept = ca.fmin(ca.fmax(new[i], low.get(i, -ca.inf)), high.get(i, ca.inf))
        new += covariance[:, i] * ((kept - new[i]) / ca.fmax(covariance[i, i], 1e-300))
        new[i] = kept
    return new
