"""A scenario from file to result folder."""

from __future__ import annotations

import hashlib
import math
import shlex
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import suggest
from bristle.common.output import output_folder, plain, to_json
from bristle.common.provenance import provenance
from bristle.fmus.host import Fmu
from bristle.harness.cosim.isolate import run_bus
from bristle.harness.cosim.loop import Bus, Trace
from bristle.harness.metrics import estimates as metrics
from bristle.harness.metrics.behaviour import Motion, Quantity, behaviour
from bristle.harness.metrics.fit import Data
from bristle.harness.metrics.tracking import Tracking, tracking
from bristle.harness.metrics.validation import (
    BASELINES,
    Validation,
    given_parameters,
    identification_data,
    identified_model,
    lean_fmus,
    validate,
)
from bristle.harness.run import results
from bristle.harness.scenario.plan import (
    Kind,
    Setup,
    find_fmus,
    identification,
    prepare,
    uncompensated,
)
from bristle.harness.scenario.plan import validation as validation_bus
from bristle.harness.scenario.scenario import Loaded, load

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]  # stage, done, total (0: not known)
Simulate = Callable[[Bus, Callable[[int], None] | None, float | None], Trace]  # as `run_bus`

SECOND_RUNS = ("validation", "tracking")  # parts of result.json that take one
ESTIMATED = ("estimates", "states")  # parts that depend on what the observer estimates
LATE_FRICTION = 0.25  # share of the run, at its end, that the friction curve shows


@dataclass(frozen=True)
class Options:
    """How to run a scenario."""

    fmi: int = 2
    kind: Kind = "native"
    overrides: Sequence[str] = ()
    seed: int | None = None
    full: bool = False
    timeout: float | None = None  # s that a simulation may take where an FMU comes from elsewhere


@dataclass
class Run:
    """A finished scenario."""

    result: dict[str, Any]
    folder: Path
    # what was found in the record and repaired, and why its verdict is fail, one line each
    findings: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the verdict is pass."""
        return bool(self.result["verdict"] == "pass")


@dataclass
class _Clock:
    """Seconds spent in each stage of a run."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


@dataclass
class Checked:
    """A scenario that is read and checked against its FMUs and its record, and the output folder it
    is run into.
    """

    setup: Setup
    out: Path
    options: Options
    bus: Bus
    lean: Mapping[str, Fmu]
    clock: _Clock
    simulate: Simulate = run_bus


def check(
    path: Path,
    out: Path,
    options: Options | None = None,
    progress: Progress | None = None,
    refuse: Callable[[Path], None] = results.refuse_strange,
) -> Checked:
    """Read and check a scenario and all that it names, building FMUs that are new; `execute` runs
    it.

    `refuse` raises an error if the folder of the result may not be replaced.

    Raises
    ------
    BristleError
        One line; nothing is written then, and what was there stays.
    """
    options, clock, tell = options or Options(), _Clock(), progress or _no_progress
    loaded = load(path, options.overrides, options.seed)
    with output_folder(out):
        refuse(out / loaded.name)
        with clock.stage("FMUs (built only if new)"):
            tell("building FMUs", 0, 0)
            checked = check_loaded(
                loaded, find_fmus(loaded, options.fmi, options.kind), out, options, clock
            )
            _check_estimated(checked.setup)
            return checked


def check_loaded(
    loaded: Loaded, fmus: dict[str, Fmu], out: Path, options: Options, clock: _Clock | None = None
) -> Checked:
    """Check a scenario against its FMUs; errors as of `check`."""
    setup = replace(prepare(loaded, fmus), timeout=options.timeout)
    lean = {}
    if setup.scenario.validation is not None:
        lean = lean_fmus()
        validation_bus(setup)
    _check_quantities(setup)
    return Checked(setup, out, options, identification(setup), lean, clock or _Clock())


def _check_quantities(setup: Setup) -> None:
    """Refuse a check of a number that no result has, or not that of this scenario."""
    observer, scenario = setup.fmus["observer"], setup.scenario
    hats = [name.removesuffix("_hat") for name in observer.names("output") if name.endswith("_hat")]
    known = metrics.check_quantities(
        [name for name in hats if observer.has(f"{name}_valid", "output")], list(BASELINES)
    )
    absent = [
        f"[{part}]" for part in ("validation", "record", "plant") if getattr(scenario, part) is None
    ]
    absent += ["compensation"] if scenario.controller.compensation == "none" else []
    for i, demand in enumerate(scenario.checks):
        part, key = demand.quantity.partition(".")[0], f"checks[{i}].quantity"
        needed = {"tracking": "compensation", "behaviour": "[plant]"}.get(part, f"[{part}]")
        if needed in absent:
            raise setup.loaded.error(
                key, demand.quantity, f"the scenario has no {needed}; add it or remove the check"
            )
        if demand.quantity not in known:
            what = f"no number of the result{suggest(demand.quantity, known)}"
            raise setup.loaded.error(
                key,
                demand.quantity,
                f"{what}; choose one of the check quantities in the scenario reference",
            )


