"""Two bodies rubbing on each other: the grey-box benchmark whose true values are printed, through an observer.

The record is that of the study (benchmarks/study/presliding_benchmark.py), the true values stand here as they are printed.
"""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from bristle.model.native import Native
from bristle.observer import observer_program

bodies = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "study" / "presliding_benchmark.py")))
MASS, DAMPING, DISTANCE, FRICTION = 400.0, 2000.0, 1e-4, 1700.0  # kg, N.s/m, m, N
UNIT = 1e-3  # m; the model's "rad" is a millimetre here


def found(u, theta, v):
    """Return mass, damping, distance and friction as the observer says in the end."""
    instance = Native(observer_program("swapped"), {"sample_time": bodies.SET_Z_STEP, "swapped.cutoff": 60.0})
    inputs = {"u": u, "y_theta": theta, "y_v": v}
    out, _ = instance.run(bodies.SET_Z_STEP, inputs, [f"{name}_hat" for name in ("b", "alpha2", "sigma0", "c")])
    b, alpha2, sigma0, c = out[-1]
    mass = 1 / (b * UNIT)
    return np.array([mass, alpha2 * mass, UNIT / c, sigma0 / c * UNIT * mass])


def test_an_observer_finds_the_printed_values():
    """Source: clavel2001; the values and the sampling are those of the benchmark, the force is made anew."""
    data = bodies.record(1)
    u, theta, v = data["u"], data["y_theta"], data["y_v"]
    true = np.array([MASS, DAMPING, DISTANCE, FRICTION])
    np.testing.assert_allclose(found(u, theta, v), true, rtol=0.005)
    late = np.concatenate([u[1:], u[-1:]])  # shifted by a sample, the same record says something else
    assert np.max(np.abs(found(late, theta, v) / true - 1)) > 0.05
