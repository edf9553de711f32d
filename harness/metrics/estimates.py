"""Errors of the estimates against the true values, and checks of result.json; a check of NaN
fails.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.fmus.host import Fmu, Value
from bristle.harness.cosim.loop import Port, Trace
from bristle.harness.scenario.scenario import Check

Array = NDArray[np.float64]

SETTLING_BAND = 5.0  # percent of the true value; settling is the last time the error exceeds it
# true values that grow in proportion to the normal load
LOAD_PROPORTIONAL = ("Fc", "sigma0", "sigma1", "sigma2")
SIGNS = {"min": "≥", "max": "≤", "max_abs": "|·| ≤"}  # of the limits of a check
LATE_ERROR_SHARE = 0.1  # share of the run, at its end, over which the late state errors are taken

# What a check may demand: path in result.json -> (SI unit, meaning). PARAMETER, STATE and BASELINE
# stand for names.
CHECK_QUANTITIES = {
    "steps": ("1", "communication steps that were done"),
    "duration_s": ("s", "simulated time"),
    "step_s": ("s", "communication step"),
    "adapted": ("1", "1 if the observer says that it has adapted since the start, else 0"),
    "innovation": (
        "1",
        (
            "recent mean squared innovation relative to the value that the observer expects; none"
            " if it gives none"
        ),
    ),
    "tracking_rms": (
        "rad/s",
        "rms difference between reference and velocity; only with a controller",
    ),
    "tracking.from_s": (
        "s",
        "start of the last part of the run, over which the following three are taken",
    ),
    "tracking.rms": ("rad/s", "rms tracking error of the last part, with compensation"),
    "tracking.rms_without": (
        "rad/s",
        "the same of a second run, in which nothing of the observer reaches the controller",
    ),
    "tracking.ratio": ("1", "the first over the second; below 1 the compensation helps"),
    "estimates.PARAMETER.final": (
        "of the parameter",
        "estimate at the end; none while the observer calls it not valid",
    ),
    "estimates.PARAMETER.valid": ("1", "1 if the observer calls the final estimate valid, else 0"),
    "estimates.PARAMETER.adapted": (
        "1",
        "1 if the estimate has been adapted since the start, else 0",
    ),
    "estimates.PARAMETER.sd": (
        "of the parameter",
        "standard deviation of the final estimate; none if the observer gives none",
    ),
    "estimates.PARAMETER.true": (
        "of the parameter",
        "true value at the end; none on a record or for a law without it",
    ),
    "estimates.PARAMETER.error_percent": (
        "%",
        "error of the final estimate relative to the true value, with its sign",
    ),
    "estimates.PARAMETER.settling_s": (
        "s",
        "last time the absolute error exceeds 5 %; none if it still does at the end",
    ),
    "estimates.PARAMETER.moved": (
        "of the parameter",
        "largest distance of the estimate from its first value",
    ),
    "estimates.PARAMETER.moved_percent": ("%", "the same relative to the true value"),
    "states.STATE.rms": ("of the state", "rms error of an estimated state over the whole run"),
    "states.STATE.late_rms": ("of the state", "the same over the last tenth of the run"),
    "states.STATE.late_percent": (
        "%",
        "the same over the last tenth, relative to the standard deviation of the state",
    ),
    "behaviour.stick_share.value": (
        "1",
        "share of time that the plant stands still for 20 ms or longer; none if it never does",
    ),
    "behaviour.break_away_torque.value": (
        "of the friction torque",
        (
            "median over all standstills that end of the largest friction torque up to the sample"
            " at which the velocity passes 1 % of its rms value, so with the viscous torque at that"
            " velocity; none without such"
        ),
    ),
    "behaviour.limit_cycle_amplitude.value": (
        "of the velocity",
        (
            "half of peak to peak of a velocity that repeats although no input moves; none without"
            " a limit cycle"
        ),
    ),
    "behaviour.limit_cycle_period.value": ("s", "its period"),
    "behaviour.drive_work.value": (
        "J",
        "work of the drive; none if the plant does not say J and b",
    ),
    "behaviour.friction_work.value": ("J", "work of the friction torque"),
    "behaviour.energy_residual_percent.value": (
        "%",
        (
            "work of drive and load less that of friction and the kinetic energy gained, over that"
            " of the drive without its sign"
        ),
    ),
    "record.samples": ("1", "samples of the measured file; only with [record]"),
    "validation.mse_percent": (
        "%",
        "open-loop error of the identified model on the second run, eq. (25) of dixit2008",
    ),
    "validation.seed": ("1", "seed of the second run"),
    "validation.duration_s": ("s", "length of the second run"),
    "validation.rms_velocity": ("rad/s", "standard deviation of the velocity in the second run"),
    "validation.BASELINE_mse_percent": (
        "%",
        (
            "the same of a fitted model: linear (viscous), coulomb, floor (best fit of the modified"
            " law)"
        ),
    ),
    "validation.mse_over_BASELINE": (
        "1",
        "mse_percent over that of the fitted model; below 1 the identified model is better",
    ),
    "validation.fits.BASELINE.identification_mse_percent": (
        "%",
        "error of the fitted model on the first run",
    ),
    "validation.fits.BASELINE.runs": ("1", "simulations that the fit took"),
}

BASIC = ("alpha2", "b")  # estimates on which all others rest
_NAMES = re.compile("PARAMETER|STATE|BASELINE")
STATES = ("v", "w")  # whose true values a plant of bristle gives


def check_quantities(parameters: Sequence[str], baselines: Sequence[str]) -> list[str]:
    """Return the paths that a check may demand, given the names of the estimated parameters and of
    the fitted models.
    """
    names = {"PARAMETER": parameters, "STATE": STATES, "BASELINE": baselines}
    found = []
    for path in CHECK_QUANTITIES:
        stands = _NAMES.search(path)
        found += (
            [path]
            if stands is None
            else [path.replace(stands[0], name) for name in names[stands[0]]]
        )
    return found


def error_percent(estimate: Array, true: Array | float) -> Array:
    """Return the signed error in percent of the true value."""
    with np.errstate(all="ignore"):
        return np.asarray(100.0 * (estimate - true) / np.abs(true))


def settling(time: Array, error: Array, band: float = SETTLING_BAND) -> float:
    """Return the last time |error| exceeds the band; 0 if it never does, not a number if it still
    does at the end.
    """
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
    trace: Trace, normal: Array | float = 1.0, load: Array | float = 0.0
) -> dict[str, Array]:
    """Return the plant's true normalised parameters at each row, those that its law has.

    `normal`: normal load over nominal, which scales friction; `load`: torque over inertia that acts
    from outside, which adds to the plant's own.
    """
    out = {}
    found = trace.flags.last
    for (unit, name), value in found.items():
        if unit != "plant" or name.endswith("_valid") or not name.startswith("true."):
            continue
        if not found.get((unit, f"{name}_valid"), 0.0) or not math.isfinite(value):
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


def courses(trace: Trace, units: Mapping[str, str]) -> dict[str, Course]:
    """Return what the observer published of every parameter that it estimates.

    It estimates what it ever called valid, or published as another number than 0, or with a
    standard deviation.
    """
    said, found = ("observer", "adapted"), {}
    flags = trace.flags.last
    adapted = bool(flags[said]) if said in flags else None
    for name in estimated_parameters(trace.record, flags):
        hat, sd, valid = (("observer", f"{name}_{what}") for what in ("hat", "sd", "valid"))
        said_valid = trace.flag(valid)
        if said_valid.any() or trace.says_something(hat) or trace.says_something(sd):
            hats = np.ascontiguousarray(trace[hat])  # which is read several times
            found[name] = Course(hats, said_valid, trace.get(sd), adapted, units.get(name, "1"))
    return found


def estimates(
    time: Array, published: Mapping[str, Course], true: Mapping[str, Array]
) -> dict[str, dict[str, Any]]:
    """Return the final values and the errors of every parameter that the observer estimates."""
    return {
        name: estimate(time, course, delayed(true[name]) if name in true else None)
        for name, course in published.items()
    }


def last_innovation(trace: Trace) -> float | None:
    """Return the observer's own measure of its innovations at the end, None where it has none."""
    course = trace.get(("observer", "innovation"))
    value = 0.0 if course is None else float(course[-1])
    return value if 0 < value < math.inf else None


