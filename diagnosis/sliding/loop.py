"""Whether records were made in a position loop, and about how fast it is: seen from what the input
makes of errors of the sensor and of the disturbance, which nothing else brings into it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.signal import lfilter

from bristle.common.table import Array
from bristle.diagnosis.sliding.fit import SlidingFit

DAMPING = 0.9  # of the loop that stands for the one of the records
LAGS = 20  # innovations, the present one included, that an input is compared with
OWN_PAST = 20  # samples of the input from which the next one is predicted
LEAST_GAIN = 15.0  # nats: by which innovations must predict the input
MOST_MISFIT = 0.3  # of what they predict: what proportional and derivative action leave at most
FILTERS = (1.0, 60.0)  # samples: least and largest time constant of the derivative
FILTERS_TRIED = 12  # of those between them
STAGES = (1, 2)  # filters of first order behind the derivative
ACTION_ERRORS = 3.0  # standard errors from which on the proportional action is taken


@dataclass(frozen=True)
class Loop:
    """A position loop that acts like a mass on a spring and a damper of this frequency [Hz]."""

    frequency: float

    def gains(self, inertia: float, gain: float) -> tuple[float, float]:
        """Return the input by error and by its rate, on an inertia [kg.m2] whose torque over input
        is `gain`.
        """
        omega = 2 * math.pi * self.frequency
        return inertia * omega**2 / gain, 2 * DAMPING * inertia * omega / gain


@dataclass(frozen=True)
class _Seen:
    """The innovations before each sample, as an orthonormal basis (counted, LAGS), and how the
    input follows from its own past.
    """

    fit: SlidingFit
    basis: Array
    past: tuple[Array, ...]  # (OWN_PAST,) for each record

    def whitened(self, signal: Array) -> Array:
        """Return what innovations predict of a signal (samples,), filtered as the input is."""
        return np.asarray(self.basis.T @ self.filtered(signal)[self.fit.model.over.counted])

    def filtered(self, signal: Array) -> Array:
        """Return a signal (samples,) less what the input's own past would predict of it."""
        over, out = self.fit.model.over, np.zeros(len(signal))
        for record, weights in enumerate(self.past):
            own = over.record == record
            out[own] = lfilter(np.concatenate([[1.0], -weights]), [1.0], signal[own])
        return out


def loop_of(fit: SlidingFit) -> Loop | None:
    """Return the loop that records of a position were made in; None where they do not show one.

    The innovations of the sliding motion are known to no reference. What of the input they predict,
    beyond what its own past does, is the answer of a controller; in open loop there is none.
    Proportional and derivative action are fitted to that answer, since in it both sides share the
    same cause. Source: ljung1999 (chapter 7, instrumental variables; chapter 13, closed loop).
    """
    over = fit.model.over
    if over.velocity:
        return None
    seen = _seen(fit)
    input_left = seen.filtered(over.u)[over.counted]
    predicted, whole = seen.basis.T @ input_left, float(input_left @ input_left)
    if whole == 0.0:  # no input while the servo slides
        return None
    gain = -0.5 * len(input_left) * math.log1p(-float(predicted @ predicted) / whole)
    if gain < LEAST_GAIN:
        return None
    error = math.sqrt(whole / len(input_left))
    filters = [(0.0, 0), *product(np.geomspace(*FILTERS, FILTERS_TRIED), STAGES)]
    rate = np.concatenate([[0.0], np.diff(over.measured)]) / over.h
    rate[np.flatnonzero(np.diff(over.record)) + 1] = 0.0
    position = seen.whitened(over.measured)
    tried = [
        _fitted(predicted, error, position, seen.whitened(_behind(rate, *each))) for each in filters
    ]
    misfit, actions, deviations = min(tried, key=lambda each: each[0])
    if misfit > MOST_MISFIT * float(predicted @ predicted):
        return None
    omega = _frequency(actions, deviations, fit.values["b"] / fit.values["J"])
    return Loop(omega / (2 * math.pi)) if omega > 0 else None


def _seen(fit: SlidingFit) -> _Seen:
    over, n = fit.model.over, len(fit.model.over.measured)
    latest, follows = np.zeros(n), np.zeros(n, dtype=bool)
    latest[over.counted] = fit.innovations / np.sqrt(fit.filter.variance)
    follows[over.counted] = True
    counted, columns = follows, [latest]
    for lag in range(1, LAGS):  # of the same stretch
        follows = follows & np.concatenate([np.zeros(lag, dtype=bool), counted[:-lag]])
        columns.append(np.concatenate([np.zeros(lag), latest[:-lag]]) * follows)
    basis = np.linalg.qr(np.column_stack(columns)[over.counted])[0]
    past = tuple(_own_past(over.u[over.record == k]) for k in range(over.record[-1] + 1))
    return _Seen(fit, basis, past)


def _own_past(u: Array) -> Array:
    """Return the weights (OWN_PAST,) of the samples before that predict an input (n,) best."""
    n = len(u)
    rows = np.column_stack([u[OWN_PAST - 1 - k : n - 1 - k] for k in range(OWN_PAST)])
    return np.asarray(np.linalg.lstsq(rows, u[OWN_PAST:], rcond=1e-10)[0])


def _behind(signal: Array, samples: float, stages: int) -> Array:
    """Return a signal behind filters of first order, of a time constant [samples] and how many."""
    keep = math.exp(-1.0 / samples) if samples else 0.0
    for _ in range(stages):
        signal = lfilter([1.0 - keep], [1.0, -keep], signal)
    return signal


def _fitted(
    predicted: Array, error: float, position: Array, rate: Array
) -> tuple[float, Array, Array]:
    """Return what actions on position and rate leave of the predicted input, these actions, and
    their standard errors.
    """
    table = -np.column_stack([position, rate])
    actions = np.asarray(np.linalg.lstsq(table, predicted, rcond=1e-12)[0], dtype=float)
    left = predicted - table @ actions
    spread = np.linalg.pinv(table.T @ table, hermitian=True)
    return float(left @ left), actions, np.asarray(error * np.sqrt(np.diag(spread)), dtype=float)


def _frequency(actions: Array, deviations: Array, mobility: float) -> float:
    """Return the natural frequency [rad/s] from the action that is known; 0 from none."""
    proportional, derivative = actions * mobility
    if actions[0] > ACTION_ERRORS * deviations[0]:
        return math.sqrt(proportional)
    return float(max(derivative, 0.0)) / (2 * DAMPING)