def _check_estimated(setup: Setup) -> None:
    """Refuse a check of what the method does not estimate; an FMU from elsewhere shows that only
    when it runs.
    """
    from bristle.fmus.build import estimated

    observer, method = setup.fmus["observer"], setup.scenario.observer.method
    if observer.foreign or method is None:
        return
    named = {
        i: each.quantity
        for i, each in enumerate(setup.scenario.checks)
        if each.quantity.split(".")[0] in ESTIMATED
    }
    found = estimated(method) if named else []
    for i, quantity in named.items():
        part, name, _ = quantity.split(".")
        if name not in found:
            kind = (
                metrics.STATES
                if part == "states"
                else [each for each in found if observer.has(f"{each}_valid", "output")]
            )
            others = [each for each in found if each in kind]
            advice = (
                f"it estimates {', '.join(others) or 'none'}: check one of these, or choose another"
                " method"
            )
            raise setup.loaded.error(
                f"checks[{i}].quantity",
                quantity,
                f"the method {method} does not estimate {name}; {advice}",
            )


def run(
    path: Path, out: Path, options: Options | None = None, progress: Progress | None = None
) -> Run:
    """Run a scenario and write its result folder `out/<scenario>`.

    Raises
    ------
    BristleError
        One line; nothing is written then, and what was there stays.
    """
    with output_folder(out):
        return execute(check(path, out, options, progress), progress)


@dataclass(frozen=True)
class Outcome:
    """A scenario that has run, before anything is written: result.json without the timing, signals,
    the validation.
    """

    result: dict[str, Any]
    view: View
    validated: Validation | None
    findings: tuple[str, ...] = ()  # as of `Run`
    tracking: Tracking | None = None


def outcome(checked: Checked, progress: Progress | None = None) -> Outcome:
    """Run a scenario that is checked, and judge it."""
    setup, clock, tell = checked.setup, checked.clock, progress or _no_progress
    with clock.stage("co-simulation"):
        trace = checked.simulate(
            checked.bus, lambda done: tell("co-simulation", done, setup.steps), setup.timeout
        )
    with clock.stage("metrics"):
        view = View(setup, trace)
        result = measured(setup, trace, view) | {
            "units": view.column_units(setup),
            "provenance": _provenance(checked),
        }
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
    findings = (
        *_trusted(setup),
        *(setup.samples.findings if setup.samples else ()),
        *_judge(result, setup),
    )
    return Outcome(result, view, validated, findings, followed)


def measured(setup: Setup, trace: Trace, view: View) -> dict[str, Any]:
    """Return result.json of a run without what needs a second run, verdict, provenance and
    timing.
    """
    return _measure(setup, trace, view) | {
        "behaviour": {name: each.as_dict() for name, each in _behaviour(setup, view).items()}
    }


def _behaviour(setup: Setup, view: View) -> Mapping[str, Quantity]:
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
        Motion(
            setup.h, view.signals, known["J"], known["b"], limit, setup.scenario.open_loop, **units
        )
    )


def verdict(setup: Setup, trace: Trace) -> str:
    """Judge a run by the checks that need no second run; pass or fail."""
    result = measured(setup, trace, View(setup, trace))
    checks = [
        each for each in setup.scenario.checks if each.quantity.partition(".")[0] not in SECOND_RUNS
    ]
    return _verdict(result | {"checks": metrics.judge(result, checks)})


def execute(checked: Checked, progress: Progress | None = None) -> Run:
    """Run a scenario that is checked, and write its result folder."""
    setup, tell = checked.setup, progress or _no_progress
    Thread(target=_load_drawing, daemon=True).start()
    found = outcome(checked, progress)
    with checked.clock.stage("report"):
        tell("report", 0, 0)
        files = _files(setup, found, checked.clock, checked.options.full)
    folder = results.write(checked.out, setup.loaded.name, files)
    return Run(found.result, folder, found.findings)


def _no_progress(stage: str, done: int, total: int) -> None:
    pass


