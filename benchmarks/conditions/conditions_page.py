"""The page docs/study/conditions.md: one map over all methods, one table a method, and the best
method against its goals.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from condition_records import CONDITIONS

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

Json = dict[str, Any]
FOLDER = Path(__file__).resolve().parents[2] / "docs" / "study"
JUDGED = ("alpha2", "b", "Fc", "sigma0", "sigma1", "sigma2", "c")
RIGHT, WRONG = 5.0, 10.0  # percent: up to this an estimate counts as right, beyond that as wrong
GOOD = (
    "standard",
    "noise 2 rad/s",
    "noise 10 rad/s",
    "multisine",
    "0.5 ms",
    "2 ms",
    "4096 counts",
    "1e+06 counts",
)
CLASSES = {  # colour and meaning of a cell of the map
    "all valid, all right": "#1a7f37",
    "some not valid, what is valid is right": "#9bd3a8",
    "nothing valid": "#d9d9d9",
    "something valid is 5 to 10 % off": "#f2b134",
    "something valid is more than 10 % off": "#c62828",
}
TORQUES = (
    "constant torque 0.5 %",
    "constant torque 2 %",
    "constant torque 10 %",
    "constant torque 25 %",
    "constant torque 50 %",
)
HARD = (
    "5 ms",
    "LuGre v0 60 deg/s",
    "LuGre v0 120 deg/s",
    "c x20",
    "delay 1 samples",
    "torque sine 5 %",
    "coloured torque 5 %",
)


def errors(result: Json, valid_only: bool) -> list[float]:
    """Return the errors at the end in %, of the parameters of the servo."""
    if "failure" in result:
        return []
    return [
        abs(100 * (result["final"][name] / true - 1))
        for name, true in result["true"].items()
        if name in JUDGED and (result["valid"][name] or not valid_only)
    ]


def counts(results: Sequence[Json]) -> tuple[int, int, int]:
    """Return how many parameters there are, how many are called valid, and how many of these are
    wrong.
    """
    valid = [each for result in results for each in errors(result, valid_only=True)]
    return (
        sum(len(errors(result, valid_only=False)) for result in results),
        len(valid),
        sum(each > WRONG for each in valid),
    )


def covered(results: Sequence[Json]) -> tuple[int, int]:
    """Return how many of the valid estimates with a standard deviation lie within two of the truth,
    and how many there are.
    """
    inside = total = 0
    for result in results:
        for name, true in result.get("true", {}).items():
            if result["valid"][name] and result["sd"][name] > 0 and math.isfinite(true):
                inside += abs(result["final"][name] - true) <= 2 * result["sd"][name]
                total += 1
    return inside, total


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "-"


def _two(values: Sequence[float], form: str = ".3g") -> str:
    finite = sorted(values)
    if not finite:
        return "-"
    return " / ".join(
        "never" if math.isinf(x) else f"{x:{form}}"
        for x in (statistics.median_high(finite), finite[-1])
    )


def _settling(results: Sequence[Json], key: str = "settled_s") -> list[float]:
    return [math.inf if result.get(key) is None else result[key] for result in results]


def _class(results: Sequence[Json]) -> int:
    valid = [each for result in results for each in errors(result, valid_only=True)]
    if not valid:
        return 2
    if max(valid) > RIGHT:
        return 4 if max(valid) > WRONG else 3
    return 0 if len(valid) == counts(results)[0] else 1


def _map(found: Mapping[str, Mapping[str, Sequence[Json]]]) -> None:
    names, conditions = list(found), list(CONDITIONS)
    cells = np.array(
        [[_class(found[method].get(name, [])) for method in names] for name in conditions]
    )
    figure, axes = plt.subplots(figsize=(10, 11), layout="constrained")
    axes.imshow(
        cells,
        cmap=ListedColormap(list(CLASSES.values())),
        vmin=-0.5,
        vmax=len(CLASSES) - 0.5,
        aspect="auto",
    )
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_yticks(range(len(conditions)), conditions, fontsize=8)
    axes.set_xticks(np.arange(len(names) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(conditions) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=0.8)
    axes.tick_params(which="both", length=0)
    handles = [Patch(color=colour, label=meaning) for meaning, colour in CLASSES.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    figure.savefig(FOLDER / "conditions.png", dpi=110)
    plt.close(figure)


def _overview(found: Mapping[str, Mapping[str, Sequence[Json]]]) -> list[str]:
    lines = [
        (
            "| method | valid under good conditions | valid over all | valid, > 10 % off | within 2"
            " sd | changes found without one |"
        ),
        "|---|---|---|---|---|---|",
    ]
    for method, cells in found.items():
        good = [result for name in GOOD for result in cells.get(name, [])]
        every = [result for results in cells.values() for result in results]
        (n_good, v_good, _), (n, v, wrong), (inside, total) = (
            counts(good),
            counts(every),
            covered(every),
        )
        unchanged = [
            result
            for name, results in cells.items()
            if CONDITIONS[name].constant
            for result in results
        ]
        false = sum(result.get("changes", 0) > 0 for result in unchanged)
        row = (
            method,
            _share(v_good, n_good),
            _share(v, n),
            _share(wrong, v),
            _share(inside, total),
            f"{false} of {len(unchanged)}",
        )
        lines.append(f"| {' | '.join(row)} |")
    return lines


def _error(results: Sequence[Json]) -> str:
    worst = [max(errors(result, valid_only=True), default=0.0) for result in results]
    total, valid, wrong = counts(results)
    off = sum(x > RIGHT for x in worst)
    return (
        f"{_two(worst)} %; valid {_share(valid, total)}; records > 5 % off: {off}; parameters >"
        f" 10 % off: {wrong}"
    )


def _time(results: Sequence[Json]) -> str:
    return f"{_two(_settling(results), '.1f')} s"


def _times(results: Sequence[Json]) -> str:
    return (
        f"{_two(_settling(results, 'settled_valid_or_not_s'), '.1f')} s; and valid after"
        f" {_time(results)}"
    )


def _both(results: Sequence[Json]) -> str:
    return f"{_error(results)}; within 5 % for good after {_time(results)}"


def _goals(cells: Mapping[str, Sequence[Json]]) -> list[str]:
    """Return the best method's figures for each group of conditions that has a goal."""

    def of(*names: str) -> list[Json]:
        return [result for name in names for result in cells.get(name, [])]

    def row(
        title: str, goal: str, results: Sequence[Json], figure: Callable[[Sequence[Json]], str]
    ) -> str:
        return f"| {title} | {len(results)} | {goal} | {figure(results)} |"

    reached = "reached: error of what is valid at 60 s, median / largest"
    back = "back within 5 % in 10 s: <= 40 s"
    noise = "noise reference of 5 rad/s: within 5 % for good after"
    others = of("noise 2 rad/s", "noise 10 rad/s")
    return [
        f"| conditions | records | goal | {reached} |",
        "|---|---|---|---|",
        row("constant torque, 0.5 to 50 % of Fc", "<= 0.3 %, <= 10 s", of(*TORQUES), _both),
        row("torque step of 25 % of Fc at 30 s", back, of("torque step 25 %"), _both),
        *(
            row(name, "<= 5 %, or not valid", of(name), _error)
            for name in ("chirp", "steps", "20 deg/s rms", *HARD)
        ),
        row(noise, "4.5 / 6.5 s", of("standard"), _times),
        row("the same, 2 and 10 rad/s", "no slower", others, _times),
    ]


