"""A ceiling for the observers: moving-horizon estimation of the joint model from position, by
Gauss-Newton over whole windows.

At each time of the grid it minimises, over the motion at the beginning of the window and all
parameters,
    sum of (y_k - theta_k(x0, p))^2 / r_k  +  (p - p_before)' A (p - p_before),
where A is the information of the data that have left the window, as it was at their last
linearisation (the arrival cost); none if the model did not explain them. What it costs is of no
account here: it solves every window until it stands still, from where the last one ended and from
where self_starting_ekf then is, and takes the better end. The model is that of the joint filters
(observer/kalman.py); there is no process noise, so that disturbance torques other than a constant
one count as a wrong model. Source: rao2003 (moving horizon, arrival cost).
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from condition_records import Array, Condition, Record

from bristle.common.cache import cached, digest
from bristle.harness.metrics.estimates import SETTLING_BAND, settling
from bristle.model.compiler import FLAGS, SUFFIX, compile_shared, compiler_identity
from bristle.model.native import Native
from bristle.observer import kalman, observer_program

SX = ca.SX
NAME = "moving_horizon"
ENTRIES = ("alpha2", "b", "G0", "G1", "G2", "ln_c", "tau", "load", "delay", "ln_width")
MOTION = kalman.MOTION_STATES
ORDER = MOTION + len(ENTRIES)
INPUTS = 4  # the longest delay is one sample less
HORIZON, GRID = 10.0, 5.0  # s: length of the window, and the interval at which it is solved
START_OF_C = 100.0  # 1/rad
START_LEVEL = 0.5  # friction over the rms acceleration by the drive
# of the first one, solved before it, each from the end of the one before
FIRST_WINDOWS = (0.1, 0.2, 0.4)
ROUNDS = 15  # steps of Gauss-Newton a window, at most
STANDSTILL = 1e-6  # relative gain of a step, below which a window is solved
LARGEST_DAMPING = 1e6
SHARED_COUNT = 100.0  # samples with the same count, at most, that share one rounding error
# prior standard deviations; the others have wide ones
SPREAD = {"tau": 0.02, "delay": 1.0, "ln_width": 0.3, "ln_c": 3.0}
# of a valid estimate: sd over the estimate; mean squared residual over the sensor's
VALID_SHARE, LARGEST_MISFIT = 0.07, 2.0
VALID_SHIFT = {"tau": 1e-3, "delay": 0.1}  # sd of what may be zero: s, samples

DRIVER = """
#include <stdlib.h>
#include <string.h>
EXPORT int window_run(long n, const double *p, const double *u, const double *y,
                      const double *options, double *state) {
    casadi_int arguments, results, integers, reals;
    const double *arg[16];
    double *res[16], *w, *next;
    casadi_int *iw;
    long k, size = (long)window_step_sparsity_out(0)[0];
    window_step_work(&arguments, &results, &integers, &reals);
    w = malloc(sizeof(double) * (size_t)(reals + size + 1));
    iw = malloc(sizeof(casadi_int) * (size_t)(integers + 1));
    next = w + reals;
    for (k = 0; k < n; k++) {
        arg[0] = state; arg[1] = p; arg[2] = u + (n - 1 - k); arg[3] = y + k; arg[4] = options;
        res[0] = next;
        window_step(arg, res, iw, w, 0);
        memcpy(state, next, sizeof(double) * (size_t)size);
    }
    free(w); free(iw);
    return 0;
}
"""


def _servo(p: SX) -> kalman.ServoParameters:
    alpha2, b, *levels, ln_c, tau, load, delay, ln_width = ca.vertsplit(p)
    c = ca.exp(ln_c)
    return kalman.ServoParameters(
        alpha2, b, [c * level for level in levels], c, tau, load, delay, ca.exp(ln_width)
    )


def _step() -> ca.Function:
    """Return one sample: motion, its derivatives by (motion at the beginning, parameters), and the
    normal equations so far.
    """
    x, slope = SX.sym("x", MOTION), SX.sym("slope", MOTION, ORDER)
    normal, right, cost = SX.sym("normal", ORDER, ORDER), SX.sym("right", ORDER), SX.sym("cost")
    p, inputs, y, options = (
        SX.sym("p", len(ENTRIES)),
        SX.sym("inputs", INPUTS),
        SX.sym("y"),
        SX.sym("options", 2),
    )
    period, step = options[0], options[1]
    moved = kalman.sample(x, _servo(p), inputs, period)
    by_x, by_p = ca.jacobian(moved, x), ca.jacobian(moved, p)
    slope_new = by_x @ slope
    slope_new[:, MOTION:] += by_p
    same = ca.fmin(ca.fmax(step / ca.fmax(ca.fabs(moved[1]) * period, 1e-12), 1), SHARED_COUNT)
    weight = 1 / (kalman.rounding(step) * same)
    error, row = y + step / 2 - moved[0], slope_new[0, :].T
    normal_new, right_new = normal + weight * row @ row.T, right + weight * row * error
    state = ca.vertcat(x, ca.vec(slope), ca.vec(normal), right, cost)
    following = ca.vertcat(
        moved, ca.vec(slope_new), ca.vec(normal_new), right_new, cost + weight * error**2
    )
    return ca.Function("window_step", [state, p, inputs, y, options], [ca.densify(following)])


@cache
def _library() -> ctypes.CDLL:
    generator = ca.CodeGenerator("window.c", {"with_header": False, "casadi_int": "long long int"})
    generator.add(_step())
    quiet = (
        '#pragma GCC diagnostic ignored "-Wunused-parameter"\n#pragma GCC diagnostic ignored'
        ' "-Wunused-function"\n'
    )
    export = '#define EXPORT __attribute__((visibility("default")))\n'
    source = quiet + generator.dump() + export + DRIVER
    name = f"{NAME}-{digest(source, ' '.join(FLAGS), compiler_identity())[:32]}{SUFFIX}"
    return ctypes.CDLL(str(cached(name, lambda path: compile_shared({"window.c": source}, path))))


class _Data:
    """A record as the windows read it; row k of `y` is what the input k - 1 led to."""

    def __init__(self, condition: Condition, data: Record) -> None:
        self.period, self.step = condition.period, 2 * math.pi / condition.counts
        self.u, self.y = data.u, data.y_theta

    def window(self, first: int, last: int, motion: Array, p: Array) -> tuple[Array, Array, float]:
        """Return (normal matrix, right-hand side, cost) of the samples first + 1 .. last, and let
        `motion` be at their end.
        """
        n = last - first
        earlier = np.concatenate([np.full(INPUTS - 1, self.u[0]), self.u])[
            first : last + INPUTS - 1
        ]
        inputs = np.ascontiguousarray(earlier[::-1])  # the latest first, one more at each sample
        outputs = np.ascontiguousarray(self.y[first + 1 : last + 1])
        state = np.zeros(MOTION + MOTION * ORDER + ORDER**2 + ORDER + 1)
        state[:MOTION] = motion
        state[MOTION : MOTION + MOTION * MOTION] = np.eye(MOTION).ravel()
        options = np.array([self.period, self.step])
        pointers = (
            ctypes.c_void_p(each.ctypes.data)
            for each in (np.ascontiguousarray(p), inputs, outputs, options, state)
        )
        _library().window_run(ctypes.c_long(n), *pointers)
        rest = state[MOTION + MOTION * ORDER :]
        motion[:] = state[:MOTION]
        return rest[: ORDER**2].reshape(ORDER, ORDER), rest[ORDER**2 : -1].copy(), float(rest[-1])


class _Prior:
    """What is known before a window: a mean and information of (motion at its beginning,
    parameters).
    """

    def __init__(self, mean: Array, information: Array) -> None:
        self.mean, self.information = mean, information

    def cost(self, z: Array) -> float:
        return float((z - self.mean) @ self.information @ (z - self.mean))


def _kept(z: Array) -> Array:
    """Return z inside what is physically possible and what the model can be evaluated for."""
    low = dict.fromkeys(("alpha2", "tau", "delay"), 0.0) | {
        "ln_c": 0.0,
        "ln_width": -2.0,
        "G0": 1e-6,
    }
    high = {"delay": INPUTS - 1.0, "ln_c": 12.0, "ln_width": 2.0, "tau": 1.0}
    new = z.copy()
    for i, name in enumerate(ENTRIES, start=MOTION):
        new[i] = min(max(new[i], low.get(name, -math.inf)), high.get(name, math.inf))
    return new


def _solve(
    data: _Data, first: int, last: int, z: Array, prior: _Prior
) -> tuple[Array, Array, Array, float]:
    """Return (entries, motion at the end, information of the window alone, whole cost) of the best
    fit near z.

    Levenberg-Marquardt; entries scaled by their own information.
    Source: nocedal2006 section 10.3.
    """

    def evaluate(z: Array) -> tuple[Array, Array, float, Array]:
        motion = z[:MOTION].copy()
        normal, right, cost = data.window(first, last, motion, z[MOTION:])
        right = right - prior.information @ (z - prior.mean)
        return normal, right, cost + prior.cost(z), motion

    normal, right, cost, end = evaluate(z)
    if not math.isfinite(cost):
        return z, z[:MOTION], np.zeros((ORDER, ORDER)), math.inf
    damping = 1e-3
    for _ in range(ROUNDS):
        whole = normal + prior.information
        scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
        while damping < LARGEST_DAMPING:
            matrix = whole / np.outer(scale, scale) + damping * np.eye(ORDER)
            trial = _kept(z + np.linalg.solve(matrix, right / scale) / scale)
            tried = evaluate(trial)
            if math.isfinite(tried[2]) and tried[2] <= cost:
                break
            damping *= 10
        else:
            break
        gained = cost - tried[2]
        z, (normal, right, cost, end) = trial, tried
        damping = max(damping / 10, 1e-9)
        if gained <= STANDSTILL * cost:
            break
    return z, end, normal, cost


def _start(data: _Data, last: int) -> tuple[Array, _Prior]:
    """Return start values and a wide prior: no true value, only the sizes of speed and input of the
    first window.
    """
    apart = 10  # samples between the positions that give the speed
    v = np.diff(data.y[: last + 1 : apart]) / (apart * data.period)
    a, u = np.diff(v) / (apart * data.period), data.u[apart:last:apart]
    n = min(len(a), len(u))
    alpha2, gain, _ = np.linalg.lstsq(
        np.column_stack([-v[:n], u[:n], -np.sign(v[:n])]), a[:n], rcond=None
    )[0]
    gain = gain or 1.0  # where nothing has moved yet
    speed, push = (
        max(float(np.sqrt(np.mean(v**2))), data.step),
        max(abs(gain) * float(np.std(data.u[: last + 1])), 1e-3),
    )
    spreads = np.array(
        [data.step, speed, push, push / speed, 3 * abs(gain), *[3 * push] * 3, 1, 1, push, 1, 1]
    )
    for name, value in SPREAD.items():
        spreads[MOTION + ENTRIES.index(name)] = value
    viscous, level = max(alpha2, 0.1 * push / speed), START_LEVEL * push
    z = np.array(
        [
            data.y[0] + data.step / 2,
            0,
            0,
            viscous,
            gain,
            level,
            0,
            0,
            math.log(START_OF_C),
            0,
            0,
            0,
            0,
        ]
    )
    return z, _Prior(z.copy(), np.diag(spreads**-2.0))


def _filtered(condition: Condition, data: Record, times: Sequence[int]) -> Array:
    """Return the parameters as self_starting_ekf has them at some samples, shape (times,
    ENTRIES).
    """
    program = observer_program("self_starting_ekf")
    values = {
        "sample_time": condition.period,
        "self_starting_ekf.resolution": 2 * math.pi / condition.counts,
    }
    columns = [f"self_starting_ekf.joint{i}" for i in range(MOTION, ORDER)]
    rows = Native(program, values).run(
        condition.period, {"u": data.u, "y_theta": data.y_theta, "y_v": data.y_v}, columns
    )[0]
    return np.asarray(rows[list(times)])


def _departed(data: _Data, first: int, leaves: int, z: Array, prior: _Prior) -> _Prior:
    """Return the prior of the window that begins at `leaves`: the information of what left it, and
    of the motion none.

    Source: rao2003 (arrival cost by linearisation).
    """
    motion = z[:MOTION].copy()
    normal, right, _ = data.window(first, leaves, motion, z[MOTION:])
    whole = normal + prior.information
    right = right - prior.information @ (z - prior.mean)
    own, cross, other = whole[:MOTION, :MOTION], whole[:MOTION, MOTION:], whole[MOTION:, MOTION:]
    kept = other - cross.T @ np.linalg.solve(own, cross)
    slope = right[MOTION:] - cross.T @ np.linalg.solve(own, right[:MOTION])
    mean = z[MOTION:] + np.linalg.lstsq(kept, slope, rcond=1e-14)[0]
    information = np.zeros((ORDER, ORDER))
    information[MOTION:, MOTION:] = (kept + kept.T) / 2
    information[0, 0] = 1e-12 / data.step**2
    information[1, 1] = information[2, 2] = 1e-12
    return _Prior(np.concatenate([motion, mean]), information)


def _named(p: Array, covariance: Array) -> tuple[dict[str, float], dict[str, float]]:
    """Return estimates and standard deviations by the names of the observers' outputs; sd to first
    order.
    """
    c, levels = math.exp(p[5]), p[2:5]
    values = {
        "alpha2": p[0],
        "b": p[1],
        "Fc": p[2],
        **{f"sigma{i}": c * levels[i] for i in range(3)},
        "c": c,
    }
    values |= {"tau": p[6], "load": p[7], "delay": p[8]}
    slopes = np.zeros((len(values), len(p)))
    for row, column in enumerate((0, 1, 2)):
        slopes[row, column] = 1
    for i in range(3):
        slopes[3 + i, 2 + i], slopes[3 + i, 5] = c, c * levels[i]
    slopes[6, 5] = c
    slopes[7, 6] = slopes[8, 7] = slopes[9, 8] = 1
    spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0))
    return {name: float(x) for name, x in values.items()}, dict(
        zip(values, spread.tolist(), strict=True)
    )


def estimate(condition: Condition, data: Record) -> list[dict[str, Any]]:
    """Return one row for each time of the grid: time, estimates, standard deviations, mean squared
    residual over the sensor's.
    """
    d, first = _Data(condition, data), 0
    rows: list[dict[str, Any]] = []
    per, longest = round(GRID / condition.period), round(HORIZON / condition.period)
    ends = range(per, len(data.u), per)
    filtered = _filtered(condition, data, ends)
    z, prior = _start(d, per)
    beginning, unknown = z[:MOTION], prior.information
    for share in FIRST_WINDOWS:
        z = _solve(d, 0, round(share * per), z, prior)[0]
    for last, other in zip(ends, filtered, strict=True):
        if last - first > longest:
            explained = rows[-1]["misfit"] < LARGEST_MISFIT
            prior = _departed(d, first, first + per, z, prior if explained else _Prior(z, unknown))
            first += per
            beginning = prior.mean[:MOTION]
            z = np.concatenate([beginning, z[MOTION:]])
        starts = [z] + ([_kept(np.concatenate([beginning, other]))] if other[1] else [])
        z, _, normal, cost = min(
            (_solve(d, first, last, start, prior) for start in starts), key=lambda each: each[3]
        )
        misfit = cost / (last - first)
        covariance = np.linalg.pinv(normal + prior.information, hermitian=True)[MOTION:, MOTION:]
        values, spread = _named(
            z[MOTION:], np.asarray(covariance * min(max(misfit, 1.0), 1e12), dtype=np.float64)
        )
        rows.append(
            {
                "time": last * condition.period,
                "values": values,
                "sd": spread,
                "misfit": min(misfit, 1e12),
            }
        )
    return rows


def _valid(row: dict[str, Any]) -> dict[str, bool]:
    """Return which estimates count, by the criteria of self_starting_ekf."""
    values = row["values"]
    sizes = values | {f"sigma{i}": values["sigma0"] for i in range(3)} | {"load": values["Fc"]}
    limits = {name: VALID_SHARE * abs(size) for name, size in sizes.items()} | VALID_SHIFT
    return {
        name: row["misfit"] < LARGEST_MISFIT and row["sd"][name] < limits[name] for name in values
    }


def observe(condition: Condition, data: Record, judged: Sequence[str]) -> dict[str, Any]:
    """Return the result in the form of that of a method (run.py), with the times of the grid."""
    rows = estimate(condition, data)
    valid = [_valid(row) for row in rows]
    names = [name for name in rows[-1]["values"] if name in data.true]
    compared = [name for name in names if name in judged]
    off = [
        max(
            abs(100 * (row["values"][n] / data.true[n] - 1)) if ok[n] else math.inf
            for n in compared
        )
        for row, ok in zip(rows, valid, strict=True)
    ]
    second = settling(np.array([row["time"] for row in rows]), np.array(off), SETTLING_BAND)
    return {
        "true": {name: data.true[name] for name in names},
        "final": {name: rows[-1]["values"][name] for name in names},
        "sd": {name: rows[-1]["sd"][name] for name in names},
        "valid": {name: valid[-1][name] for name in names},
        "settled_s": max(second, GRID) if math.isfinite(second) else None,
        "innovation": rows[-1]["misfit"],
        "changes": 0.0,
    }
