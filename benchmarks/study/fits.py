"""Output-error fits of lean models to a record, with exact derivatives: baselines, floor and
information bound.

The study's own, beside bristle.harness.metrics.fit, which fits FMUs by finite differences:
hundreds of fits have to be quick here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from standard_records import RECORD_STEP

from bristle.common.errors import SimulationError
from bristle.common.metrics import mse_percent
from bristle.harness.metrics.fit import LEAN_PARAMETERS
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.plant.servo import servo_program

Array = NDArray[np.float64]
# acceleration instead of torque; the record holds the voltage after saturation
FIXED = {"J": 1.0, "u_max": 1e6}
LOW = {"b": -np.inf, "modified.sigma1": -np.inf, "modified.sigma2": -np.inf}
LEAN_LOWER_BOUND = 1e-9
NUDGE = 1e-6  # rad/s


@cache
def program(law: str, derivatives: bool) -> Program:
    """Return the lean servo."""
    return servo_program(
        law, encoder=False, sensitivities=LEAN_PARAMETERS[law] if derivatives else ()
    )


def simulated(law: str, parameters: Mapping[str, float], u: Array) -> Array:
    """Return the velocity under held inputs, a value a sample; NaN where it cannot be simulated."""
    try:
        out, _ = Native(program(law, False), {**FIXED, **parameters}).run(
            RECORD_STEP, {"u": u}, ["v"]
        )
    except SimulationError:
        return np.full(len(u), np.nan)
    return np.asarray(out[:-1, 0])


@dataclass(frozen=True)
class Fitted:
    """A lean model after its fit; `mse_percent` is on the record it was fitted to."""

    law: str
    parameters: dict[str, float]
    mse_percent: float


def fit(
    law: str, u: Array, v: Array, starts: Sequence[Mapping[str, float]], evaluations: int = 30
) -> Fitted:
    """Return the best of the fits of the velocity from some starts."""
    names, scale = LEAN_PARAMETERS[law], float(np.std(v)) * np.sqrt(len(v))
    low = np.array([LOW.get(name, LEAN_LOWER_BOUND) for name in names])

    def run(x: Array) -> tuple[Array, Array]:
        values = {**FIXED, **dict(zip(names, x.tolist(), strict=True))}
        try:
            out, slopes = Native(program(law, True), values).run(
                RECORD_STEP, {"u": u}, ["v"], sensitivities=True
            )
        except SimulationError:
            return np.full(len(v), 1e3 / np.sqrt(len(v))), np.zeros((len(v), len(names)))
        assert slopes is not None
        return (out[:-1, 0] - v) / scale, slopes[:-1, 1, :] / scale

    found = []
    for start in starts:
        x0 = np.maximum([start[name] for name in names], low + LEAN_LOWER_BOUND)
        known: dict[bytes, tuple[Array, Array]] = {}

        def at(x: Array, part: int, known: dict[bytes, tuple[Array, Array]] = known) -> Array:
            if x.tobytes() not in known:
                known.clear()
                known[x.tobytes()] = run(x)
            return known[x.tobytes()][part]

        best = least_squares(
            lambda x, at=at: at(x, 0),
            x0,
            lambda x, at=at: at(x, 1),
            bounds=(low, np.inf),
            x_scale="jac",
            max_nfev=evaluations,
            ftol=1e-7,
            xtol=1e-9,
        )
        found.append((best.cost, best.x))
    _, x = min(found, key=lambda each: each[0])
    parameters = dict(zip(names, map(float, x), strict=True))
    return Fitted(law, parameters, mse_percent(v, simulated(law, parameters, u)))


def neutral(law: str, b: float, alpha2: float, friction: float) -> list[dict[str, float]]:
    """Return start values from a regression at high speed, with presliding distances over a
    decade.
    """
    base = {"b": b, "a2": max(alpha2, LEAN_LOWER_BOUND)}
    if law == "viscous":
        return [base]
    if law == "coulomb":
        return [base | {"coulomb.Fc": friction}]
    levels = {
        "modified.sigma0": friction,
        "modified.sigma1": 0.5 * friction,
        "modified.sigma2": 0.3 * friction,
    }
    return [
        base
        | {name: c * level for name, level in levels.items()}
        | {"modified.c": c, "modified.tau": tau}
        for c, tau in ((150.0, 1e-3), (50.0, 2e-2))
    ]


def bound(
    parameters: Mapping[str, float], u: Array, resolution: float, seconds: Sequence[float]
) -> dict[float, Array]:
    """Return the Cramer-Rao standard deviation of each free parameter of the modified model,
    relative, at some times.

    Position with white noise of resolution^2/12; the start (theta, v) is unknown, w is at rest.
    Derivatives by v are differences.
    """
    names = LEAN_PARAMETERS["modified"]
    values = {**FIXED, **parameters}
    out, slopes = Native(program("modified", True), values).run(
        RECORD_STEP, {"u": u}, ["theta"], sensitivities=True
    )
    assert slopes is not None
    columns = [
        slopes[:-1, 0, i] * values[name] for i, name in enumerate(names) if name != "modified.tau"
    ]
    columns.append(slopes[:-1, 0, names.index("modified.tau")])
    columns.append(np.ones(len(u)))
    moved, _ = Native(program("modified", False), {**values, "v_start": NUDGE}).run(
        RECORD_STEP, {"u": u}, ["theta"]
    )
    columns.append((moved[:-1, 0] - out[:-1, 0]) / NUDGE)
    whole = np.column_stack(columns)
    found = {}
    for second in seconds:
        rows = whole[: round(second / RECORD_STEP)]
        information = rows.T @ rows / (resolution**2 / 12)
        found[second] = np.sqrt(np.diag(np.linalg.inv(information)))[: len(names) - 1]
    return found
