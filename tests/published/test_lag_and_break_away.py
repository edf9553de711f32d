"""What experiments show of sliding friction, and how much bristle damping takes it away.

Friction lags behind the velocity: it is larger while the speed rises than while it falls
(armstrong1994). The force at which motion breaks away falls with the rate at which it is applied
(dixit2008 section IV-B, canudas1995 Fig. 4). Bristle damping of more than the friction level over
the speed, sigma1 > N(v)/|v|, turns the lag around.
"""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.friction import law
from bristle.plant.servo import servo_program

PAGE = Path(__file__).resolve().parents[2] / "docs" / "mathematics.md"
LAWS = ("lugre", "lugre_velocity_damping", "elastoplastic", "leuven", "gms", "modified")
DAMPED = ("lugre", "elastoplastic", "leuven")
FC, FS, VS = 0.004, 0.0072, math.radians(25.0)  # N.m, N.m, rad/s: defaults of the laws
MEAN, AMPLITUDE = math.radians(20.0), math.radians(15.0)  # rad/s
MUCH = 0.02  # N.m.s/rad: a bristle damping that inverts
RATES = (0.005, 0.025, 0.05, 0.1)  # N.m/s


@cache
def alone(name: str) -> Program:
    """A law whose velocity is an input."""
    system, which = System("alone"), law(name)
    for parameter in (
        Parameter("J", "J", "kg.m2", 0.001, 1e-9, 1e6, "inertia", "dixit2008 eq. (7)"),
        *which.parameters,
    ):
        system.parameter(parameter)
    v = system.input(Variable("v", "rad/s", "velocity"))
    own = system.namespace(f"{name}.")
    for state in which.states:
        system.state(State(state.name, state.unit, state.description, scale=state.scale(own)))
    for mode in which.modes:
        system.mode(mode)
    friction = which.equations(own, v)
    for state, rate in friction.rates.items():
        system.rate(state, rate)
    for mode, (following, *past) in friction.switches.items():
        system.update(mode, following)
        system.margin(mode, *past)
    system.output(Variable("F", "N.m", "friction"), friction.force)
    return Program("Alone", [system])


@cache
def servo(name: str) -> Program:
    return servo_program(name, encoder=False)


def lag(
    name: str, hertz: float, amplitude: float = AMPLITUDE, mean: float = MEAN, **parameters: float
) -> float:
    """Friction at the mean speed while it rises less that while it falls, over Fc; the speed is a
    sine.
    """
    samples = 1000  # of a period
    h = 1.0 / hertz / samples
    v = mean + amplitude * np.sin(2 * np.pi * hertz * (np.arange(8 * samples) + 0.5) * h)
    values = {f"{name}.{key}": value for key, value in parameters.items()}
    found, _ = Native(alone(name), values).run(h, {"v": v}, ["F"])
    return float(found[7 * samples, 0] - found[7 * samples + samples // 2, 0]) / FC


def break_away(name: str, rate: float, **parameters: float) -> float:
    """Largest friction under a torque that rises at a rate, before the speed reaches the Stribeck
    velocity, over Fs.
    """
    h = 1e-4
    torque = rate * h * (np.arange(round(3 * FS / rate / h)) + 0.5)
    values = {"b": 1.0, "a2": 0.0, "u_max": 1e3} | {
        f"{name}.{key}": value for key, value in parameters.items()
    }
    found, _ = Native(servo(name), values).run(h, {"u": torque}, ["v", "F"])
    return float(np.max(found[: np.argmax(found[:, 0] >= VS) + 1, 1])) / FS


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", LAWS)
def test_friction_lags_and_break_away_falls_with_the_rate(name: str) -> None:
    """At the defaults of every law with a Stribeck curve and a memory."""
    assert all(lag(name, hertz) > 0.02 for hertz in (1.0, 3.0, 10.0))
    forces = [break_away(name, rate) for rate in RATES]
    assert all(np.diff(forces) < 0)


@pytest.mark.parametrize("name", DAMPED)
def test_much_bristle_damping_inverts_both(name: str) -> None:
    assert lag(name, 10.0, sigma1=MUCH) < -0.02
    assert -0.75 < lag(name, 10.0, 2 * AMPLITUDE, 2 * MEAN, sigma1=MUCH) < -0.4
    own = [break_away(name, rate) for rate in RATES]
    damped = [break_away(name, rate, sigma1=MUCH) for rate in RATES]
    assert own[0] - own[-1] > 1.5 * (damped[0] - damped[-1])
    if name != "lugre":
        assert damped[-1] > damped[-2]


@pytest.mark.parametrize(
    ("name", "damping", "inverting"),
    [
        ("lugre", "sigma1", (FC + (FS - FC) * math.exp(-((MEAN / VS) ** 2))) / MEAN),
        ("elastoplastic", "sigma1", (FC + (FS - FC) * math.exp(-((MEAN / VS) ** 2))) / MEAN),
        ("modified", "tau", 1 / (150.0 * MEAN)),
    ],
)
def test_the_lag_turns_around_where_damping_exceeds_level_over_speed(
    name: str, damping: str, inverting: float
) -> None:
    """Slow and small changes about a speed: sigma1 = N(v)/v, for the modified law tau = 1/(c v)."""
    small = math.radians(0.5)
    assert (
        lag(name, 1.0, small, **{damping: 0.9 * inverting})
        > 0
        > lag(name, 1.0, small, **{damping: 1.1 * inverting})
    )


def test_the_table_of_the_documentation() -> None:
    page = PAGE.read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| `(\w+)`(?:, sigma1 = ([\d.]+))? \| ([\d.−]+) \| ([\d.]+) \| ([\d.]+) \|$",
        page,
        re.MULTILINE,
    )
    assert {name for name, *_ in rows} == {*LAWS}
    for name, sigma1, *cells in rows:
        given = {"sigma1": float(sigma1)} if sigma1 else {}
        found = [
            lag(name, 10.0, **given),
            break_away(name, RATES[0], **given),
            break_away(name, RATES[-1], **given),
        ]
        assert [float(cell.replace("−", "-")) for cell in cells] == pytest.approx(found, abs=0.006)
