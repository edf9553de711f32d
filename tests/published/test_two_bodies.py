"""Two bodies rubbing on each other: the grey-box benchmark whose true values are printed, through an observer.

(15) and (17) with one stiffness are its equations: m v' = u - k v - f w*, with w* relaxing over the distance e.
"""

import numpy as np
from scipy.signal import sawtooth

from bristle.model.native import Native
from bristle.observer import observer_program
from bristle.plant.servo import servo_program

MASS, DAMPING, DISTANCE, FRICTION = 400.0, 2000.0, 1e-4, 1700.0  # kg, N.s/m, m, N
UNIT = 1e-3  # m; the model's "rad" is a millimetre here
STEP = 5e-3


def experiments():
    """Return force, position and velocity of three experiments of 1000 samples, behind each other: saw-tooth forces."""
    t = np.arange(3000) * STEP
    u = np.repeat([4000.0, 6000.0, 3000.0], 1000) * sawtooth(2 * np.pi * t / np.repeat([2.5, 1.6, 4.0], 1000), 0.5)
    stiffness = FRICTION / MASS / DISTANCE
    law = {"modified.sigma0": stiffness, "modified.sigma1": 0.0, "modified.sigma2": 0.0, "modified.c": UNIT / DISTANCE}
    body = Native(servo_program("modified", encoder=False), {"J": MASS, "b": 1 / UNIT, "a2": DAMPING, "u_max": 1e5} | law)
    out, _ = body.run(STEP, {"u": u}, ["theta", "v"])
    return u, *np.ascontiguousarray(out[:-1].T)


def found(u, theta, v):
    """Return mass, damping, distance and friction as the observer says in the end."""
    instance = Native(observer_program("swapped"), {"sample_time": STEP, "swapped.cutoff": 60.0})
    inputs = {"u": u, "y_theta": theta, "y_v": v}
    out, _ = instance.run(STEP, inputs, [f"{name}_hat" for name in ("b", "alpha2", "sigma0", "c")])
    b, alpha2, sigma0, c = out[-1]
    mass = 1 / (b * UNIT)
    return np.array([mass, alpha2 * mass, UNIT / c, sigma0 / c * UNIT * mass])


def test_an_observer_finds_the_printed_values():
    """Source: clavel2001; the values and the sampling are those of the benchmark, the force is made anew."""
    u, theta, v = experiments()
    true = np.array([MASS, DAMPING, DISTANCE, FRICTION])
    np.testing.assert_allclose(found(u, theta, v), true, rtol=0.005)
    late = np.concatenate([u[1:], u[-1:]])  # shifted by a sample, the same record says something else
    assert np.max(np.abs(found(late, theta, v) / true - 1)) > 0.05
