"""Set Z: two bodies that rub on each other, the grey-box benchmark whose true values are printed
(clavel2001).

Its model is (15) with (17) and one stiffness: m v' = u - k v - f w*, w* relaxing over the distance
e. In the normalised parameters, with a millimetre in the place of the radian: alpha2 = k/m, b =
1/m, sigma0 = f/(m e), c = 1/e.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import sawtooth

from bristle.model.native import Native
from bristle.plant.servo import servo_program

Array = NDArray[np.float64]
SET_Z_STEP = 5e-3  # s
MILLIMETRE = 1e-3  # m
ENCODER_COUNT = 1e-3  # mm, of the encoder
# N, s: height and period of the saw-tooth of each experiment
PIECES = ((4000.0, 2.5), (6000.0, 1.6), (3000.0, 4.0))
EXPERIMENT_SAMPLES = 1000  # of an experiment


def normalised(mass: float, damping: float, distance: float, friction: float) -> dict[str, float]:
    """Return the normalised parameters of kg, N.s/m, m, N."""
    sigma0 = friction / mass / distance
    return {
        "alpha2": damping / mass,
        "b": 1 / MILLIMETRE / mass,
        "Fc": friction / mass / MILLIMETRE,
        "sigma0": sigma0,
        "c": MILLIMETRE / distance,
    }


MASS, DAMPING = 400.0, 2000.0
SET_Z_TRUE = normalised(MASS, DAMPING, 1e-4, 1700.0)
SET_Z_START = normalised(380.0, 2200.0, 1.2e-4, 1900.0)


def record(seed: int) -> dict[str, Array]:
    """Return u, position and velocity, exact and by an encoder; seed 1 is the benchmark, others
    vary the forces by up to 30 %.
    """
    vary = np.ones((3, 2)) if seed == 1 else np.random.default_rng(seed).uniform(0.7, 1.3, (3, 2))
    height, period = np.repeat(np.array(PIECES) * vary, EXPERIMENT_SAMPLES, axis=0).T
    u = height * sawtooth(2 * np.pi * np.arange(len(height)) * SET_Z_STEP / period, 0.5)
    law = {
        "modified.sigma0": SET_Z_TRUE["sigma0"],
        "modified.sigma1": 0.0,
        "modified.sigma2": 0.0,
        "modified.c": SET_Z_TRUE["c"],
    }
    servo = {"J": MASS, "b": 1 / MILLIMETRE, "a2": DAMPING, "u_max": 1e5}
    out, _ = Native(servo_program("modified", encoder=False), servo | law).run(
        SET_Z_STEP, {"u": u}, ["theta", "v"]
    )
    theta, v = np.ascontiguousarray(out[:-1].T)
    encoder = np.floor(theta / ENCODER_COUNT) * ENCODER_COUNT
    return {
        "u": u,
        "y_theta": theta,
        "y_v": v,
        "encoder": encoder,
        "encoder_v": np.diff(encoder, prepend=encoder[0]) / SET_Z_STEP,
    }
