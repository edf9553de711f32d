"""The joint unscented Kalman filter: the model of the extended one, carried by points in the place
of derivatives.

Its entries are the friction levels G_i = sigma_i / c and ln c, as in self_starting_ekf, tau and a
load torque; noise is constant as in joint_ekf.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from bristle.model.variables import Namespace, Parameter
from bristle.observer import information, joint, kalman
from bristle.observer.kalman import MOTION_STATES
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX
UKF_ENTRIES = ("alpha2", "b", "G0", "G1", "G2", "ln c", "tau", "load")
SMALLEST_LEVEL = 0.1  # of Coulomb friction at the start, the least that its estimate may be
LN_C_SD = 1.5  # standard deviation of ln c at the start
SHARES = {"alpha2": 0.5, "b": 0.2, "load": 0.3}  # sd at the start over alpha2, over b, over Fc
LARGEST_LN_C = 14.0  # of c in 1/rad
LONGEST_TAU = 1.0  # s


def _servo(p: Namespace, entries: SX) -> kalman.ServoParameters:
    """Read the parameters from (alpha2, b, G0, G1, G2, ln c, tau, load)."""
    alpha2, b, *levels, ln_c, tau, load = ca.vertsplit(entries)
    c = ca.exp(ca.fmin(ln_c, LARGEST_LN_C))
    return kalman.ServoParameters(
        alpha2, b, [c * level for level in levels], c, ca.fmax(tau, 0), load, width=p.width
    )


def _estimates(entries: SX) -> dict[str, SX]:
    """Return the parameters; Coulomb friction is the level at high speed, where no basis function
    is left.
    """
    alpha2, b, *levels, ln_c, tau, load = ca.vertsplit(entries)
    c = ca.exp(ca.fmin(ln_c, LARGEST_LN_C))
    sigma = {f"sigma{i}": c * level for i, level in enumerate(levels)}
    return {"alpha2": alpha2, "b": b, "Fc": levels[0], **sigma, "c": c, "tau": tau, "load": load}


def _start(p: Namespace, found: Mapping[str, SX]) -> tuple[SX, SX]:
    """Return entries and standard deviations at the start, by what step 1 has found."""
    level = ca.fmax(found["Fc"], ca.fabs(found["Fc"]) * SMALLEST_LEVEL + 1e-9)
    entries = ca.vertcat(
        found["alpha2"], found["b"], level, 0, 0, ca.log(p.c_start), 0, found["load"]
    )
    alpha2, b = SHARES["alpha2"] * ca.fabs(found["alpha2"]), SHARES["b"] * ca.fabs(found["b"])
    return entries, ca.vertcat(
        alpha2, b, level, level, level, LN_C_SD, p.tau_spread, SHARES["load"] * level
    )


def _predict(p: Namespace, z: SX, covariance: SX, s: Sample) -> tuple[SX, SX]:
    """Return (z, P) at the end of a sample, without process noise, from the ends of 2 n + 1 points.

    The points lie `spread` standard deviations off along the columns of a triangular root of P. The
    covariance is taken about the end of the point in the middle, whose weight may be negative: so
    it stays positive. Entries behind the states stay. Source: julier2004; wan2000 (states and
    parameters as one vector).
    """
    factors, n = information.Factors(covariance), z.numel()
    weight = 1 / (2 * p.spread**2)

    def moved(point: SX) -> SX:
        return kalman.sample(point[:MOTION_STATES], _servo(p, point[MOTION_STATES:]), s.u, s.period)

    middle = moved(z)
    mean, states, crossed = (
        middle,
        SX(MOTION_STATES, MOTION_STATES),
        SX(MOTION_STATES, n - MOTION_STATES),
    )
    for j in range(n):
        root = ca.sqrt(ca.fabs(factors.d[j])) * ca.vertcat(
            *([SX(0)] * j), 1, *(factors.l[i][j] for i in range(j + 1, n))
        )
        for step in (p.spread * root, -p.spread * root):
            off = moved(z + step) - middle
            mean = mean + weight * off
            states = states + weight * off @ off.T
            crossed = crossed + weight * off @ step[MOTION_STATES:].T
    new = SX(covariance)
    new[:MOTION_STATES, :MOTION_STATES] = states
    new[:MOTION_STATES, MOTION_STATES:], new[MOTION_STATES:, :MOTION_STATES] = crossed, crossed.T
    return ca.vertcat(mean, z[MOTION_STATES:]), new


def _bounds(p: Namespace) -> tuple[dict[int, SX], dict[int, SX]]:
    places = {name: MOTION_STATES + i for i, name in enumerate(UKF_ENTRIES)}
    # the level of Coulomb friction at the start is its standard deviation there
    least = SMALLEST_LEVEL * p.spread2
    return {
        places["alpha2"]: SX(0),
        places["G0"]: least,
        places["ln c"]: SX(0),
        places["tau"]: SX(0),
    }, {
        places["ln c"]: SX(LARGEST_LN_C),
        places["tau"]: SX(LONGEST_TAU),
    }


FILTER = joint.JointFilter(UKF_ENTRIES, _servo, _estimates, _start, _predict, _bounds)


def _equations(context: EquationContext, s: Sample) -> Update:
    return joint.update(context, s, FILTER)


METHOD = Method(
    "joint_ukf",
    "joint unscented Kalman filter from position with constant noise, after least squares have"
    " converged",
    "julier2004, wan2000 with the model of dixit2008 eq. (15)-(17)",
    "y_theta",
    (
        *joint.parameters("joint_ukf", 1e-3, 1.0, 4.0),
        Parameter(
            "joint_ukf.tau_spread",
            "sd(tau)",
            "s",
            0.01,
            0.0,
            1.0,
            "how far tau may be from 0 at first",
            joint.NOISE_CITATION,
        ),
        Parameter(
            "joint_ukf.c_start",
            "c",
            "1/rad",
            100.0,
            1.0,
            1e6,
            "start of the estimate of c",
            "dixit2008 eq. (17)",
        ),
        Parameter(
            "joint_ukf.spread",
            "s",
            "1",
            1.7320508,
            1e-3,
            10.0,
            "distance of the points in standard deviations",
            "julier2004",
        ),
    ),
    joint.states(FILTER),
    _equations,
)
