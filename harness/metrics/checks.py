"""Checks of result.json: what may be demanded, and how it came out; a check of NaN fails."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from bristle.harness.scenario.scenario import Check

SIGNS = {"min": "≥", "max": "≤", "max_abs": "|·| ≤"}  # of the limits of a check

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
    paths = []
    for path in CHECK_QUANTITIES:
        stands = _NAMES.search(path)
        paths += (
            [path]
            if stands is None
            else [path.replace(stands[0], name) for name in names[stands[0]]]
        )
    return paths


def look_up(result: Mapping[str, Any], path: str) -> object:
    """Return the value at a dotted path, None if there is none."""
    node: object = result
    for key in path.split("."):
        if not isinstance(node, Mapping) or key not in node:
            return None
        node = node[key]
    return node


def check_unit(result: Mapping[str, Any], path: str) -> str:
    """Return the SI unit of a number of result.json; "1" if it has none, or does not exist."""
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
    estimated = list(result["estimates"])
    needed = [name for name in BASIC if name in estimated] or estimated
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
