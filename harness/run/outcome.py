"""A run that is measured and judged, before anything is written."""

from __future__ import annotations

import hashlib
import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.provenance import provenance
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusTrace
from bristle.harness.metrics.batch import batch_result, known_at_once
from bristle.harness.metrics.behaviour import PlantMotion, Quantity, behaviour
from bristle.harness.metrics.checks import judge, validity_checks, why_not
from bristle.harness.metrics.estimates import estimates, last_innovation, state_errors
from bristle.harness.metrics.fit import Data
from bristle.harness.metrics.tracking import Tracking, tracking
from bristle.harness.metrics.validation import (
    ModelValidation,
    given_parameters,
    identification_data,
    identified_model,
    validate,
)
from bristle.harness.run.checked import Checked, Progress, RunOptions, no_progress
from bristle.harness.run.view import RunView
from bristle.harness.scenario.plan import RunSetup, uncompensated
from bristle.harness.scenario.plan import validation as validation_bus

SECOND_RUNS = ("validation", "tracking")  # parts of result.json that take one


@dataclass(frozen=True)
class Outcome:
    """A scenario that has run, before anything is written: result.json without the timing, signals,
    the validation.
    """

    result: dict[str, Any]
    view: RunView
    validated: ModelValidation | None
    findings: tuple[str, ...] = ()  # as of `FinishedRun`
    tracking: Tracking | None = None


def outcome(checked: Checked, progress: Progress | None = None) -> Outcome:
    """Run a scenario that is checked, and judge it."""
    setup, clock, tell = checked.setup, checked.clock, progress or no_progress
    with clock.stage("co-simulation"):
        trace = checked.simulate(
            checked.bus, lambda done: tell("co-simulation", done, setup.steps), setup.timeout
        )
    with clock.stage("metrics"):
        view = RunView(setup, trace)
        result = measured(setup, trace, view) | {
            "units": view.column_units(setup),
            "provenance": _provenance(checked),
        }
    if setup.samples is not None and checked.options.batch is not None:
        with clock.stage("estimate from the whole record"):
            tell("whole record", 0, 0)
            observer = setup.fmus["observer"]
            result["batch"] = batch_result(setup.samples, observer, checked.options.batch)
    # second runs, where the scenario asks for them and the first came to its end
    validated = followed = None
    if setup.scenario.controller.compensation != "none" and trace.failure is None:
        with clock.stage("the same run without compensation"):
            followed = tracking(
                trace, _second_run(checked, uncompensated(setup), "controller.compensation")
            )
            result["tracking"] = followed.as_dict()
    if setup.scenario.validation is not None and trace.failure is None:
        with clock.stage("validation: second record and fits"):
            tell("validation and fits", 0, 0)
            validated = _validate(checked, result, view)
            result["validation"] = validated.as_dict(setup.scenario.validation.seed)
    # what the user is told beside the verdict
    findings = (
        *_trusted(setup),
        *(setup.samples.findings if setup.samples else ()),
        *_judge(result, setup),
        *known_at_once(result),
    )
    return Outcome(result, view, validated, findings, followed)


def measured(setup: RunSetup, trace: BusTrace, view: RunView) -> dict[str, Any]:
    """Return result.json of a run without what needs another, verdict, provenance and timing."""
    return _measure(setup, trace, view) | {
        "behaviour": {name: each.as_dict() for name, each in _behaviour(setup, view).items()}
    }


def _behaviour(setup: RunSetup, view: RunView) -> Mapping[str, Quantity]:
    """Return what the plant did; nothing of a record, which is an input of the run."""
    if setup.samples is not None:
        return {}
    plant, values = setup.fmus["plant"], setup.values["plant"]
    known = {
        name: float(values.get(name, plant.start(name))) if plant.has(name, "parameter") else None
        for name in ("J", "b", "u_max")
    }
    limit = known["u_max"] if known["u_max"] is not None else math.inf
    units = {
        key: plant.unit(port)
        for key, port in (("speed_unit", "v"), ("torque_unit", "F"))
        if plant.has(port, "output")
    }
    return behaviour(
        PlantMotion(
            setup.h, view.signals, known["J"], known["b"], limit, setup.scenario.open_loop, **units
        )
    )


def verdict(setup: RunSetup, trace: BusTrace) -> str:
    """Judge a run by the checks that need no second run; pass or fail."""
    result = measured(setup, trace, RunView(setup, trace))
    checks = [
        each for each in setup.scenario.checks if each.quantity.partition(".")[0] not in SECOND_RUNS
    ]
    return _verdict(result | {"checks": judge(result, checks)})


def _trusted(setup: RunSetup) -> list[str]:
    files = " and ".join(setup.fmus[name].path.name for name in setup.foreign)
    return (
        [f"{files}: code from elsewhere, which ran with your rights: use only FMUs that you trust"]
        if files
        else []
    )


