"""The Kalman filter of a servo that slides, compiled, with the slopes of all it gives."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib.resources import files

import numpy as np
from scipy.linalg import expm

from bristle.common.cache import cached, digest
from bristle.common.table import Array
from bristle.diagnosis.sliding.stretches import Stretches
from bristle.model.compiler import FLAGS, SUFFIX, compile_shared, compiler_identity
from bristle.model.native import pointer

MODEL_SIZE = 22  # numbers that kalman.c takes for a model
MOST_GAINS = 20000  # samples after which gains count as steady in any case
SLOPE_STEP = 1e-5  # of a logarithm: step of the difference quotient of a model's matrices
OUTLIER = 6.0  # standard deviations: an innovation beyond it is no noise, such as an impact
START_DOUBT = 3.0  # of the change of speed in a sample, rms: doubt of the speed at a start


@dataclass(frozen=True)
class SlidingNoise:
    """Parameters of the filter: inertia [kg.m2], viscous friction [N.m.s/rad], a first-order
    disturbance torque (standard deviation [N.m], corner frequency [Hz]), the sensor's white noise
    [unit of the output] and a white torque [N.m.s^0.5].
    """

    inertia: float
    viscous: float
    torque: float
    corner: float
    sensor: float
    white: float

    @property
    def logarithms(self) -> Array:
        """Logarithms of the six."""
        return np.log([getattr(self, each.name) for each in fields(self)])

    @staticmethod
    def of(logarithms: Array) -> SlidingNoise:
        """Return the parameters of these logarithms."""
        return SlidingNoise(*(float(x) for x in np.exp(logarithms)))


FILTER_PARAMETERS = len(fields(SlidingNoise))


@cache
def _library() -> ctypes.CDLL:
    """Compile the filter (or take it from the cache) and load it."""
    text = (files("bristle.diagnosis.sliding") / "kalman.c").read_text(encoding="utf-8")
    key = digest(text, *FLAGS, compiler_identity())
    name = f"kalman-{key[:24]}{SUFFIX}"
    loaded = ctypes.CDLL(str(cached(name, lambda out: compile_shared({"kalman.c": text}, out))))
    loaded.kalman_gains.restype = ctypes.c_longlong
    return loaded


class _Over(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_longlong) for name in ("count", "length")),
        *((name, ctypes.c_void_p) for name in ("begin", "end")),
        ("h", ctypes.c_double),
    ]


class _Gains(ctypes.Structure):
    _fields_ = [
        ("samples", ctypes.c_longlong),
        *((name, ctypes.c_void_p) for name in ("gain", "gain_slope", "variance")),
    ]


def _models(logarithms: Array, h: float) -> Array:
    """Return the 22 numbers of each model (models, 6) over a sample of h [s].

    x' = v, J v' = T + d + w - a2 v, d a first-order noise, w white; T is held over the sample.
    Source: vanloan1978 (matrices of a sampled linear system by one exponential).
    """
    inertia, viscous, torque, corner, sensor, white = np.exp(logarithms.T)
    count, decay = len(logarithms), 2 * math.pi * corner
    rates = np.zeros((count, 3, 3))
    rates[:, 0, 1], rates[:, 1, 1], rates[:, 1, 2] = 1.0, -viscous / inertia, 1 / inertia
    rates[:, 2, 2] = -decay
    both, held = np.zeros((count, 6, 6)), np.zeros((count, 4, 4))
    both[:, :3, :3], both[:, 3:, 3:] = -rates, rates.transpose(0, 2, 1)
    both[:, 1, 4], both[:, 2, 5] = (white / inertia) ** 2, 2 * decay * torque**2
    held[:, :3, :3], held[:, 1, 3] = rates, 1 / inertia
    power = expm(both * h)
    transition = power[:, 3:, 3:].transpose(0, 2, 1)
    covariance = transition @ power[:, :3, 3:]
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    parts = transition, covariance, expm(held * h)[:, :3, 3], sensor**2
    return np.column_stack([each.reshape(count, -1) for each in parts])


def _starts(models: Array, logarithms: Array, over: Stretches) -> Array:
    """Return the covariances (models, 9) of the first prediction: what one or two samples say of
    position and speed, a stationary disturbance.
    """
    h, torque, sensor = over.h, *np.exp(logarithms.T[[2, 4]])
    known = np.zeros((len(models), 3, 3))
    if over.velocity:
        known[:, 1, 1] = sensor**2
    else:
        line = np.array([[1, 1 / h], [1 / h, 2 / h**2]])
        known[:, :2, :2] = sensor[:, None, None] ** 2 * line
        known[:, 1, 1] += (START_DOUBT * over.change) ** 2
    known[:, 2, 2] = torque**2
    transition, covariance = models[:, :9].reshape(-1, 3, 3), models[:, 9:18].reshape(-1, 3, 3)
    return np.asarray(transition @ known @ transition.transpose(0, 2, 1) + covariance).reshape(
        -1, 9
    )


def _with_slopes(values: Array) -> Array:
    """Return values (1 + 2 parameters, n) at a point and on either side of it, as the value and
    slopes.
    """
    above, below = np.split(values[1:], 2)
    return np.concatenate([values[:1], (above - below) / (2 * SLOPE_STEP)])


class KalmanFilter:
    """The filter with given parameters over stretches: `variance` of each innovation [output
    squared] and its slopes by the logarithms of the parameters, over all samples of the stretches.
    """

    def __init__(self, noise: SlidingNoise, stretches: Stretches) -> None:
        s, logarithms = stretches, noise.logarithms
        self.noise, self._stretches = noise, s
        self._shown = 1 if s.velocity else 0
        steps = SLOPE_STEP * np.eye(FILTER_PARAMETERS)
        points = np.concatenate([[logarithms], logarithms + steps, logarithms - steps])
        models = _models(points, s.h)
        self._model = np.ascontiguousarray(_with_slopes(models))
        covariance = np.ascontiguousarray(_with_slopes(_starts(models, points, s)))
        most = min(s.longest, MOST_GAINS)
        self._gain, self._variance = np.empty((most, 3)), np.empty(most)
        self._gain_slope = np.empty((most, FILTER_PARAMETERS, 3))
        variance_slope = np.empty((most, FILTER_PARAMETERS))
        steady = _library().kalman_gains(
            pointer(self._model),
            FILTER_PARAMETERS,
            self._shown,
            pointer(covariance),
            ctypes.c_longlong(most),
            pointer(self._gain),
            pointer(self._variance),
            pointer(self._gain_slope),
            pointer(variance_slope),
        )
        parts = self._gain, self._gain_slope, self._variance
        self._gains = _Gains(steady, *(pointer(each) for each in parts))
        self._over = _Over(len(s.begin), len(s.measured), pointer(s.begin), pointer(s.end), s.h)
        place = np.minimum(s.age, steady - 1)
        self.variance, self.variance_slope = self._variance[place], variance_slope[place]

    def innovations(self, measured: Array, torque: Array) -> tuple[Array, Array]:
        """Return the innovations (counted,) of a measurement (samples,) under a torque [N.m], and
        their slopes (counted, 6) by the logarithms of the parameters.
        """
        s = self._stretches
        innovation = np.zeros(len(s.measured))
        slope = np.zeros((len(s.measured), FILTER_PARAMETERS))
        _library().kalman_innovations(
            pointer(self._model),
            FILTER_PARAMETERS,
            self._shown,
            ctypes.byref(self._over),
            ctypes.byref(self._gains),
            pointer(np.ascontiguousarray(measured)),
            pointer(np.ascontiguousarray(torque)),
            pointer(innovation),
            pointer(slope),
        )
        return innovation[s.counted], slope[s.counted]

    def as_predicted(self, torque: Array) -> Stretches:
        """Return the stretches by what is known a sample before, under a torque (samples,) [N.m]:
        each ends with the first sample for which the prediction has turned, or that is an outlier,
        and has the speeds that are predicted.

        A smoothed speed knows what comes after: with friction as a function of it, a fit could
        predict from what it should predict.
        """
        s = self._stretches
        end, speed = np.empty(len(s.begin), dtype=np.int64), s.v.copy()
        _library().kalman_ends(
            pointer(self._model),
            self._shown,
            ctypes.byref(self._over),
            ctypes.byref(self._gains),
            pointer(s.measured),
            pointer(np.ascontiguousarray(torque)),
            pointer(np.sign(s.v[s.begin])),
            ctypes.c_double(OUTLIER),
            pointer(end),
            pointer(speed),
        )
        cut = replace(s, end=end)
        return replace(cut, v=np.where(cut.slides > 0, speed, s.v))

    def columns(self, torques: Array) -> Array:
        """Return what further torques (k, samples) [N.m] change in the innovations (counted, k)."""
        s = self._stretches
        filtered = np.zeros((len(s.measured), len(torques)))
        _library().kalman_columns(
            pointer(self._model),
            self._shown,
            ctypes.byref(self._over),
            ctypes.byref(self._gains),
            ctypes.c_longlong(len(torques)),
            pointer(np.ascontiguousarray(torques)),
            None,
            pointer(filtered),
        )
        return np.asarray(filtered[s.counted])
