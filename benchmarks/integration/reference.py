"""Independent references for the servo's integrator: right-hand sides typed from the paper, solved
by LSODA.

Nothing here is imported from bristle: the tests and `study.py` compare the generated code with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import odeint

Array = NDArray[np.float64]
Rhs = Callable[[float, Sequence[float], float], list[float]]
Feedback = Callable[[int, float, float], float]  # (k, theta, v) -> u of step k
DEG = math.pi / 180.0
REFERENCE_STEP = 1e-3


@dataclass(frozen=True)
class Plant:
    """A parameter set: the servo's law and parameters by public name, and the same equations typed
    independently.
    """

    law: str
    parameters: dict[str, float]
    rhs: Rhs  # of (theta, v, friction state) with torque b sat(u) over J as the last argument
    friction_state: str
    scale: float  # size of the friction state
    gain: float  # b / J


def modified_rhs(a2: float, s0: float, s1: float, s2: float, c: float) -> Rhs:
    """Return the modified law: v' = b u - w - a2 v, w' = K(v) v - c |v| w."""

    def rhs(_t: float, x: Sequence[float], drive: float) -> list[float]:
        v, w = x[1], x[2]
        a = abs(v)
        k = (
            s0
            + s1 * math.exp(-((a / (10 * DEG)) ** 2))
            + s2 * math.exp(-(((a - 20 * DEG) / (20 * DEG)) ** 2))
        )
        return [v, drive - w - a2 * v, k * v - c * a * w]

    return rhs


def lugre_rhs(m: float, s0: float, s1: float, s2: float, level: tuple[float, float, float]) -> Rhs:
    """Return LuGre as Canudas de Wit et al. (1995) print it, in forces; s2 is the viscous
    coefficient, `level` has Fc, Fs and vs.
    """
    fc, fs, vs = level

    def rhs(_t: float, x: Sequence[float], drive: float) -> list[float]:
        v, z = x[1], x[2]
        g = fc + (fs - fc) * math.exp(-((v / vs) ** 2))
        dz = v - s0 * abs(v) / g * z
        return [v, drive - (s0 * z + s1 * dz + s2 * v) / m, dz]

    return rhs


def _modified(s0: float, s1: float, s2: float, c: float) -> Plant:
    values = {"modified.sigma0": s0, "modified.sigma1": s1, "modified.sigma2": s2, "modified.c": c}
    servo = {"J": 0.001, "b": 0.0065, "a2": 0.002}
    return Plant(
        "modified", servo | values, modified_rhs(2.0, s0, s1, s2, c), "modified.w", s0 / c, 6.5
    )


def _lugre(
    servo: tuple[float, float, float], s0: float, s1: float, fc: float, fs: float, vs: float
) -> Plant:
    m, b, a2 = servo
    level = {"lugre.Fc": fc, "lugre.Fs": fs, "lugre.vs": vs}
    values = {"J": m, "b": b, "a2": a2, "lugre.sigma0": s0, "lugre.sigma1": s1} | level
    rhs = lugre_rhs(m, s0, s1, a2, (fc, fs, vs))
    return Plant("lugre", values, rhs, "lugre.z", fc / s0, b / m)


REFERENCE_PLANTS = {
    "S": _modified(600.0, 800.0, 300.0, 150.0),
    "R": _modified(800.0, 1067.0, 400.0, 200.0),
    "L0": _lugre((0.001, 0.0065, 0.002), 0.8, 0.0, 0.8 * 0.005, 0.8 * 0.009, 25 * DEG),
    "L1": _lugre((0.001, 0.0065, 0.002), 0.8, 0.02, 0.8 * 0.005, 0.8 * 0.009, 25 * DEG),
    "T": _lugre((1.0, 1.0, 0.4), 1e5, math.sqrt(1e5), 1.0, 1.5, 0.001),
}


def noise(n: int, seed: int, pole: float = 5.0) -> Array:
    """Return unit-rms white noise behind a first-order low-pass, one value a step."""
    a = math.exp(-pole * REFERENCE_STEP)
    white = np.random.default_rng(seed).standard_normal(n)
    out = np.empty(n)
    x = white[0]
    for k in range(n):
        x = a * x + math.sqrt(1 - a * a) * white[k]
        out[k] = x
    return out


class SpeedLoop:
    """PI control (kp 4, ki 20) of the velocity along low-pass noise of 120 deg/s rms; `unit` scales
    to the plant.
    """

    def __init__(self, n: int, seed: int = 1, unit: float = 1.0) -> None:
        self.reference = unit * np.clip(120 * DEG * noise(n, seed), -300 * DEG, 300 * DEG)
        self.integral = 0.0

    def __call__(self, k: int, _theta: float, v: float) -> float:
        error = float(self.reference[k]) - v
        self.integral += 20.0 * REFERENCE_STEP * error
        return 4.0 * error + self.integral


class Pull:
    """A spring whose other end moves at a constant speed, as a voltage: stick-slip."""

    def __init__(self, stiffness: float, speed: float) -> None:
        self.stiffness, self.speed = stiffness, speed

    def __call__(self, k: int, theta: float, _v: float) -> float:
        return self.stiffness * (self.speed * REFERENCE_STEP * k - theta)


class Saturated:
    """Requests of up to 60 V, which the drive cuts at 24 V, with reversals and small voltages in
    between.
    """

    def __init__(self, n: int, seed: int = 3) -> None:
        k = np.arange(n)
        strong = 40.0 * noise(n, seed, 15.0) + 20.0 * np.sign(
            np.sin(k * 4 * math.pi * REFERENCE_STEP)
        )
        self.u = np.where(k % 500 < 400, strong, noise(n, seed + 1, 15.0))

    def __call__(self, k: int, _theta: float, _v: float) -> float:
        return float(self.u[k])


def scenarios(name: str, n: int) -> dict[str, Callable[[], Feedback]]:
    """Return the scenarios of a set: fresh feedback laws by name."""
    linear = name == "T"
    pull = {"T": (20.0, 0.1), "S": (100.0 / 6.5, 0.1), "R": (100.0 / 6.5, 0.1)}.get(
        name, (50.0 / 6.5, 0.3)
    )
    return {
        "reversals": lambda: SpeedLoop(n, 1, 0.05 if linear else 1.0),
        "stick-slip": lambda: Pull(*pull),
        "saturated": lambda: Saturated(n),
    }


def solve(plant: Plant, feedback: Feedback, n: int, rtol: float = 1e-12) -> tuple[Array, Array]:
    """Return (states at 0..n, voltages of the n steps); the solver is restarted at every change of
    the input.
    """
    x = np.zeros((n + 1, 3))
    u = np.empty(n)
    atol = rtol * np.array([1e-2, 1e-2, 1e-2 * plant.scale])
    for k in range(n):
        u[k] = feedback(k, x[k, 0], x[k, 1])
        drive = plant.gain * min(max(u[k], -24.0), 24.0)
        x[k + 1] = odeint(
            plant.rhs,
            x[k],
            [0.0, REFERENCE_STEP],
            args=(drive,),
            tfirst=True,
            rtol=rtol,
            atol=atol,
            mxstep=100_000,
            hmax=REFERENCE_STEP,
        )[1]
    return x, u


def rk4(plant: Plant, volts: float, seconds: float, h: float = 0.25e-3) -> Array:
    """Return the state after explicit classical Runge-Kutta steps under a constant voltage; NaN
    after an overflow.
    """
    drive, x = plant.gain * min(max(volts, -24.0), 24.0), [0.0, 0.0, 0.0]

    def stage(slope: Sequence[float], part: float) -> list[float]:
        return plant.rhs(0.0, [a + part * b for a, b in zip(x, slope, strict=True)], drive)

    try:
        for _ in range(round(seconds / h)):
            k1 = stage((0.0, 0.0, 0.0), 0.0)
            k2 = stage(k1, h / 2)
            k3 = stage(k2, h / 2)
            k4 = stage(k3, h)
            x = [
                a + h / 6 * (p + 2 * q + 2 * r + s)
                for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True)
            ]
    except OverflowError:
        return np.full(3, math.nan)
    return np.array(x)
