"""Two bodies rubbing on each other: the grey-box benchmark whose true values are printed, through
an observer.

The record is that of the study (benchmarks/study/presliding_benchmark.py), the true values stand
here as they are printed.
"""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.model.native import Native
from bristle.observer import observer_program

bodies = SimpleNamespace(
    **runpy.run_path(
        str(Path(__file__).parents[2] / "benchmarks" / "study" / "presliding_benchmark.py")
    )
)
MASS, DAMPING, DISTANCE, FRICTION = 400.0, 2000.0, 1e-4, 1700.0  # kg, N.s/m, m, N
UNIT = 1e-3  # m; the model's "rad" is a millimetre here


def found(u, theta, v):
    """Return (mass, damping, distance and friction, delay in samples, whether mass and damping are
    valid) in the end.
    """
    instance = Native(
        observer_program("swapped"), {"sample_time": bodies.SET_Z_STEP, "swapped.cutoff": 60.0}
    )
    inputs = {"u": u, "y_theta": theta, "y_v": v}
    names = [
        *(f"{name}_hat" for name in ("b", "alpha2", "sigma0", "c", "delay")),
        "b_valid",
        "alpha2_valid",
    ]
    out, _ = instance.run(bodies.SET_Z_STEP, inputs, names)
    b, alpha2, sigma0, c, delay, *valid = out[-1]
    mass = 1 / (b * UNIT)
    return (
        np.array([mass, alpha2 * mass, UNIT / c, sigma0 / c * UNIT * mass]),
        delay,
        valid == [1.0, 1.0],
    )


def test_an_observer_finds_the_printed_values():
    """Source: clavel2001; the values and the sampling are those of the benchmark, the force is made
    anew.
    """
    data = bodies.record(1)
    u, theta, v = data["u"], data["y_theta"], data["y_v"]
    true = np.array([MASS, DAMPING, DISTANCE, FRICTION])
    values, delay, valid = found(u, theta, v)
    np.testing.assert_allclose(values, true, rtol=0.01)
    assert delay == pytest.approx(0.0, abs=0.01)
    assert valid
    # a measurement that comes a sample late
    values, delay, valid = found(np.concatenate([u[1:], u[-1:]]), theta, v)
    np.testing.assert_allclose(values, true, rtol=0.01)
    assert delay == pytest.approx(1.0, abs=0.01)
    assert valid
    # one before its cause is refused
    values, _, valid = found(np.concatenate([u[:1], u[:-1]]), theta, v)
    assert np.max(np.abs(values / true - 1)) > 0.1
    assert not valid
