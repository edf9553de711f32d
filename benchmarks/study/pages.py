"""Tables and figures of the study from its files of results."""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jobs import BEST, BOUNDS, CHECKS, ESTIMATED_PARAMETERS, estimated, estimators
from shared import upper_bound
from standard_records import RECORD_STEP, record

from bristle.model.native import Native
from bristle.observer import observer_program

mpl.use("Agg")
import matplotlib.pyplot as plt

Json = dict[str, Any]
SENSOR_NAMES = ("clean", "encoder")
LAST_CHECK = f"{CHECKS[-1]:g}"
FIRST_CHECK = f"{CHECKS[0]:g}"
PLANTS_WITHOUT_TRUTH = ("L0", "L1", "GMS")
WITH_TRUTH = ("S", "R")
COST_STEPS = 60_000
STARTED = (
    "five on each record, of those parameters that a method has a start of (`self_starting_ekf`: of"
    " c alone)"
)
COMMAND = "`scripts/study`"


def two(values: Iterable[float | None], form: str = ".1f") -> str:
    """Return median / largest; one that is missing counts as larger than any."""
    numbers = sorted(math.inf if x is None or not math.isfinite(x) else x for x in values)
    if not numbers:
        return "-"
    return " / ".join(
        "never" if math.isinf(x) else f"{x:{form}}"
        for x in (statistics.median_high(numbers), numbers[-1])
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in markdown."""
    lines = [
        f"| {' | '.join(head)} |",
        f"|{'---|' * len(head)}",
        *(f"| {' | '.join(row)} |" for row in rows),
    ]
    return "\n".join(lines)


class Results:
    """All files of results, by kind and plant."""

    def __init__(self, found: Mapping[Any, Path]) -> None:
        self.found = {
            job: json.loads(path.read_text(encoding="utf-8")) for job, path in found.items()
        }

    def of(self, kind: str, plant: str) -> list[Json]:
        """Return the results of one kind on one plant."""
        return [
            result for job, result in self.found.items() if (job.kind, job.plant) == (kind, plant)
        ]

    def of_best(self, plant: str) -> list[Json]:
        """Return the results of the best method from the encoder, also on the records that only it
        is run on.
        """
        return [*self.of("record", plant), *self.of("best", plant)]

    def methods(self, sensor: str, plant: str, method: str) -> list[Json]:
        """Return what a method reached on every record of a plant."""
        return [result[sensor][method] for result in self.of("record", plant)]


def largest(entry: Json, check: str) -> float:
    """Return the largest error of any parameter that has a truth, in %."""
    return worst(entry["checks"][check]["errors"])


def worst(errors: Mapping[str, float]) -> float:
    """Return the largest of some errors; none at all is not a number."""
    return max(
        (abs(x) if math.isfinite(x) else math.inf for x in errors.values()), default=math.nan
    )


def ratios(found: Sequence[Json], sensor: str, method: str, check: str, over: str) -> list[float]:
    """Return the validation error over that of a baseline fitted to the same record."""
    out = []
    for result in found:
        mse = result[sensor][method]["checks"][check]["mse"]
        out.append(
            mse / result["baselines"][over]["mse"]
            if mse is not None and math.isfinite(mse)
            else math.inf
        )
    return out


def identification(results: Results, sensor: str) -> str:
    """Return the table of times and errors on the plants whose parameters are known."""
    what = ("to 5 %, s", f"error at {FIRST_CHECK} s, %", f"at {LAST_CHECK} s, %")
    head = ["method", "estimates", *(f"{plant}: {each}" for plant in WITH_TRUTH for each in what)]
    rows = []
    for method in estimators():
        cells = [
            method,
            (
                "all six"
                if estimated(method) == list(ESTIMATED_PARAMETERS)
                else ", ".join(estimated(method))
            ),
        ]
        for plant in WITH_TRUTH:
            entries = results.methods(sensor, plant, method)
            cells.append(two(entry["settling_s"] for entry in entries))
            cells += [
                two((largest(entry, check) for entry in entries), ".3g")
                for check in (FIRST_CHECK, LAST_CHECK)
            ]
        rows.append(cells)
    return table([*head, "failed"], [[*row, failures(results, sensor, row[0])] for row in rows])


def failures(results: Results, sensor: str, method: str) -> str:
    """Return how many runs ended early, of how many."""
    entries = [
        result[sensor][method] for job, result in results.found.items() if job.kind == "record"
    ]
    return f"{sum(entry['failure'] is not None for entry in entries)} of {len(entries)}"


def bias(results: Results, sensor: str) -> str:
    """Return the table of the mean signed error of each parameter at the end."""
    head = [
        "method",
        *(f"{plant}: {name}" for plant in WITH_TRUTH for name in ESTIMATED_PARAMETERS),
    ]
    rows = []
    for method in estimators():
        cells = [method]
        for plant in WITH_TRUTH:
            for name in ESTIMATED_PARAMETERS:
                errors = [
                    entry["checks"][LAST_CHECK]["errors"].get(name)
                    for entry in results.methods(sensor, plant, method)
                ]
                numbers = [x for x in errors if x is not None and math.isfinite(x)]
                cells.append(
                    f"{statistics.mean(numbers):+.2f}"
                    if numbers and len(numbers) == len(errors)
                    else "-"
                )
        rows.append(cells)
    return table(head, rows)


def validation(results: Results, sensor: str, over: str, plants: Sequence[str]) -> str:
    """Return the table of validation errors over a baseline's."""
    head = [
        "method",
        *(f"{plant}, {check} s" for plant in plants for check in (FIRST_CHECK, LAST_CHECK)),
    ]
    rows = []
    for method in estimators():
        found = [
            ratios(results.of("record", plant), sensor, method, check, over)
            for plant in plants
            for check in (FIRST_CHECK, LAST_CHECK)
        ]
        rows.append([method, *(two(each, ".3g") for each in found)])
    return table(head, rows)


def changes(results: Results) -> str:
    """Return the table of the doubled load."""
    rows = []
    for method in estimators():
        cells = [method]
        for plant in WITH_TRUTH:
            cells.append(two(result[method]["back_s"] for result in results.of("change", plant)))
        rows.append(cells)
    return table(["method", *WITH_TRUTH], rows)


def starts(results: Results) -> str:
    """Return the table of start values that are far off."""
    rows = []
    for method in estimators():
        counts = [
            [r[method] for r in results.of("starts", plant) if method in r] for plant in WITH_TRUTH
        ]
        if all(counts):
            cells = [
                f"{sum(r['failed'] for r in each)} of {sum(r['runs'] for r in each)}"
                for each in counts
            ]
            rows.append([method, *cells])
    return table(["method", *WITH_TRUTH], rows)


def bodies(results: Results) -> str:
    """Return the table of the largest errors on the two rubbing bodies (set Z)."""
    rows = []
    for method in estimators():
        cells = [method]
        for sensor in SENSOR_NAMES:
            cells.append(
                two(
                    (
                        worst(result[sensor][method]["errors"])
                        for result in results.of("bodies", "Z")
                    ),
                    ".3g",
                )
            )
        rows.append(cells)
    return table(["method", *SENSOR_NAMES], rows)


def cost() -> str:
    """Return the table of cost per step, measured now, side by side: the least of several runs of
    each.
    """
    data = record("S", 1, 1, COST_STEPS * RECORD_STEP)
    inputs = {name: data[name] for name in ("u", "y_theta", "y_v")}
    instances = {method: Native(observer_program(method)) for method in estimators()}
    best = dict.fromkeys(instances, math.inf)
    for _ in range(5):
        for method, instance in instances.items():
            instance.reset()
            begun = time.process_time()
            instance.run(RECORD_STEP, inputs, ["convergence"])
            best[method] = min(best[method], time.process_time() - begun)
    unit = best["bastin_gevers"]
    return table(
        ["method", "us a step", "over bastin_gevers"],
        [
            [method, f"{1e6 * seconds / COST_STEPS:.2f}", f"{seconds / unit:.1f}"]
            for method, seconds in best.items()
        ],
    )


def _goal(
    what: str, values: Sequence[float], limit: float, goal: str, form: str = ".2f"
) -> list[str]:
    """Return a row of the goals; each of the values is to be at most `limit`."""
    missed = sum(not x <= limit for x in values)
    return [what, two(values, form), goal, _missed(missed, len(values))]


def _missed(count: int, n: int) -> str:
    """Return how many of n miss a goal, and the upper bound of their share."""
    return f"{count} of {n}, {100 * upper_bound(count, n) if n else 100:.1f} %"


def _of_parameters(results: Results, plant: str) -> list[list[str]]:
    """Return the goals of a plant whose true parameters are known."""
    entries = [result["encoder"][BEST] for result in results.of_best(plant)]
    settling = [math.inf if e["settling_s"] is None else e["settling_s"] for e in entries]
    errors = [largest(e, FIRST_CHECK) for e in entries]
    mse = [e["checks"][FIRST_CHECK]["mse"] for e in entries]
    error = f"{plant}: largest error at {FIRST_CHECK} s, %"
    return [
        _goal(f"{plant}: time to 5 %, s", settling, 10, "median <= 6, worst <= 10", ".1f"),
        _goal(error, errors, 0.3, "<= 0.3", ".2g"),
        _goal(f"{plant}: MSE, %", mse, 1e-4, "<= 1e-4", ".1e"),
    ]


def _of_changes(results: Results, plant: str) -> list[list[str]]:
    """Return the goals after a change of the load, and of starts that are far off."""
    back = [r[BEST]["back_s"] for r in results.of("change", plant)]
    times = [math.inf if x is None else x for x in back]
    counts = [r[BEST] for r in results.of("starts", plant)]
    failed, n = sum(c["failed"] for c in counts), sum(c["runs"] for c in counts)
    doubled = f"{plant}: load doubled, back within 5 %, s"
    starts = f"{plant}: starts ten times off, not within 5 % at {FIRST_CHECK} s"
    return [
        _goal(doubled, times, 10, "worst <= 10", ".1f"),
        [starts, f"{failed} of {n}", "0", _missed(failed, n)],
    ]


def goals(results: Results) -> str:
    """Return what the best method reaches, with counts and bounds."""
    rows = [row for plant in WITH_TRUTH for row in _of_parameters(results, plant)]
    for plant in PLANTS_WITHOUT_TRUTH:
        over = ratios(results.of_best(plant), "encoder", BEST, FIRST_CHECK, "modified")
        rows.append(_goal(f"{plant}: MSE over floor at {FIRST_CHECK} s", over, 1.5, "worst <= 1.5"))
    rows += [row for plant in WITH_TRUTH for row in _of_changes(results, plant)]
    plants = (*WITH_TRUTH, *PLANTS_WITHOUT_TRUTH)
    false = [result["changes"] > 0 for plant in plants for result in results.of_best(plant)]
    count, n = sum(false), len(false)
    what = "changes found on unchanged records"
    rows.append([what, f"{count} of {n}", "<= 1 of 60", _missed(count, n)])
    for plant in WITH_TRUTH:
        for second in BOUNDS:
            reached = two(efficiency(results, plant, f"{second:g}"))
            what = f"{plant}: rms error over the Cramer-Rao bound at {second:g} s, by parameter"
            rows.append([what, reached, "aim: 3", "-"])
    return table(["", "median / worst", "goal", "missed, 95 % bound"], rows)


def efficiency(results: Results, plant: str, second: str) -> list[float]:
    """Return for each parameter the rms over the records of its error over its bound."""
    found = results.of("bound", plant)
    scaled = [
        [(e / b) ** 2 for e, b in zip(r["errors"][second], r["bound"][second], strict=True)]
        for r in found
    ]
    return [math.sqrt(statistics.mean(column)) for column in zip(*scaled, strict=True)]


def figure_times(results: Results, out: Path) -> None:
    """Draw the times to 5 %, a dot a record."""

    def settles(method: str) -> bool:
        return any(
            e["settling_s"] is not None
            for plant in WITH_TRUTH
            for e in results.methods("encoder", plant, method)
        )

    names = [method for method in estimators() if settles(method)]
    figure, axes = plt.subplots(figsize=(8, 0.42 * len(names) + 1.2), layout="constrained")
    for row, method in enumerate(reversed(names)):
        for plant, mark, shift in zip(WITH_TRUTH, "os", (0.12, -0.12), strict=True):
            times = [e["settling_s"] for e in results.methods("encoder", plant, method)]
            there = [x for x in times if x is not None]
            axes.plot(
                there,
                np.full(len(there), row + shift),
                mark,
                ms=4,
                alpha=0.6,
                color="C0" if plant == "S" else "C1",
            )
            if len(there) < len(times):
                never = f"{plant}: {len(times) - len(there)} never"
                axes.text(
                    1.01,
                    row + shift,
                    never,
                    fontsize=7,
                    va="center",
                    transform=axes.get_yaxis_transform(),
                )
    label = "time until all parameters that it estimates stay within 5 % (s), encoder"
    axes.set(xscale="log", xlabel=label, yticks=range(len(names)))
    counts = [len(estimated(name)) for name in reversed(names)]
    axes.set_yticklabels(
        [
            f"{name} ({n} of {len(ESTIMATED_PARAMETERS)})"
            for name, n in zip(reversed(names), counts, strict=True)
        ]
    )
    axes.plot([], [], "o", color="C0", label="set S")
    axes.plot([], [], "s", color="C1", label="set R")
    axes.legend(loc="upper left", fontsize=8)
    axes.grid(axis="x", alpha=0.3)
    figure.savefig(out / "time_to_5_percent.png", dpi=130)
    plt.close(figure)


def figure_floor(results: Results, out: Path) -> None:
    """Draw the validation error over the floor on the plants that no observer's model contains."""

    def of(plant: str, method: str) -> list[float]:
        return [
            x
            for x in ratios(results.of("record", plant), "encoder", method, FIRST_CHECK, "modified")
            if math.isfinite(x)
        ]

    names = [
        method
        for method in estimators()
        if any(of(plant, method) for plant in PLANTS_WITHOUT_TRUTH)
    ]
    figure, axes = plt.subplots(figsize=(8, 0.42 * len(names) + 1.2), layout="constrained")
    for row, method in enumerate(reversed(names)):
        for plant, shift in zip(PLANTS_WITHOUT_TRUTH, (0.2, 0.0, -0.2), strict=True):
            values = of(plant, method)
            axes.plot(
                values,
                np.full(len(values), row + shift),
                ".",
                ms=5,
                alpha=0.6,
                color=f"C{PLANTS_WITHOUT_TRUTH.index(plant)}",
            )
    axes.axvline(1.0, color="0.4", lw=0.8)
    axes.set(
        xscale="log",
        xlabel=f"validation error over the 7-parameter floor after {FIRST_CHECK} s, encoder",
        yticks=range(len(names)),
    )
    axes.set_yticklabels(list(reversed(names)))
    for i, plant in enumerate(PLANTS_WITHOUT_TRUTH):
        axes.plot([], [], ".", color=f"C{i}", label=plant)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=8)
    axes.grid(axis="x", alpha=0.3)
    figure.savefig(out / "validation_over_floor.png", dpi=130)
    plt.close(figure)


