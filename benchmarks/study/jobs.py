"""Computations of the study for one record: every method, the baselines, the floor. One file of
results a record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import presliding_benchmark
from fits import bound, fit, neutral, simulated
from numpy.typing import NDArray
from standard_records import LOAD_CHANGE_TIME, RECORD_STEP, TRUE_PARAMETERS, changed, record

from bristle.common.errors import SimulationError
from bristle.common.metrics import mse_percent
from bristle.harness.metrics.estimates import (
    LOAD_PROPORTIONAL,
    SETTLING_BAND,
    error_percent,
    settling,
)
from bristle.harness.metrics.fit import Data, regression
from bristle.model.native import Native
from bristle.model.variables import Parameter
from bristle.observer import methods, observer_program
from bristle.observer.method import observer

Array = NDArray[np.float64]
Json = dict[str, Any]
BEST = "self_starting_ekf"
STUDY_SECONDS = 200.0
CHECKS = (60.0, STUDY_SECONDS)  # s, when estimates are judged
SECOND_RECORD = 100.0
BOUNDS = (15.0, 60.0)  # s, when errors are compared with the information bound
SENSOR_SIGNALS = {"clean": ("y_theta", "y_v"), "encoder": ("encoder", "encoder_v")}
LEAN = {  # a lean model's parameters by the estimates they come from
    "modified": {
        "b": "b",
        "a2": "alpha2",
        "modified.sigma0": "sigma0",
        "modified.sigma1": "sigma1",
        "modified.sigma2": "sigma2",
        "modified.c": "c",
    },
    "coulomb": {"b": "b", "a2": "alpha2", "coulomb.Fc": "Fc"},
    "viscous": {"b": "b", "a2": "alpha2"},
}
LEAST = {
    "a2": 0.0,
    "modified.sigma0": 1e-6,
    "modified.c": 1e-6,
    "modified.tau": 0.0,
    "coulomb.Fc": 0.0,
}
START_RATIO = 10.0  # largest ratio of a start value to the true value, or the inverse
ESTIMATED_PARAMETERS = ("alpha2", "b", "sigma0", "sigma1", "sigma2", "c")
STUDY_RESOLUTION = 2 * math.pi / 40000


def estimators() -> list[str]:
    """Return the methods that estimate some of the parameters at all."""
    return [name for name in methods() if estimated(name)]


def known(method: str) -> list[Parameter]:
    """Return the parameters of a method by which it is given what it does not estimate."""
    return [p for p in methods()[method].parameters if p.description.endswith("known")]


def known_values(method: str, true: Mapping[str, float] = TRUE_PARAMETERS["S"]) -> dict[str, float]:
    """Return what a method takes as known, with true values (all plants have the same servo)."""
    return {p.name: true[p.symbol] for p in known(method)}


def estimated(method: str) -> list[str]:
    """Return the names of all estimates of a method, valid or not, in the order of the tables."""
    outputs = {
        variable.name: expression
        for variable, expression in observer(methods()[method]).outputs.values()
    }
    return [name for name in ESTIMATED_PARAMETERS if not outputs[f"{name}_hat"].is_constant()]


def observed(
    method: str,
    data: Mapping[str, Array],
    sensor: str,
    values: Mapping[str, float],
    step: float = RECORD_STEP,
) -> tuple[Array, Array, str | None]:
    """Return (estimates of alpha2, b, sigma_i, c, Fc, tau for each t_k, validity, why it ended
    early).
    """
    names = (*ESTIMATED_PARAMETERS, "Fc", "tau")
    theta, velocity = SENSOR_SIGNALS[sensor]
    inputs = {"u": data["u"], "y_theta": data[theta], "y_v": data[velocity]}
    instance = Native(
        observer_program(method), {"sample_time": step, **known_values(method), **values}
    )
    columns = [*(f"{name}_hat" for name in names), *(f"{name}_valid" for name in names)]
    try:
        out, _ = instance.run(step, inputs, columns)
    except SimulationError as error:
        nothing = np.full((len(data["u"]), len(names)), np.nan)
        return nothing, np.zeros_like(nothing), str(error)
    rows = out[1:]
    return rows[:, : len(names)], rows[:, len(names) :], None


def validation(final: Mapping[str, float], second: Mapping[str, Array]) -> tuple[str | None, float]:
    """Return (the richest lean model that the estimates make, eq. (25) in % on the second
    record).
    """
    for law, names in LEAN.items():
        if all(math.isfinite(final[name]) for name in names.values()):
            values = {parameter: final[name] for parameter, name in names.items()}
            if law == "modified" and math.isfinite(final["tau"]):
                values["modified.tau"] = final["tau"]
            values = {
                name: max(value, LEAST.get(name, -math.inf)) for name, value in values.items()
            }
            return law, mse_percent(second["y_v"], simulated(law, values, second["u"]))
    return None, math.nan


def errors(
    method: str, rows: Array, valid: Array, true: Mapping[str, float]
) -> tuple[list[str], Array]:
    """Return the names of what a method has estimated and the truth is known of, and the errors [%]
    (samples, names).

    What is not valid has no error. Parameters as `observed` returns them.
    """
    given = [p.symbol for p in known(method)]
    places = [
        i
        for i, name in enumerate(ESTIMATED_PARAMETERS)
        if name in true and name not in given and np.isfinite(rows[-1, i])
    ]
    names = [ESTIMATED_PARAMETERS[i] for i in places]
    hats = np.where(valid[:, places] > 0, rows[:, places], np.nan)
    return names, error_percent(hats, np.array([true[name] for name in names]))


def settled(error: Array) -> float | None:
    """Return when errors [%] of (samples, parameters) are within the band for good [s]; None:
    never, or there are none.
    """
    if not error.shape[1]:
        return None
    second = settling(
        np.array(RECORD_STEP * np.arange(1, len(error) + 1), float), np.abs(error).max(axis=1)
    )
    return second if math.isfinite(second) else None


def judged(
    method: str,
    plant: str,
    data: Mapping[str, Array],
    second: Mapping[str, Array],
    sensor: str,
    checks: tuple[float, ...] = CHECKS,
) -> Json:
    """Return what one method reaches on one record."""
    given = {p.symbol: TRUE_PARAMETERS["S"][p.symbol] for p in known(method)}
    rows, valid, failure = observed(method, data, sensor, {})
    names, error = errors(method, rows, valid, TRUE_PARAMETERS.get(plant, {}))
    out: Json = {"failure": failure, "settling_s": settled(error), "checks": {}}
    for check in checks:
        k = round(check / RECORD_STEP) - 1
        final = {
            name: float(rows[k, i]) if valid[k, i] > 0 else math.nan
            for i, name in enumerate((*ESTIMATED_PARAMETERS, "Fc", "tau"))
        }
        law, mse = validation(final | given, second)
        off = dict(zip(names, error[k].tolist(), strict=True))
        out["checks"][f"{check:g}"] = {"errors": off, "law": law, "mse": mse, "estimates": final}
    return out


def baselines(
    data: Mapping[str, Array], second: Mapping[str, Array], best: Mapping[str, float]
) -> Json:
    """Return eq. (25) on the second record of what is fitted to the first 60 s of the clean
    velocity.
    """
    n = round(CHECKS[0] / RECORD_STEP)
    u, v = data["u"][:n], data["y_v"][:n]
    alpha2, b, friction = regression(Data(u, v, RECORD_STEP))
    starts = {law: neutral(law, b, alpha2, friction) for law in LEAN}
    if all(math.isfinite(best[name]) for name in LEAN["modified"].values()):
        from_best = {parameter: best[name] for parameter, name in LEAN["modified"].items()}
        starts["modified"].append(from_best | {"modified.tau": max(best["tau"], 1e-6)})
    found = {law: fit(law, u, v, starts[law]) for law in LEAN}
    return {
        law: {
            "parameters": each.parameters,
            "identification": each.mse_percent,
            "mse": mse_percent(second["y_v"], simulated(law, each.parameters, second["u"])),
        }
        for law, each in found.items()
    }


def information(plant: str, data: Mapping[str, Array]) -> Json:
    """Return the information bound of the six parameters, relative, at some times."""
    true = TRUE_PARAMETERS[plant]
    values = {parameter: true[name] for parameter, name in LEAN["modified"].items()} | {
        "modified.tau": 0.0
    }
    n = round(CHECKS[0] / RECORD_STEP)
    found = bound(values, data["u"][:n], STUDY_RESOLUTION, BOUNDS)
    order = [list(LEAN["modified"].values()).index(name) for name in ESTIMATED_PARAMETERS]
    return {f"{second:g}": [float(each[i]) for i in order] for second, each in found.items()}


def spread_starts(method: str, plant: str, random: np.random.Generator) -> dict[str, float]:
    """Return starts of a method's estimates, each up to ten times too large or too small."""
    values = {}
    for p in methods()[method].parameters:
        name = started(method, p.name)
        if name in TRUE_PARAMETERS[plant]:
            values[p.name] = float(
                np.clip(
                    TRUE_PARAMETERS[plant][name] * START_RATIO ** random.uniform(-1.0, 1.0),
                    p.minimum,
                    p.maximum,
                )
            )
    return values


