"""Output-error fits of lean plant FMUs to a record (u, y): baselines and the best-fit floor."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from bristle.common.metrics import mse_percent
from bristle.common.signals import Array
from bristle.fmus.host import Fmu
from bristle.harness.cosim.drive import Drive

FIT_THREADS = 2  # simulations at a time
FIRST_STAGE_SECONDS = 15.0  # s at the start of the record, on which start values are compared
REFINED_STARTS = 2  # start values that are refined on the whole record
DIFFERENCE_STEP = 1e-3  # step of the finite differences, in scaled parameters
# of a parameter: it may change by a factor of 1e4 from its start value, up or down
LOG_RANGE = math.log(1e4)
FAST_SHARE = 0.2  # of the rms speed; slower samples are left out of the regression for start values
REGRESSION_FILTER = 30.0  # rad/s: first-order filter of that regression
# parameters that may be 0, hence no logarithms
MAY_VANISH = ("modified.sigma1", "modified.sigma2", "modified.tau")
MAY_VANISH_UNIT = 1e-6  # SI: least scale of these
# of the variance: a fit that leaves less has converged; the rest is the integrator's rounding
NEGLIGIBLE_COST = 1e-12
UNBOUNDED_U = 1e6  # V: a record holds the voltage behind the drive's limit

# The parameters of each lean model, with J = 1 kg.m2: acceleration instead of torque.
LEAN_PARAMETERS = {
    "viscous": ("b", "a2"),
    "coulomb": ("b", "a2", "coulomb.Fc"),
    "modified": (
        "b",
        "a2",
        "modified.sigma0",
        "modified.sigma1",
        "modified.sigma2",
        "modified.c",
        "modified.tau",
    ),
}


@dataclass(frozen=True)
class Data:
    """A record for fitting: u_k acts from t_k to t_k+1, y_k is the velocity at t_k.

    `increments` says that y comes from differences of position, so that the model's is computed
    likewise.
    """

    u: Array
    y: Array
    h: float
    increments: bool = False
    v_start: float = 0.0

    def head(self, seconds: float) -> Data:
        """Return the first part."""
        n = min(len(self.u), max(2, round(seconds / self.h)))
        return Data(self.u[:n], self.y[:n], self.h, self.increments, self.v_start)


@dataclass
class LeanFit:
    """A fitted lean model."""

    model: str
    parameters: dict[str, float]
    mse_percent: float
    at_bound: list[str] = field(default_factory=list)
    runs: int = 0


class LeanModel:
    """A lean plant FMU that predicts y from u, for many sets of parameters at once on all threads;
    `fixed` are not free.
    """

    def __init__(self, law: str, fmu: Fmu, fixed: Mapping[str, float] | None = None) -> None:
        self.law, self.fmu = law, fmu
        self._fixed = {"J": 1.0, "u_max": UNBOUNDED_U, **(fixed or {})}
        self.free = tuple(name for name in LEAN_PARAMETERS[law] if name not in self._fixed)
        names = [*self.free, *self._fixed, "v_start"]
        self._drives: list[Drive] = []
        self._pool = ThreadPoolExecutor(FIT_THREADS)
        self.runs = 0
        try:
            for _ in range(FIT_THREADS):
                self._drives.append(Drive(fmu, ["u"], ["theta", "v"], names))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Stop what is running and free the FMUs."""
        for drive in self._drives:
            drive.control[1] = 1
        self._pool.shutdown(wait=True)
        for drive in self._drives:
            drive.close()

    def __enter__(self) -> LeanModel:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def bounds(self) -> tuple[Array, Array]:
        """Return the FMU's own intervals of the free parameters."""
        both = np.array([self.fmu.interval(name) for name in self.free])
        return both[:, 0], both[:, 1]

    def predict(self, data: Data, sets: Array) -> Array:
        """Return the predicted y, shape (sets, samples); NaN where a simulation failed."""
        constant = np.array([*self._fixed.values(), data.v_start])
        table = np.column_stack([sets, np.tile(constant, (len(sets), 1))])
        series = data.u[:-1, None]
        self.runs += len(sets)

        def job(drive: Drive, part: Array) -> Array:
            out = drive.run(series, part, data.h)
            if not data.increments:
                return out[:, :, 1]
            steps = np.diff(out[:, :, 0], axis=1) / data.h
            return np.concatenate(
                [steps[:, :1] if data.v_start else np.zeros((len(part), 1)), steps], axis=1
            )

        parts = np.array_split(table, FIT_THREADS)
        jobs = [
            self._pool.submit(job, drive, part)
            for drive, part in zip(self._drives, parts, strict=True)
            if len(part)
        ]
        return np.concatenate([done.result() for done in jobs])

    def score(self, data: Data, parameters: Mapping[str, float]) -> tuple[float, Array]:
        """Return eq. (25) and the prediction for one set of parameters."""
        [predicted] = self.predict(data, np.array([[parameters[name] for name in self.free]]))
        return mse_percent(data.y, predicted), predicted