STUDY_INTRODUCTION = f"""# Observers compared

{COMMAND} runs every observer that estimates parameters, with its default settings, on closed-loop
records of {LAST_CHECK} s under the reference controller, on {{n}} records of each plant (seeds 1 to
{{seeds}}, both orders of the reference; the best one on as many again, with the seeds that follow),
from clean signals and from the encoder (40 000 counts a turn; velocity: differences of counts).
Methods that take alpha2 and b as known get the true ones. Each cell: median / worst record, of the
worst of the parameters; "never": not by the end, or no number; "failed": runs that ended early. An
even number of records has the larger of the two in the middle as its median. Plants S, R: the
modified law, parameters known. L0, L1: original LuGre without and with bristle damping; GMS: four
Maxwell-slip elements; no observer's model contains them, and they are judged by eq. (25) on a
second record, over the best-fit floor: what a fit of the modified law with tau (7 parameters) to 60
s of the clean velocity reaches (an estimate from a longer record may reach less). An observer is
judged by the richest model that its outputs determine: the modified law, viscous + Coulomb, or
viscous. The original law, which `cao` identifies, and elements side by side are not among them:
those two are judged by their Coulomb friction here, and docs/mathematics.md says what they reach.
"""


ABOUT_BODIES = """The benchmark of clavel2001: 3 x 1000 samples of 5 ms, saw-tooth forces, one
length and one stiffness of the bristles; encoder: 1 um. Its own start values are given to the
methods that have starts, the true alpha2 and b to those that take them as known; a millimetre
stands for the radian. All else is as the methods come, made for 1 ms and for a servo; here 1 000
mm/s are reached, at which the presliding distance is passed fifty times in a sample: only reversals
distinguish sigma0 and c."""