def whole(plant: str, order: int, seed: int) -> Json:
    """Return all results on one record."""
    data, second = (
        record(plant, order, seed, STUDY_SECONDS),
        record(plant, order, 1000 + seed, SECOND_RECORD),
    )
    out: Json = {
        sensor: {method: judged(method, plant, data, second, sensor) for method in estimators()}
        for sensor in SENSOR_SIGNALS
    }
    best = out["encoder"][BEST]["checks"][f"{CHECKS[0]:g}"]["estimates"]
    out["baselines"] = baselines(data, second, best)
    out["changes"] = int(starts_of_best(data) - 1)
    return out


def best_alone(plant: str, order: int, seed: int) -> Json:
    """Return what the best method reaches from the encoder on one more record, with the
    baselines.
    """
    data, second = (
        record(plant, order, seed, CHECKS[0]),
        record(plant, order, 1000 + seed, SECOND_RECORD),
    )
    entry = judged(BEST, plant, data, second, "encoder", CHECKS[:1])
    out: Json = {"encoder": {BEST: entry}}
    out["baselines"] = baselines(data, second, entry["checks"][f"{CHECKS[0]:g}"]["estimates"])
    out["changes"] = int(starts_of_best(data) - 1)
    return out


def against_the_bound(plant: str, order: int, seed: int) -> Json:
    """Return the relative errors of the best method from the encoder, and the information bound, at
    some times.
    """
    data = record(plant, order, seed, CHECKS[0])
    rows, _, _ = observed(BEST, data, "encoder", {})
    true = np.array([TRUE_PARAMETERS[plant][name] for name in ESTIMATED_PARAMETERS])
    off = {
        f"{second:g}": (
            rows[round(second / RECORD_STEP) - 1, : len(ESTIMATED_PARAMETERS)] / true - 1
        ).tolist()
        for second in BOUNDS
    }
    return {"errors": off, "bound": information(plant, data)}