def regression(data: Data, coulomb: bool = True) -> tuple[float, float, float]:
    """Return (a2, b, Fc) of v' = b u - a2 v - Fc sgn v by linear least squares on filtered signals,
    at speed.

    It needs no start values itself; its results are start values of the fits.
    """
    from scipy.signal import lfilter

    pole = math.exp(-REGRESSION_FILTER * data.h)

    def smooth(x: Array) -> Array:
        return np.asarray(lfilter([1 - pole], [1, -pole], x))

    v = smooth(data.y)
    rate = REGRESSION_FILTER * (data.y - v)
    columns = [-v, smooth(data.u), *([-smooth(np.sign(data.y))] if coulomb else [])]
    fast = np.abs(v) > FAST_SHARE * float(np.sqrt(np.mean(v**2)))
    coefficients, *_ = np.linalg.lstsq(np.column_stack(columns)[fast], rate[fast], rcond=None)
    a2, b = float(coefficients[0]), float(coefficients[1])
    return a2, b, float(coefficients[2]) if coulomb else 0.0


def starts(model: str, data: Data) -> list[dict[str, float]]:
    """Return neutral start values: the regression's, and presliding distances over two decades.

    The scale of the presliding distance 1/c is the distance between two reversals; true values are
    not used.
    """
    a2, b, friction = regression(data, coulomb=model != "viscous")
    spread = float(np.std(data.y))
    b = b or 1.0
    floor = 1e-3 * abs(b) * float(np.std(data.u))  # rad/s2: a negligible acceleration
    a2, friction = max(a2, floor / max(spread, 1e-300)), max(friction, floor)
    base = {"b": b, "a2": a2}
    if model == "viscous":
        return [base]
    if model == "coulomb":
        return [base | {"coulomb.Fc": friction}]
    reversals = max(
        1, int(np.sum(np.diff(np.sign(data.y[np.abs(data.y) > FAST_SHARE * spread])) != 0))
    )
    distance = float(np.sum(np.abs(data.y))) * data.h / reversals
    return [
        base
        | {
            "modified.sigma0": friction * c,
            "modified.sigma1": 0.3 * friction * c,
            "modified.sigma2": 0.3 * friction * c,
            "modified.c": c,
            "modified.tau": tau,
        }
        for c, tau in ((30 / distance, 1e-3), (100 / distance, 1e-2), (300 / distance, 1e-3))
    ]


class _Converged(Exception):
    """Leaves the optimiser when the remaining cost is negligible."""


