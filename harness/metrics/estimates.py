"""Errors of estimates against the true values, and checks of result.json; NaN fails one."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.signals import Array
from bristle.fmus.host import Fmu, Value
from bristle.harness.cosim.bus import BusTrace, Port

SETTLING_BAND = 5.0  # percent of the true value; settling is the last time the error exceeds it
# true values that grow in proportion to the normal load
LOAD_PROPORTIONAL = ("Fc", "sigma0", "sigma1", "sigma2")
LATE_ERROR_SHARE = 0.1  # share of the run, at its end, over which the late state errors are taken


def error_percent(estimate: Array, true: Array | float) -> Array:
    """Return the signed error in percent of the true value."""
    with np.errstate(all="ignore"):
        return np.asarray(100.0 * (estimate - true) / np.abs(true))


def settling(time: Array, error: Array, band: float = SETTLING_BAND) -> float:
    """Return the last time |error| exceeds the band: 0 if never, NaN if still at the end."""
    outside = np.flatnonzero(~(np.abs(error) <= band))
    if not len(outside):
        return 0.0
    return float(time[outside[-1]]) if outside[-1] < len(time) - 1 else math.nan


@dataclass(frozen=True)
class Course:
    """What an observer published of one parameter, a row each sample: estimate, standard deviation,
    and whether it counts.

    A standard deviation of 0 stands for none; `adapted` is None if the observer does not say.
    """

    hat: Array
    valid: Array
    sd: Array | None = None
    adapted: bool | None = None
    unit: str = "1"


def estimate(time: Array, course: Course, true: Array | None = None) -> dict[str, Any]:
    """Return final value, standard deviation, validity, error and settling time of one parameter.

    `true` belongs to the same rows as `hat`; a sample that is not valid or not finite counts as an
    infinite error. `moved_percent` is the largest excursion from the first value: 0 of an observer
    that does not adapt.
    """
    hat = course.hat
    sound = course.valid.astype(bool) & np.isfinite(hat)
    finite = hat[np.isfinite(hat)]
    moved = float(np.max(np.abs(finite - finite[0]))) if len(finite) else math.nan
    spread = 0.0 if course.sd is None else float(course.sd[-1])
    out: dict[str, Any] = {
        "unit": course.unit,
        "true": None,
        "final": _last(hat, sound),
        "sd": spread if 0 < spread < math.inf else None,
        "valid": bool(sound[-1]),
        "adapted": moved > 0 if course.adapted is None else course.adapted,
    }
    out |= {"error_percent": None, "settling_s": None, "moved": moved, "moved_percent": None}
    if true is None or not math.isfinite(true[-1]):
        return out
    error = np.where(sound, error_percent(hat, true), np.inf)
    final = float(error[-1])
    return out | {
        "true": float(true[-1]),
        "error_percent": final if math.isfinite(final) else math.nan,
        "settling_s": settling(time, error),
        "moved_percent": 100.0 * moved / abs(float(true[-1])) if true[-1] else math.nan,
    }


def _last(hat: Array, sound: NDArray[np.bool_]) -> float:
    return float(hat[-1]) if sound[-1] else math.nan


def delayed(values: Array) -> Array:
    """Return what estimates are compared with: row k + 1 of an observer estimates t_k."""
    return np.concatenate([values[:1], values[:-1]])


def true_values(
    trace: BusTrace, normal: Array | float = 1.0, load: Array | float = 0.0
) -> dict[str, Array]:
    """Return the plant's true normalised parameters at each row, those that its law has.

    `normal`: normal load over nominal, which scales friction; `load`: torque over inertia that acts
    from outside, which adds to the plant's own.
    """
    out = {}
    flags = trace.flags.last
    for (unit, name), value in flags.items():
        if unit != "plant" or name.endswith("_valid") or not name.startswith("true."):
            continue
        if not flags.get((unit, f"{name}_valid"), 0.0) or not math.isfinite(value):
            continue
        short = name.removeprefix("true.")
        scale = normal if short in LOAD_PROPORTIONAL else 1.0
        out[short] = (
            value * scale + (load if short == "load" else 0.0) + np.zeros(len(trace.values))
        )
    return out


def element_distances(fmu: Fmu, given: Mapping[str, Value]) -> dict[str, float]:
    """Return the inverse presliding distances c1, c2, ... of friction elements side by side that an
    FMU has as parameters.

    A single c1 is a gain.
    """
    return {
        short: float(given[name] if name in given else fmu.start(name))
        for short, name in _distances(fmu).items()
    }


@lru_cache(maxsize=64)
def _distances(fmu: Fmu) -> dict[str, str]:
    """Return the names of these parameters by their last parts."""
    several = [
        name
        for name in fmu.names("parameter")
        if fmu.has(re.sub(r"\.c\d+$", ".c2", name), "parameter")
    ]
    return {name.rpartition(".")[2]: name for name in several if re.search(r"\.c\d+$", name)}


def of_same_elements(
    true: Mapping[str, Array], plant: Mapping[str, float], observer: Mapping[str, float]
) -> dict[str, Array]:
    """Return the true values without those of elements (sigma0_1, ...) whose distances are others
    in the observer.
    """
    same = plant == observer
    return {
        name: values
        for name, values in true.items()
        if same or re.fullmatch(r"sigma\d+_\d+", name) is None
    }


def estimated_parameters(record: Sequence[Port], flags: Mapping[Port, float]) -> list[str]:
    """Return the parameters for which the observer has P_hat and P_valid."""
    hats = [
        name.removesuffix("_hat")
        for unit, name in record
        if unit == "observer" and name.endswith("_hat")
    ]
    return [name for name in hats if ("observer", f"{name}_valid") in flags]


def courses(trace: BusTrace, units: Mapping[str, str]) -> dict[str, Course]:
    """Return what the observer published of every parameter that it estimates.

    It estimates what it ever called valid, or published as another number than 0, or with a
    standard deviation.
    """
    said, published = ("observer", "adapted"), {}
    flags = trace.flags.last
    adapted = bool(flags[said]) if said in flags else None
    for name in estimated_parameters(trace.record, flags):
        hat, sd, valid = (("observer", f"{name}_{what}") for what in ("hat", "sd", "valid"))
        said_valid = trace.flag(valid)
        if said_valid.any() or trace.says_something(hat) or trace.says_something(sd):
            hats = np.ascontiguousarray(trace[hat])  # which is read several times
            published[name] = Course(hats, said_valid, trace.get(sd), adapted, units.get(name, "1"))
    return published


def estimates(
    time: Array, published: Mapping[str, Course], true: Mapping[str, Array]
) -> dict[str, dict[str, Any]]:
    """Return the final values and the errors of every parameter that the observer estimates."""
    return {
        name: estimate(time, course, delayed(true[name]) if name in true else None)
        for name, course in published.items()
    }


def last_innovation(trace: BusTrace) -> float | None:
    """Return the observer's own measure of its innovations at the end, None where it has none."""
    course = trace.get(("observer", "innovation"))
    value = 0.0 if course is None else float(course[-1])
    return value if 0 < value < math.inf else None


