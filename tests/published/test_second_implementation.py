"""A second implementation of LuGre, somebody else's: MuJoCo's motor, in the stick-slip experiment
of canudas1995 Fig. 6.

Its bristles are its own code, stepped at a fixed step; only the equations and the parameters of
Table I are shared.
"""

import math

import mujoco
import numpy as np
import pytest

from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.friction import law

SIGMA0, SIGMA1, FC, FS, VS, SIGMA2 = 1e5, math.sqrt(1e5), 1.0, 1.5, 1e-3, 0.4
SPRING, PULL, SECONDS = 2.0, 0.1, 28.0  # N/m, m/s, s
MODEL = f"""<mujoco>
<option timestep="{{step}}" gravity="0 0 0"/>
<worldbody>
<body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
</worldbody>
<actuator>
<dcmotor joint="x" motorconst="1 1" resistance="{1 / SIGMA2}"
 lugre="{SIGMA0} {SIGMA1} {FC} {FS} {VS}"/>
</actuator>
</mujoco>"""  # without a voltage the motor's back-EMF is viscous friction of K^2/R = sigma2


def breaks(t, v):
    """Return when v rises through 0.01 m/s."""
    k = np.nonzero((v[:-1] < 0.01) & (v[1:] >= 0.01))[0]
    return t[k] + (0.01 - v[k]) / (v[k + 1] - v[k]) * (t[k + 1] - t[k])


def theirs(step):
    """Return the times of slip by MuJoCo."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(step=step))
    data = mujoco.MjData(model)
    v = np.zeros(round(SECONDS / step) + 1)
    for k in range(1, len(v)):
        data.qfrc_applied[0] = SPRING * (PULL * data.time - data.qpos[0])
        mujoco.mj_step(model, data)
        v[k] = data.qvel[0]
    return breaks(np.arange(len(v)) * step, v)


def ours():
    """Return the times of slip of our law on the same mass and spring."""
    system, lugre = System("mass"), law("lugre")
    for parameter in (
        Parameter("J", "m", "kg", 1.0, 1e-9, 1e6, "mass", "canudas1995 Table I"),
        *lugre.parameters,
    ):
        system.parameter(parameter)
    system.input(Variable("pace", "1", "only counts the steps"))
    x = system.state(State("x", "m", "position", scale=1e-3))
    v = system.state(State("v", "m/s", "velocity", scale=1e-2))
    system.state(State("z", "m", "deflection", scale=1e-5))
    friction = lugre.equations(system.namespace("lugre."), v)
    system.rate("x", v)
    system.rate("v", SPRING * (PULL * system.time - x) - friction.force - SIGMA2 * v)
    system.rate("z", friction.rates["z"])
    system.output(Variable("V", "m/s", "velocity"), v)
    values = {"sigma0": SIGMA0, "sigma1": SIGMA1, "Fc": FC, "Fs": FS, "vs": VS}
    parameters = {f"lugre.{name}": value for name, value in values.items()} | {
        "solver.tolerance": 1e-10
    }
    native = Native(Program("Mass", [system]), parameters)
    record, _ = native.run(1e-4, {"pace": np.zeros(round(SECONDS / 1e-4))}, ["time", "V"])
    return breaks(*record.T)


@pytest.mark.sampled(4)
def test_their_stick_slip_tends_to_ours_as_their_step_shrinks():
    own = ours()
    assert len(own) == 4
    apart = [np.abs(theirs(step) - own) for step in (2e-3, 4e-4, 8e-5)]
    assert np.all(apart[1] < apart[0] / 2.5)
    assert np.all(apart[2] < apart[1] / 2.5)
    assert np.diff(own) == pytest.approx(np.diff(theirs(8e-5)), abs=5e-4)