def _measure(setup: RunSetup, trace: BusTrace, view: RunView) -> dict[str, Any]:
    """Return result.json without validation, verdict and timing."""
    # what every run has
    result: dict[str, Any] = {
        "scenario": setup.loaded.name,
        "verdict": "fail",
        "steps": trace.steps,
        "wall_s": 0.0,
        "duration_s": trace.steps * trace.h,
        "step_s": trace.h,
        "overrides": setup.loaded.overrides,
        "notes": [*setup.loaded.notes, *(setup.samples.findings if setup.samples else ())],
        "innovation": last_innovation(view.trace),
        "estimates": estimates(view.time, view.published, view.true),
        "states": state_errors(view.trace, view.states(), view.units),
        "checks": [],
        "fmus": {name: _about(fmu) for name, fmu in setup.fmus.items()},
    }
    result["adapted"] = any(estimate["adapted"] for estimate in result["estimates"].values())
    # what some have: a record, a reference that is followed, an early end
    if setup.samples is not None and setup.scenario.record is not None:
        file = setup.loaded.beside(setup.scenario.record.file)
        result["record"] = {
            "file": file.name,
            "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
            "samples": len(setup.samples),
        }
    if "reference" in view.signals:
        result["tracking_rms"] = float(
            np.sqrt(np.mean((view.signals["reference"] - view.signals["v"]) ** 2))
        )
    if trace.failure is not None:
        failure = trace.failure
        result["diverged"] = {
            "fmu": failure.unit,
            "time_s": failure.time,
            "message": failure.message,
        }
        result["notes"].append(
            f"The run ended at {failure.time:g} s of {setup.steps * setup.h:g} s: {failure.unit}:"
            f" {failure.message}."
        )
    return result


def _about(fmu: Fmu) -> dict[str, str]:
    """Return what a result says of an FMU."""
    version = fmu.description.fmiVersion
    return {"file": fmu.path.name, "sha256": fmu.sha256, "fmi": version, "kind": fmu.kind}


def _validate(checked: Checked, result: Mapping[str, Any], view: RunView) -> ModelValidation:
    setup, fmus = checked.setup, checked.lean
    second = _second_run(checked, validation_bus(setup), "validation")
    identified = identified_model(
        result["estimates"], given_parameters(setup, setup.values["observer"]), fmus
    )
    demand = setup.scenario.validation
    assert demand is not None
    data = identification_data(setup, view.signals["u"], view.sensed["theta"], view.sensed["v"])
    other = Data(second["controller", "u"], second["plant", "v"], second.h)
    return validate(data, other, identified, fmus, demand.baselines)


def _second_run(checked: Checked, bus: Bus, key: str) -> BusTrace:
    """Run a bus that must run to its end; `key` is what asks for it in the scenario file."""
    setup = checked.setup
    second = checked.simulate(bus, None, setup.timeout)
    if second.failure is not None:
        failure = second.failure
        what = f"the second run ended at {failure.time:g} s: {failure.unit}: {failure.message}"
        raise setup.loaded.error(
            key, None, f"{what}; change the scenario so that it runs to its end, or remove this key"
        )
    return second


def _provenance(checked: Checked) -> dict[str, Any]:
    """Return where the result comes from; `command` repeats the run in `folder`."""
    setup, options = checked.setup, checked.options
    loaded, controller = setup.loaded, setup.fmus.get("controller")
    seed = None
    if controller is not None and controller.has("seed", "parameter"):
        seed = int(setup.values["controller"].get("seed", controller.start("seed")))
    sha256 = hashlib.sha256(loaded.text.encode()).hexdigest()
    return {
        **provenance(),
        "scenario_sha256": sha256,
        "seed": seed,
        "command": command_of(loaded.path, options, checked.out),
    }


def command_of(path: Path, options: RunOptions, out: Path | None = None) -> str:
    """Return the command that runs a scenario with these options."""
    words = ["bristle", "run", str(path), *([] if out is None else ["--out", str(out)])]
    words += ["--kind", options.kind, "--fmi", str(options.fmi)]
    for override in options.overrides:
        words += ["--set", override]
    if options.seed is not None:
        words += ["--seed", str(options.seed)]
    if options.full:
        words.append("--full")
    return shlex.join(words)


def _judge(result: dict[str, Any], setup: RunSetup) -> list[str]:
    """Set checks and verdict; of a record without checks, also note why the verdict is fail."""
    checks = setup.scenario.checks
    result["checks"] = judge(result, checks or validity_checks(result, _innovation_limit(setup)))
    result["verdict"] = _verdict(result)
    if checks or result["verdict"] == "pass":
        return []
    line = (
        "No checks are given, so the verdict is what the observer says of itself:"
        f" {why_not(result)}"
    )
    result["notes"].append(line)
    return [line]


def _verdict(result: Mapping[str, Any]) -> str:
    """Return pass where the run came to its end and all checks hold."""
    return (
        "pass"
        if all(check["pass"] for check in result["checks"]) and "diverged" not in result
        else "fail"
    )


def _innovation_limit(setup: RunSetup) -> float | None:
    """Return up to which innovation the estimates count, None if the method has no such limit: its
    deviations then grow with it.
    """
    observer, name = setup.fmus["observer"], f"{setup.scenario.observer.method}.innovation_limit"
    if not observer.has(name, "parameter"):
        return None
    return float(setup.values["observer"].get(name, observer.start(name)))