def estimates_state(trace: BusTrace, name: str) -> bool:
    """Say whether the observer estimates a state: it has NAME_hat, and NAME_hat_valid, if it has
    that, is true at the end.
    """
    course = trace.get(("observer", f"{name}_hat"))
    return (
        course is not None
        and bool(np.isfinite(course[-1]))
        and trace.flags.last.get(("observer", f"{name}_hat_valid"), 1.0) > 0
    )


def state_errors(
    trace: BusTrace, truth: Mapping[str, Array], units: Mapping[str, str]
) -> dict[str, dict[str, Any]]:
    """Return the rms error of the observer's states, over the run and over its last tenth."""
    out = {}
    for name, values in truth.items():
        port = ("observer", f"{name}_hat")
        if not estimates_state(trace, name):
            continue
        error = (trace[port] - delayed(values))[1:]
        late = error[-max(1, int(LATE_ERROR_SHARE * len(error))) :]
        rms = {
            key: float(np.sqrt(np.mean(part**2))) if len(part) else math.nan
            for key, part in (("rms", error), ("late_rms", late))
        }
        spread = float(np.std(values))
        out[name] = {
            "unit": units.get(name, "1"),
            **rms,
            "late_percent": 100 * rms["late_rms"] / spread if spread else math.nan,
        }
    return out