def two_bodies(plant: str, order: int, seed: int) -> Json:
    """Return for each method the errors at the end of a record of the two rubbing bodies, in %.

    Methods get the benchmark's start values for what they have a start of, and the true ones of
    what they take as known.
    """
    data, out = presliding_benchmark.record(seed), dict[str, Json]()
    for sensor in SENSOR_SIGNALS:
        out[sensor] = {}
        for method in estimators():
            declared = methods()[method].parameters
            begin = {
                p.name: presliding_benchmark.SET_Z_START[name]
                for p in declared
                if (name := started(method, p.name)) in presliding_benchmark.SET_Z_START
            }
            rows, valid, failure = observed(
                method,
                data,
                sensor,
                begin | known_values(method, presliding_benchmark.SET_Z_TRUE),
                presliding_benchmark.SET_Z_STEP,
            )
            names, error = errors(method, rows, valid, presliding_benchmark.SET_Z_TRUE)
            out[sensor][method] = {
                "errors": dict(zip(names, error[-1].tolist(), strict=True)),
                "failure": failure,
            }
    return out


def started(method: str, parameter: str) -> str:
    """Return what a parameter of a method is the start value of; for another parameter, no known
    name.
    """
    return (
        parameter.removeprefix(f"{method}.").removesuffix("_start")
        if parameter.endswith("_start")
        else ""
    )


def starts_of_best(data: Mapping[str, Array]) -> float:
    """Return how often the best method has started on the first 60 s of the encoder's record."""
    n = round(CHECKS[0] / RECORD_STEP)
    inputs = {"u": data["u"][:n], "y_theta": data["encoder"][:n], "y_v": data["y_v"][:n]}
    out, _ = Native(observer_program(BEST)).run(RECORD_STEP, inputs, [f"{BEST}.starts"])
    return float(out[-1, 0])


def after_a_change(plant: str, order: int, seed: int) -> Json:
    """Return for each method how long it takes to be within 5 % again after the normal load has
    doubled at 60 s.
    """
    data = changed(plant, order, seed)
    out: Json = {}
    true = {
        name: 2.0 * value if name in LOAD_PROPORTIONAL else value
        for name, value in TRUE_PARAMETERS[plant].items()
    }
    for method in estimators():
        rows, valid, failure = observed(method, data, "encoder", {})
        _, error = errors(method, rows, valid, true)
        out[method] = {
            "back_s": settled(error[round(LOAD_CHANGE_TIME / RECORD_STEP) :]),
            "failure": failure,
        }
    return out


def from_spread_starts(plant: str, order: int, seed: int, runs: int) -> Json:
    """Return for each method that has starts how often it is not within 5 % at 60 s, valid or not,
    from starts that are far off.
    """
    data = {
        name: values[: round(CHECKS[0] / RECORD_STEP)]
        for name, values in record(plant, order, seed, CHECKS[0]).items()
    }
    out: Json = {}
    for method in estimators():
        random, failed = np.random.default_rng([order, seed]), 0
        if not spread_starts(method, plant, np.random.default_rng(0)):
            continue
        for _ in range(runs):
            rows, _, failure = observed(
                method, data, "encoder", spread_starts(method, plant, random)
            )
            names, error = errors(method, rows, np.ones_like(rows), TRUE_PARAMETERS[plant])
            failed += (
                failure is not None
                or not names
                or not bool((np.abs(error[-1]) <= SETTLING_BAND).all())
            )
        out[method] = {"runs": runs, "failed": failed}
    return out