def estimates_state(trace: Trace, name: str) -> bool:
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
    trace: Trace, truth: Mapping[str, Array], units: Mapping[str, str]
) -> dict[str, dict[str, Any]]:
    """Return the rms error of the observer's states against the true ones, over the run and over
    its last tenth.
    """
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


# -- checks ----------------------------------------------------------------------------------------


def look_up(result: Mapping[str, Any], path: str) -> object:
    """Return the value at a dotted path, None if there is none."""
    node: object = result
    for key in path.split("."):
        if not isinstance(node, Mapping) or key not in node:
            return None
        node = node[key]
    return node


def check_unit(result: Mapping[str, Any], path: str) -> str:
    """Return the SI unit of a number of result.json; "1" if it has none, or if there is no such
    number.
    """
    unit = next(
        (
            unit
            for known, (unit, _) in CHECK_QUANTITIES.items()
            if re.fullmatch(_NAMES.sub("[^.]+?", known), path)
        ),
        "1",
    )
    own = look_up(result, f"{path.rpartition('.')[0]}.unit")  # of an estimate or a state
    return str(own or "1") if unit.startswith("of the") else unit


def validity_checks(result: Mapping[str, Any], most: float | None) -> list[Check]:
    """Return what is demanded of a record where the user demands nothing: that the observer itself
    says that it holds.

    It must have adapted, its innovations must be at most `most` times what it claims, if it has
    such a limit, and alpha2 and b, on which all others rest, must be valid; of a method that is
    given those, all that it estimates.
    """
    checks = [Check(name="adapted", quantity="adapted", min=1)]
    if not result["adapted"]:  # the rest is that of the start
        return checks
    if most is not None:
        checks.append(Check(name="innovation", quantity="innovation", max=most))
    found = list(result["estimates"])
    needed = [name for name in BASIC if name in found] or found
    return checks + [
        Check(name=f"{name} valid", quantity=f"estimates.{name}.valid", min=1) for name in needed
    ]