def publish(found: Mapping[Any, Path], docs: Path) -> str:
    """Write the pages and figures, and return where they are."""
    results = Results(found)
    docs.mkdir(parents=True, exist_ok=True)
    figure_times(results, docs)
    figure_floor(results, docs)
    seeds = max(job.seed for job in found if job.kind == "record")
    parts = [
        STUDY_INTRODUCTION.format(n=len(results.of("record", "S")), seeds=seeds),
        "## What the best one reaches",
        goals(results),
    ]
    parts += ["![Times](time_to_5_percent.png)", "![Validation](validation_over_floor.png)"]
    for sensor in SENSOR_NAMES:
        parts += [f"## Parameters, {sensor}", identification(results, sensor)]
        parts += [
            f"## Validation error over the 7-parameter floor, {sensor}",
            validation(results, sensor, "modified", PLANTS_WITHOUT_TRUTH),
        ]
        every = validation(results, sensor, "coulomb", (*WITH_TRUTH, *PLANTS_WITHOUT_TRUTH))
        parts += [f"## Validation error over viscous + Coulomb, {sensor}", every]
        parts += [f"## Mean error at {LAST_CHECK} s in %, {sensor}", bias(results, sensor)]
    parts += [
        (
            "## Normal load doubled at 60 s: seconds until within 5 % again (never: not in 30 s),"
            " encoder"
        ),
        changes(results),
    ]
    parts += [
        f"## Starts up to ten times off, {STARTED}: not within 5 % at {FIRST_CHECK} s, encoder",
        starts(results),
    ]
    parts += [
        "## Two bodies (Z): largest error at the end of 15 s in %",
        ABOUT_BODIES,
        bodies(results),
    ]
    parts += ["## Cost", cost()]
    page = docs / "README.md"
    page.write_text("\n\n".join(part.strip() for part in parts) + "\n", encoding="utf-8")
    return f"{page}"