def _load_drawing() -> None:
    """Import what the report needs while the compiled loop runs, which releases the interpreter."""
    # the report says it, in the thread that needs it
    with suppress(ImportError, OSError, MemoryError):
        import matplotlib.backends.backend_svg
        import matplotlib.figure  # noqa: F401 - imported for its cost, not for its names


def _trusted(setup: Setup) -> list[str]:
    files = " and ".join(setup.fmus[name].path.name for name in setup.foreign)
    return (
        [f"{files}: code from elsewhere, which ran with your rights: use only FMUs that you trust"]
        if files
        else []
    )


class View:
    """The signals of a run, whether simulated or recorded, and the truth where it is known."""

    def __init__(self, setup: Setup, trace: Trace) -> None:
        observer, rig = setup.fmus["observer"], setup.rig
        units = {name: observer.unit(name) for unit, name in trace.record if unit == "observer"}
        if setup.samples is not None:
            trace = trace.from_first_sample(
                {("observer", name): 1 / rig.worth(unit) for name, unit in units.items()}
            )
        self.trace, self.time, self.rig = trace, trace.time, rig
        rows = len(trace.values)
        self.signals: dict[str, Array] = {}
        if setup.samples is not None:
            s = setup.samples
            self.signals = {"u": s.u[:rows], "theta": s.theta[:rows], "v": s.v[:rows]}
            self.sensed = {"theta": s.theta[:rows], "v": s.v[:rows]}
        else:
            self.signals = {
                name: trace[unit, name] for unit, name in trace.record if unit != "observer"
            }
            self.signals |= {each.variable: each.values(rows, setup.h) for each in setup.stimuli}
            self.sensed = {
                key: trace["plant", port]
                for key, port in zip(("theta", "v"), setup.sensor, strict=True)
            }
        self.observed = {
            name: trace[unit, name] for unit, name in trace.record if unit == "observer"
        }
        self.estimated = {
            name: self.observed[f"{name}_hat"]
            for name in ("v", "F")
            if metrics.estimates_state(trace, name)
        }
        self.true = {} if setup.samples is not None else self._true(setup)
        self.units = {name.removesuffix("_hat"): rig.unit(unit) for name, unit in units.items()}
        self.published = metrics.courses(trace, self.units)
        self.friction = self._friction(setup)

    def columns(self) -> dict[str, Array]:
        """Return all signals at full rate, and for each estimate whether the observer calls it
        valid.
        """
        return {
            **self.signals,
            **self.observed,
            **{f"{name}_valid": course.valid for name, course in self.published.items()},
        }

    def column_units(self, setup: Setup) -> dict[str, str]:
        """Return the unit of each of these signals."""
        if setup.samples is not None:
            own = {
                "u": self.rig.unit("V"),
                "theta": self.rig.unit("rad"),
                "v": self.rig.unit("rad/s"),
            }
        else:
            own = {
                name: setup.fmus[unit].unit(name)
                for unit, name in self.trace.record
                if unit != "observer"
            }
            own |= {
                each.variable: setup.fmus[each.unit].unit(each.variable) for each in setup.stimuli
            }
        observer = {
            name: self.rig.unit(setup.fmus["observer"].unit(name)) for name in self.observed
        }
        return {**own, **observer, **{f"{name}_valid": "1" for name in self.published}}

    def _true(self, setup: Setup) -> dict[str, Array]:
        """Return the true parameters under the loads that act on the plant, and of the observer's
        elements.
        """
        torque, inertia = self.signals.get("tau_load"), self._inertia(setup)
        load = 0.0 if torque is None or inertia is None else torque / inertia
        found = metrics.true_values(self.trace, self.signals.get("load_scale", 1.0), load)
        distances = [
            metrics.element_distances(setup.fmus[unit], setup.values[unit])
            for unit in ("plant", "observer")
        ]
        return metrics.of_same_elements(found, *distances)

    @staticmethod
    def _inertia(setup: Setup) -> float | None:
        """Return J of the plant, where it says what it is."""
        if setup.samples is not None or not setup.fmus["plant"].has("J", "parameter"):
            return None
        return float(setup.values["plant"].get("J", setup.fmus["plant"].start("J")))

    def _friction(self, setup: Setup) -> Array | None:
        """Return F/J of the plant, where the plant has both."""
        inertia = self._inertia(setup)
        return self.signals["F"] / inertia if inertia is not None and "F" in self.signals else None

    def states(self) -> dict[str, Array]:
        """Return the true states that an observer may estimate."""
        if not self.true:
            return {}
        found = {"v": self.signals["v"]}
        if self.friction is not None and "alpha2" in self.true:
            found["w"] = self.friction - self.true["alpha2"] * self.signals["v"]
        return found


