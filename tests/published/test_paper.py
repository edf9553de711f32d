"""What dixit2008 says about its model: remark 3's interval of c, and eq. (24) with v where |v| is
meant.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.loop import simulate
from bristle.harness.metrics.fit import Data, LeanModel, fit

H, SECONDS = 1e-3, 40.0
# N.m/rad, N.m, N.m, rad/s: a0 = 5 mrad, a1 = 4 mrad
STIFFNESS, FC, FS, VS = 0.8, 0.004, 0.0072, math.radians(25.0)
A0, A1 = FC / STIFFNESS, (FS - FC) / STIFFNESS
DAMPING = 0.02  # N.m.s/rad: sigma1 of set L1


def lugre_record(damping: float, order: int) -> Data:
    """A record of the original LuGre law under the reference controller."""
    plant = Fmu(obtain("plant"))
    friction = {
        "lugre.sigma0": STIFFNESS,
        "lugre.sigma1": damping,
        "lugre.Fc": FC,
        "lugre.Fs": FS,
        "lugre.vs": VS,
    }
    instances = (
        BusUnit(
            "plant",
            plant,
            {
                "law": plant.choices("law")["lugre"],
                "J": 0.001,
                "b": 0.0065,
                "a2": 0.002,
                **friction,
            },
        ),
        BusUnit("controller", Fmu(obtain("controller")), {"seed": 1.0, "order": float(order)}),
    )
    links = ((("controller", "u"), ("plant", "u")), (("plant", "v"), ("controller", "y_v")))
    trace = simulate(
        Bus(instances, round(SECONDS / H), H, links, record=(("controller", "u"), ("plant", "v")))
    )
    return Data(trace["controller", "u"], trace["plant", "v"], H)


def fitted_c(data: Data, fixed: dict[str, float]) -> float:
    with LeanModel("modified", Fmu(obtain("plant", law="modified")), fixed) as model:
        found = fit(model, data)
    assert found.at_bound == []
    return found.parameters["modified.c"]


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("fixed", [{}, {"modified.tau": 0.0}], ids=["tau fitted", "tau = 0"])
def test_remark_3_holds_on_the_original_law(order: int, fixed: dict[str, float]) -> None:
    """c lies between 1/(a0 + a1) and 1/a0 where the plant has no bristle damping."""
    assert 1 / (A0 + A1) < fitted_c(lugre_record(0.0, order), fixed) < 1 / A0


@pytest.mark.slow
def test_remark_3_holds_with_bristle_damping_only_if_the_model_has_some() -> None:
    data = lugre_record(DAMPING, 1)
    assert 1 / (A0 + A1) < fitted_c(data, {}) < 1 / A0
    without = fitted_c(data, {"modified.tau": 0.0})
    assert not 1 / (A0 + A1) < without < 1 / A0


def test_equation_24_as_printed_fits_a_stribeck_curve_worse() -> None:
    """Least squares over +-100 deg/s: v in place of |v| leaves about twice the error, since the
    curve is even.
    """
    v = np.linspace(-100.0, 100.0, 2001)
    level = FC + (FS - FC) * np.exp(-((v / 25.0) ** 2))

    def left(speed: np.ndarray) -> float:
        columns = np.column_stack(
            [np.ones_like(v), np.exp(-((v / 10) ** 2)), np.exp(-(((speed - 20) / 20) ** 2))]
        )
        found = np.linalg.lstsq(columns, level, rcond=None)[0]
        return float(np.sqrt(np.mean((columns @ found - level) ** 2)))

    assert left(v) / left(np.abs(v)) == pytest.approx(2.2, abs=0.3)