def _table(cells: Mapping[str, Sequence[Json]]) -> list[str]:
    lines = [
        "| condition | error, % | of what is valid, % | 5 % after, s | valid | > 10 % |",
        "|---|---|---|---|---|---|",
    ]
    for name, results in cells.items():
        total, valid, wrong = counts(results)
        everything = [max(errors(result, valid_only=False), default=math.inf) for result in results]
        counted = [max(found) for result in results if (found := errors(result, valid_only=True))]
        row = (
            name,
            _two(everything),
            _two(counted),
            _two(_settling(results), ".1f"),
            f"{valid} of {total}",
            str(wrong),
        )
        lines.append(f"| {' | '.join(row)} |")
    return lines


TEXT = """# Observers under many conditions

Written by `benchmarks/conditions/run.py`, which makes its records with a simulator, a sensor and a
controller of its own. A record has 60 s; the estimates at its end are compared with the true
values. A condition changes one thing of the standard record: a reference of noise through 5 rad/s
(one or two sections by turns) of 120 deg/s rms, 1 ms, 40000 counts a turn, no load, no delay, no
noise, sets S and R of [the mathematics](../mathematics.md). Methods that read the position get the
encoder, methods that read the velocity the true one, so that they are not judged by a
differentiation that they do not contain. No method gets a true value. `moving_horizon` is no
observer but a ceiling: it solves a least-squares problem over the last 10 s every 5 s
(`benchmarks/conditions/moving_horizon.py`), on the first record of each plant only; times are those
of this grid.

An estimate counts as right within 5 % and as wrong beyond 10 %. "within 2 sd" is the share of the
valid estimates that have a standard deviation and lie within two of them of the true value (goal:
90 to 99 %).

![Methods and conditions: what is valid, and whether it is right](conditions.png)
"""


def publish(found: Mapping[str, Mapping[str, Sequence[Json]]], best: str) -> None:
    """Write the page and its figure from the results, by method and condition; a method without any
    is left out.
    """
    found = {method: cells for method, cells in found.items() if any(cells.values())}
    _map(found)
    lines = [
        TEXT,
        "## All methods",
        "",
        *_overview(found),
        "",
        f"## {best} against its goals",
        "",
        *_goals(found[best]),
        "",
    ]
    for method, cells in found.items():
        lines += [f"## {method}", "", "Median / largest over the records.", "", *_table(cells), ""]
    (FOLDER / "conditions.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
