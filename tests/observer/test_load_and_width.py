"""What step 2 finds beside the friction parameters, and what it is told: a load torque, and the
width of the basis functions.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.loop import simulate
from bristle.model.basis import gaussian
from bristle.model.native import Native
from bristle.observer import methods, observer_program

STEP = 1e-3
COUNT = 2 * np.pi / 40000  # rad
TRUE = {"sigma0": 600.0, "sigma1": 800.0, "sigma2": 300.0, "c": 150.0}
KNOWN = (
    "besancon",
    "martinez_poznyak",
    "drem",
    "swapped_known",
    "martinez_poznyak_position",
    "drem_position",
    "swapped_position",
    "two_step_martinez",
    "two_step_drem",
    "joint_ukf",
)


@cache
def record(torque: float = 0.0, width: float = 1.0) -> dict[str, np.ndarray]:
    """Return 60 s of set S under the reference controller, with a load torque [N.m] and a width of
    the basis functions.
    """
    plant = BusUnit("plant", Fmu(obtain("plant", law="modified")), {"modified.width": width})
    controller = BusUnit("controller", Fmu(obtain("controller")), {"seed": 3.0, "order": 2.0})
    links = ((("controller", "u"), ("plant", "u")), (("plant", "v"), ("controller", "y_v")))
    names = (("controller", "u"), ("plant", "theta"), ("plant", "v"))
    events = ((0, ("plant", "tau_load"), torque),)
    trace = simulate(Bus((plant, controller), 60_000, STEP, links, events, record=names))
    assert trace.failure is None
    u, theta, v = (np.ascontiguousarray(trace[port]) for port in names)
    return {"u": u, "y_theta": np.floor(theta / COUNT) * COUNT, "y_v": v}


def found(method: str, data: dict[str, np.ndarray], **given: float) -> dict[str, float]:
    """Return the last estimates, with alpha2 and b given."""
    known = {
        p.name: {"alpha2": 2.0, "b": 6.5}[p.symbol]
        for p in methods()[method].parameters
        if "known" in p.description
    }
    parameters = known | {f"{method}.{name}": value for name, value in given.items()}
    names = [*TRUE, "load"]
    out, _ = Native(observer_program(method), parameters).run(
        STEP, data, [f"{name}_hat" for name in names]
    )
    return dict(zip(names, out[-1], strict=True))


def worst(estimates: dict[str, float]) -> float:
    """Return the largest error in %."""
    return max(abs(100 * (estimates[name] / true - 1)) for name, true in TRUE.items())


LIMIT = {
    "besancon": 12.0,
    "martinez_poznyak_position": 4.0,
    "drem_position": 8.0,
    "swapped_position": 4.0,
    "two_step_martinez": 4.0,
    "two_step_drem": 8.0,
    "joint_ukf": 3.0,
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", KNOWN)
def test_a_load_torque_is_found_and_costs_no_accuracy(method):
    """A tenth of Coulomb friction, 4 rad/s2."""
    estimates = found(method, record(torque=0.0004))
    assert estimates["load"] == pytest.approx(0.4, abs=0.02)
    assert worst(estimates) < LIMIT.get(method, 1.0)
    assert found(method, record())["load"] == pytest.approx(0.0, abs=0.02)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ["martinez_poznyak", "drem", "swapped", "swapped_known"])
def test_the_width_of_the_basis_functions_can_be_told(method):
    data = record(width=2.0)
    assert worst(found(method, data, width=2.0)) < 1.5
    assert worst(found(method, data)) > 15.0


def test_the_width_of_a_plant_moves_centres_and_widths():
    """Its own formula, in degrees; without the bars the second function is not even."""
    v = np.linspace(-200, 200, 81)

    def shapes(width, speed):
        return np.exp(-((v / (10 * width)) ** 2)), np.exp(
            -(((speed - 20 * width) / (20 * width)) ** 2)
        )

    symbol = ca.SX.sym("v")
    for width in (1.0, 0.5, 3.0):
        for even, speed in ((1.0, np.abs(v)), (0.0, v)):
            ours = ca.Function("phi", [symbol], gaussian(symbol / width, even=even))
            for mine, theirs in zip(
                ours(np.deg2rad(v)[None, :]), shapes(width, speed), strict=True
            ):
                np.testing.assert_allclose(np.array(mine).ravel(), theirs, rtol=1e-12, atol=1e-300)
