"""The joint extended Kalman filter as it is commonly set up: constant process noise, the paper's
parameters as entries.

Least squares at high speed give alpha2 and b first; the filter then runs on all parameters, from
position alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import casadi as ca

from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter
from bristle.observer import joint, kalman
from bristle.observer.kalman import MOTION_STATES
from bristle.observer.method import EquationContext, Method, Sample, Update

SX = ca.SX
JOINT_ENTRIES = units("alpha2", "b", "sigma0", "sigma1", "sigma2", "c", "tau")
# round numbers, not taken from a plant
START_VALUES = {"sigma0": 300.0, "sigma1": 0.0, "sigma2": 0.0, "c": 100.0, "tau": 0.0}
SPREADS = (1.0, 1.0, 500.0, 500.0, 500.0, 100.0, 0.01)  # of the entries at the start
LOWEST = {"alpha2": 0.0, "sigma0": 1.0, "c": 1.0, "tau": 0.0}
HIGHEST = {"tau": 1.0}


def _servo(p: Namespace, entries: SX) -> kalman.ServoParameters:
    """Read the parameters as they stand."""
    alpha2, b, *sigma, c, tau = ca.vertsplit(entries)
    return kalman.ServoParameters(alpha2, b, sigma, c, tau, width=p.width)


def _estimates(entries: SX) -> dict[str, SX]:
    found = dict(zip(JOINT_ENTRIES, ca.vertsplit(entries), strict=True))
    return found | {"Fc": found["sigma0"] / ca.fmax(found["c"], LOWEST["c"])}


def _start(p: Namespace, found: Mapping[str, SX]) -> tuple[SX, SX]:
    fixed = (p[f"{name}_start"] for name in START_VALUES)
    return ca.vertcat(found["alpha2"], found["b"], *fixed), SX(ca.DM(SPREADS))


def _predict(p: Namespace, z: SX, covariance: SX, s: Sample) -> tuple[SX, SX]:
    return kalman.predict(partial(_servo, p), z, covariance, s.u, s.period)


def _bounds(p: Namespace) -> tuple[dict[int, SX], dict[int, SX]]:
    place = {name: MOTION_STATES + i for i, name in enumerate(JOINT_ENTRIES)}
    return {place[n]: SX(x) for n, x in LOWEST.items()}, {
        place[n]: SX(x) for n, x in HIGHEST.items()
    }


FILTER = joint.JointFilter(tuple(JOINT_ENTRIES), _servo, _estimates, _start, _predict, _bounds)


def _equations(context: EquationContext, s: Sample) -> Update:
    return joint.update(context, s, FILTER)


METHOD = Method(
    "joint_ekf",
    "joint extended Kalman filter from position with constant noise, after least squares have"
    " converged",
    "jazwinski1970 chapter 8 with the model of dixit2008 eq. (15)-(17)",
    "y_theta",
    (
        *joint.parameters("joint_ekf", 0.1, 10.0, 10.0),
        *(
            Parameter(
                f"joint_ekf.{name}_start",
                name,
                JOINT_ENTRIES[name],
                start,
                -1e9,
                1e9,
                f"start of the estimate of {name}",
                joint.NOISE_CITATION,
            )
            for name, start in START_VALUES.items()
        ),
    ),
    joint.states(FILTER),
    _equations,
)