class _Problem:
    """Least squares in scaled parameters: logarithms, or plain values where zero is likely."""

    def __init__(self, model: LeanModel, data: Data, start: Mapping[str, float]) -> None:
        self.model, self.data = model, data
        values = np.array([start[name] for name in model.free])
        low, high = model.bounds()
        self.plain = np.array([name in MAY_VANISH for name in model.free])
        self.unit = np.where(
            self.plain, np.maximum(np.abs(values), MAY_VANISH_UNIT), np.sign(values)
        )
        self.x0 = self._inverse(values)
        with np.errstate(divide="ignore", invalid="ignore"):
            least = np.log(np.maximum(low, 1e-300))
            most = np.log(high)
        self.low = np.where(self.plain, low / self.unit, np.maximum(self.x0 - LOG_RANGE, least))
        self.high = np.where(
            self.plain,
            np.minimum(high / self.unit, math.exp(LOG_RANGE)),
            np.minimum(self.x0 + LOG_RANGE, most),
        )
        self.x0 = np.clip(self.x0, self.low + 1e-6, self.high - 1e-6)
        self.scale = float(np.std(data.y)) * math.sqrt(len(data.y))
        self.best: tuple[float, Array] = (math.inf, self.x0)
        self._known: tuple[Array, Array] | None = None

    def _inverse(self, values: Array) -> Array:
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(self.plain, values / self.unit, np.log(np.abs(values))))

    def values(self, x: Array) -> Array:
        """Return the parameters at a point, or at several (one a row)."""
        return np.asarray(self.unit * np.where(self.plain, x, np.exp(np.where(self.plain, 0.0, x))))

    def residuals(self, points: Array) -> Array:
        """Return the errors at several points; a failed simulation has a large error everywhere."""
        error = (self.model.predict(self.data, self.values(points)) - self.data.y) / self.scale
        return np.where(np.isfinite(error), error, 1e3 / math.sqrt(len(self.data.y)))

    def residual(self, x: Array) -> Array:
        """Return the errors at a point."""
        [error] = self.residuals(x[None, :])
        self._known = (x.copy(), error)
        cost = float(error @ error)
        if cost < self.best[0]:
            self.best = (cost, x.copy())
        if cost < NEGLIGIBLE_COST:
            raise _Converged
        return np.asarray(error)

    def jacobian(self, x: Array) -> Array:
        """Return finite differences, all in one batch."""
        direction = np.where(x + DIFFERENCE_STEP > self.high, -DIFFERENCE_STEP, DIFFERENCE_STEP)
        shifted = self.residuals(x + np.diag(direction))
        base = (
            self._known[1]
            if self._known is not None and np.array_equal(self._known[0], x)
            else self.residual(x)
        )
        return np.asarray(((shifted - base) / direction[:, None]).T)

    def solve(self, evaluations: int, tolerance: float) -> tuple[float, Array]:
        """Return the lowest cost found and its point."""
        from scipy.optimize import least_squares

        with contextlib.suppress(_Converged):
            least_squares(
                self.residual,
                self.x0,
                self.jacobian,
                bounds=(self.low, self.high),
                x_scale="jac",
                max_nfev=evaluations,
                ftol=tolerance,
                xtol=1e-5,
                gtol=1e-12,
            )
        return self.best

    def stuck(self, x: Array) -> list[str]:
        """Return the parameters that ended at a bound, apart from those that may vanish."""
        at = (x < self.low + 1e-3) & ~self.plain | (x > self.high - 1e-3)
        return [name for name, there in zip(self.model.free, at, strict=True) if there]


def fit(
    model: LeanModel, data: Data, candidates: Sequence[Mapping[str, float]] | None = None
) -> LeanFit:
    """Fit a lean model: all start values on the record's first part, the best on the whole."""
    before = model.runs
    points = [
        dict(start) for start in (candidates if candidates is not None else starts(model.law, data))
    ]
    head = data.head(FIRST_STAGE_SECONDS)
    if len(head.u) < len(data.u) and len(points) > 1:
        points = _distinct(
            sorted(
                (_solve(model, head, start, 15, 1e-3) for start in points),
                key=lambda solution: solution[0],
            )
        )
    best = min(
        (_solve(model, data, start, 25, 1e-4) for start in points), key=lambda solution: solution[0]
    )
    _, parameters, stuck = best
    return LeanFit(
        model.law, parameters, model.score(data, parameters)[0], stuck, model.runs - before
    )


Solved = tuple[float, dict[str, float], list[str]]


def _solve(
    model: LeanModel, data: Data, start: Mapping[str, float], evaluations: int, tolerance: float
) -> Solved:
    problem = _Problem(model, data, start)
    cost, x = problem.solve(evaluations, tolerance)
    return cost, dict(zip(model.free, problem.values(x).tolist(), strict=True)), problem.stuck(x)


def _distinct(ranked: Sequence[Solved]) -> list[dict[str, float]]:
    """Keep the best result, and the next one only if it differs at a comparable cost."""
    kept = [ranked[0][1]]
    for cost, values, _ in ranked[1:]:
        apart = max(
            abs(values[n] - kept[0][n]) / (abs(kept[0][n]) + 1e-9)
            for n in values
            if n not in MAY_VANISH
        )
        if len(kept) < REFINED_STARTS and apart > 0.05 and cost < 2 * ranked[0][0]:
            kept.append(values)
    return kept