def _measure(setup: Setup, trace: Trace, view: View) -> dict[str, Any]:
    """Return result.json without validation, verdict and timing."""
    fmus = {
        name: {
            "file": fmu.path.name,
            "sha256": fmu.sha256,
            "fmi": fmu.description.fmiVersion,
            "kind": fmu.kind,
        }
        for name, fmu in setup.fmus.items()
    }
    result: dict[str, Any] = {
        "scenario": setup.loaded.name,
        "verdict": "fail",
        "steps": trace.steps,
        "wall_s": 0.0,
        "duration_s": trace.steps * trace.h,
        "step_s": trace.h,
        "overrides": setup.loaded.overrides,
        "notes": [*setup.loaded.notes, *(setup.samples.findings if setup.samples else ())],
        "innovation": metrics.last_innovation(view.trace),
        "estimates": metrics.estimates(view.time, view.published, view.true),
        "states": metrics.state_errors(view.trace, view.states(), view.units),
        "checks": [],
        "fmus": fmus,
    }
    result["adapted"] = any(estimate["adapted"] for estimate in result["estimates"].values())
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


def _validate(checked: Checked, result: Mapping[str, Any], view: View) -> Validation:
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


def _second_run(checked: Checked, bus: Bus, key: str) -> Trace:
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


def command_of(path: Path, options: Options, out: Path | None = None) -> str:
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


def _judge(result: dict[str, Any], setup: Setup) -> list[str]:
    """Set checks and verdict; of a record without checks, return and note why the verdict is
    fail.
    """
    checks = setup.scenario.checks
    result["checks"] = metrics.judge(
        result, checks or metrics.validity_checks(result, _innovation_limit(setup))
    )
    result["verdict"] = _verdict(result)
    if checks or result["verdict"] == "pass":
        return []
    line = (
        "No checks are given, so the verdict is what the observer says of itself:"
        f" {metrics.why_not(result)}"
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


def _innovation_limit(setup: Setup) -> float | None:
    """Return up to which innovation the estimates count, None if the method has no such limit: its
    deviations then grow with it.
    """
    observer, name = setup.fmus["observer"], f"{setup.scenario.observer.method}.innovation_limit"
    if not observer.has(name, "parameter"):
        return None
    return float(setup.values["observer"].get(name, observer.start(name)))


def _files(setup: Setup, found: Outcome, clock: _Clock, full: bool) -> dict[str, str | bytes]:
    from bristle.harness.run.figures import draw
    from bristle.harness.run.run_page import render

    begin = time.perf_counter()
    result, view = found.result, found.view
    figures = draw(_pictures(found))
    csv = results.to_csv({"time": view.time, **view.columns()}, full)
    scenario = setup.scenario
    about = {
        "title": scenario.title,
        "shows": scenario.shows,
        "source": scenario.source,
        "limits": scenario.limits,
    }
    clock.seconds["report"] = time.perf_counter() - begin
    result["timing"] = {name: round(seconds, 4) for name, seconds in clock.seconds.items()}
    result["wall_s"] = round(math.fsum(clock.seconds.values()), 4)
    files: dict[str, str | bytes] = {f"{name}.svg": svg for name, svg in figures.items()}
    observer = setup.fmus["observer"]
    meanings = {
        name.removesuffix("_hat"): observer.meaning(name)
        for name in observer.names("output")
        if name.endswith("_hat")
    }
    page = render(plain(result), figures, about, meanings, setup.loaded.text)
    return {"result.json": to_json(result), "signals.csv": csv, "report.html": page, **files}


def _pictures(found: Outcome) -> Any:
    from bristle.harness.run.figures import Pictures

    result, view = found.result, found.view
    late = slice(int((1 - LATE_FRICTION) * len(view.time)), None)
    pictures = Pictures(
        view.time,
        result["estimates"],
        view.published,
        view.true,
        rig=view.rig,
        measured="record" in result,
    )
    pictures.signals = {
        **view.signals,
        **({"v_hat": view.estimated["v"]} if "v" in view.estimated else {}),
    }
    pictures.validation, pictures.tracking = found.validated, found.tracking
    if view.friction is not None:
        pictures.friction = (view.signals["v"][late], view.friction[late])
    if {"v", "F"} <= set(view.estimated):
        v, force = view.estimated["v"][late], view.estimated["F"][late]
        if np.isfinite(force).any() and np.isfinite(v).any():
            pictures.friction_hat = (v, force)
    return pictures