def why_not(result: Mapping[str, Any]) -> str:
    """Return in words which of the `validity_checks` fail."""
    if "diverged" in result:
        return "it did not reach the end of the record"
    failed = [check for check in result["checks"] if not check["pass"]]
    reasons = [
        f"{name} is not valid"
        for check in failed
        if (name := check["name"].removesuffix(" valid")) != check["name"]
    ]
    for check in failed:
        if check["quantity"] == "adapted":
            reasons.insert(0, "it has not adapted")
        elif check["quantity"] == "innovation":
            reasons.insert(
                0,
                f"its mean squared innovation is {check['value']:.3g} times what it claims, allowed"
                f" {check['limit']:g}",
            )
    return "; ".join(reasons)


def judge(result: Mapping[str, Any], checks: Sequence[Check]) -> list[dict[str, Any]]:
    """Return one line for every limit of every check."""
    lines = []
    for check in checks:
        value = look_up(result, check.quantity)
        number = float(value) if isinstance(value, (int, float)) else math.nan  # true counts as 1
        tests = {
            "min": number >= (check.min or 0.0),
            "max": number <= (check.max or 0.0),
            "max_abs": abs(number) <= (check.max_abs or 0.0),
        }
        for kind, passed in tests.items():
            limit = getattr(check, kind)
            if limit is not None:
                name = check.name or check.quantity
                lines.append(
                    {
                        "name": name,
                        "quantity": check.quantity,
                        "kind": kind,
                        "value": number,
                        "limit": limit,
                        "pass": bool(passed and math.isfinite(number)),
                    }
                )
    return lines
