"""The report of a store: verdicts, estimates, coverage of intervals, and where runs fail."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common import pages
from bristle.common.cache import digest
from bristle.common.drawing import (
    ESTIMATE,
    FAILED,
    GREY,
    REFERENCE_COLOUR,
    STYLE,
    new_figure,
    set_labels,
    set_title,
    svg,
)
from bristle.common.metrics import NORMAL_95
from bristle.common.signals import Array
from bristle.harness.sweep.store import ERROR_VERDICT, Store

CONFIDENCE = 0.95  # of the intervals of shares
SHOWN_RUNS = 400  # points of the maps, each with its row: runs that do not pass first
MOST_MAPS = 6  # pairs of values that are mapped
MOST_MESSAGES = 5  # reasons why runs ended that are listed, the most frequent ones
BINS = 10  # of a value, over which shares of runs are taken
HISTOGRAM_BINS = 40
TAIL = 1.0  # percent of the runs at either end that a histogram leaves out
PERCENTILES = (5.0, 50.0, 95.0)
MAP_SEED = 1  # chooses which passing runs are shown
OUTCOMES = ("pass", "fail", ERROR_VERDICT)
PLACES = {
    "all pass": ESTIMATE,
    "some pass": REFERENCE_COLOUR,
    "none passes": FAILED,
    ERROR_VERDICT: GREY,
}  # colour by what the runs there do
MOST_WORDS = 12  # different texts of a value that an axis has room for


@dataclass(frozen=True)
class PassingShare:
    """How many of how many, with the Clopper-Pearson interval of the share."""

    count: int
    total: int

    @property
    def interval(self) -> tuple[float, float]:
        """Bounds of the share at `CONFIDENCE`."""
        from scipy.stats import binomtest

        interval = binomtest(self.count, self.total).proportion_ci(CONFIDENCE, "exact")
        return float(interval.low), float(interval.high)

    def text(self) -> str:
        """Return the share with its interval in percent."""
        if not self.total:
            return "–"
        low, high = self.interval
        return f"{100 * self.count / self.total:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


class Runs:
    """The runs of a store as columns."""

    def __init__(self, store: Store) -> None:
        self.sweeps, self._table = store.sweeps(), store.table()
        self.verdict = [str(each) for each in self._table["verdict"].to_pylist()]
        self.index = np.arange(len(self.verdict))

    def __len__(self) -> int:
        return len(self.verdict)

    def column(self, name: str) -> list[Any]:
        """Return a column, all null if there is none of that name."""
        return (
            self._table[name].to_pylist()
            if name in self._table.column_names
            else [None] * len(self)
        )

    def numbers(self, name: str) -> Array:
        """Return a column of numbers, not a number where there is none."""
        return np.array(
            [math.nan if value is None else float(value) for value in self.column(name)]
        )

    def share(self, chosen: NDArray[np.bool_] | None = None) -> PassingShare:
        """Return how many of the chosen runs pass."""
        passed = np.array([verdict == "pass" for verdict in self.verdict])
        chosen = np.ones(len(self), dtype=bool) if chosen is None else chosen
        return PassingShare(int(np.sum(passed & chosen)), int(np.sum(chosen)))

    @property
    def parameters(self) -> list[str]:
        """The parameters of which there are estimates."""
        names = [name.split(".") for name in self._table.column_names]
        return sorted({parts[1] for parts in names if len(parts) == 3 and parts[0] == "estimates"})

    @property
    def varied(self) -> list[str]:
        """What varies over the runs: the values asked for, and the seed, if there are several."""
        asked = dict.fromkeys(itertools.chain.from_iterable(sweep["vary"] for sweep in self.sweeps))
        return [name for name in [*asked, "seed"] if len(set(self.column(name)) - {None}) > 1]

    def numeric(self, name: str) -> bool:
        """Whether a column has numbers."""
        return not any(isinstance(value, str) for value in self.column(name))

    def label(self, name: str) -> str:
        """Return a value that varies with its unit, where the sweeps agree on one."""
        units = {sweep["vary"][name] for sweep in self.sweeps if name in sweep["vary"]}
        unit = units.pop() if len(units) == 1 else ""
        return name if " " in unit or unit in ("", "text") else f"{name} [{unit}]"

    @property
    def unfinished(self) -> list[str]:
        """A line on each sweep that was not finished: which of its runs are missing here."""
        return [
            f"the sweep of {sweep['runs']} runs of {sweep['scenario']} begun at"
            f" {sweep['provenance']['date']} is not finished: the store has {len(self)} runs;"
            " resume it"
            for sweep in self.sweeps
            if not sweep.get("finished", True)
        ]

    @cached_property
    def versions(self) -> list[tuple[object, ...]]:
        """What decides each run beside its values and its seed: hashes of scenario and FMUs."""
        hashes = [
            "scenario_sha256",
            *(name for name in self._table.column_names if name.startswith("sha256.")),
        ]
        return list(zip(*map(self.column, hashes), strict=True))


def statistics(runs: Runs) -> list[dict[str, Any]]:
    """Return, for each estimated parameter: valid runs, percentiles of the error in percent, and
    how often the interval holds.

    The interval is the estimate with 1.96 of its own standard deviations to either side; it holds
    if the true value is in it.
    """
    rows = []
    for name in runs.parameters:
        final, true, sd, error = (
            runs.numbers(f"estimates.{name}.{part}")
            for part in ("final", "true", "sd", "error_percent")
        )
        # errors where there is a true value, and whether the intervals hold it
        known = np.isfinite(error)
        told = np.isfinite(final) & np.isfinite(true) & np.isfinite(sd)
        holds = np.abs(final - true)[told] <= NORMAL_95 * sd[told]
        # runs in which the observer estimates it at all
        estimated = np.array(
            [value is not None for value in runs.column(f"estimates.{name}.valid")]
        )
        worst = int(np.nanargmax(np.abs(error))) if known.any() else None
        rows.append(
            {
                "parameter": name,
                "valid": PassingShare(int(np.sum(np.isfinite(final))), int(np.sum(estimated))),
                "errors": error[known],
                "percentiles": (
                    np.percentile(error[known], PERCENTILES)
                    if known.any()
                    else [math.nan] * len(PERCENTILES)
                ),
                "worst": worst,
                "worst_error": math.nan if worst is None else float(error[worst]),
                "coverage": PassingShare(int(np.sum(holds)), int(np.sum(told))),
            }
        )
    return rows


def summary(runs: Runs) -> dict[str, Any]:
    """Return the content of report.json: the figures of the report."""

    def share(each: PassingShare) -> dict[str, Any]:
        return {
            "count": each.count,
            "total": each.total,
            "interval95": list(each.interval) if each.total else None,
        }

    return {
        "runs": len(runs),
        "unfinished": runs.unfinished,
        "verdicts": dict(Counter(runs.verdict)),
        "pass": share(runs.share()),
        "failed_checks": _failed(runs),
        "estimates": {
            each["parameter"]: {
                "valid": share(each["valid"]),
                "error_percent": dict(zip(("p5", "p50", "p95"), each["percentiles"], strict=True)),
                "worst_error_percent": each["worst_error"],
                "coverage95": share(each["coverage"]),
            }
            for each in statistics(runs)
        },
    }


def render(runs: Runs) -> str:
    """Return report.html."""
    shown = _shown(runs)
    estimates = [each for each in statistics(runs) if each["valid"].total]
    drawn = [each for each in estimates if len(each["errors"]) > 1]
    mapped = _mapped(runs)
    pairs = list(itertools.combinations(mapped, 2))
    return pages.render(
        "bristle.harness.sweep/report.html",
        scenarios=list(dict.fromkeys(sweep["scenario"] for sweep in runs.sweeps)),
        share=runs.share(),
        unfinished=runs.unfinished,
        versions=_versions(runs),
        outcomes=_outcomes(runs),
        estimates=estimates,
        histograms=_histograms(drawn) if drawn else None,
        tail=TAIL,
        groups=_groups(runs) if runs.varied else None,
        maps=_scatter(runs, pairs[:MOST_MAPS], shown) if pairs else None,
        more_pairs=len(pairs) > MOST_MAPS,
        most_maps=MOST_MAPS,
        listed=_listed(runs, shown),
        sweeps=runs.sweeps,
    )


# -- parts -----------------------------------------------------------------------------------------


def _failed(runs: Runs) -> dict[str, int]:
    """Return in how many runs each check fails."""
    said = (each.split("; ") for each in runs.column("failed") if each)
    return dict(Counter(itertools.chain.from_iterable(said)).most_common())


def _outcomes(runs: Runs) -> list[tuple[str, PassingShare]]:
    """Return what runs came to, verdicts first, and how many of them did."""
    counts = Counter(runs.verdict)
    outcomes = [(f"verdict {word}", counts[word]) for word in OUTCOMES if counts[word]]
    outcomes += [(f"check fails: {name}", count) for name, count in _failed(runs).items()]
    outcomes += Counter(each for each in runs.column("message") if each).most_common(MOST_MESSAGES)
    return [(what, PassingShare(count, len(runs))) for what, count in outcomes]


def _versions(runs: Runs) -> list[dict[str, Any]]:
    """Return the versions of the scenario and of its FMUs of which there are runs, with the share
    of each that passes.
    """
    dates = {
        sweep["scenario_sha256"]: sweep["provenance"]["date"] for sweep in reversed(runs.sweeps)
    }
    return [
        {
            "scenario": str(version[0])[:8],
            "fmus": digest(*map(str, version[1:]))[:8],
            "since": dates.get(version[0], ""),
            "share": runs.share(np.array([each == version for each in runs.versions])),
        }
        for version in dict.fromkeys(runs.versions)
    ]


def _histograms(estimates: Sequence[Mapping[str, Any]]) -> str:
    from matplotlib import rc_context

    columns = min(3, len(estimates))
    lines = math.ceil(len(estimates) / columns)
    with rc_context(STYLE):
        drawing = new_figure(10.2, 2.3 * lines + 0.3)
        drawing.subplots_adjust(wspace=0.28, hspace=0.65)
        for place, each in enumerate(estimates, 1):
            ax = drawing.add_subplot(lines, columns, place)
            low, high = np.percentile(each["errors"], (TAIL, 100 - TAIL))
            room = 0.02 * (high - low) or 1e-3
            ax.hist(each["errors"], HISTOGRAM_BINS, range=(low - room, high + room), color=ESTIMATE)
            ax.axvline(0.0, color=GREY, linewidth=1.0)
            set_title(ax, each["parameter"])
            set_labels(ax, "error, %", "runs" if place % columns == 1 or columns == 1 else None)
        return svg(drawing, "histograms")


def _shown(runs: Runs) -> NDArray[np.intp]:
    """Return which runs the maps show: those that do not pass, then passing ones at random."""
    passed = np.array([verdict == "pass" for verdict in runs.verdict])
    draw = np.random.default_rng(MAP_SEED)
    failing, passing = draw.permutation(runs.index[~passed]), draw.permutation(runs.index[passed])
    most = max(SHOWN_RUNS // 2, SHOWN_RUNS - len(passing))
    failing = failing[:most]
    return np.sort(np.concatenate([failing, passing[: SHOWN_RUNS - len(failing)]]))


def _mapped(runs: Runs) -> list[str]:
    """Return the values that maps show: numbers, and few different texts."""
    return [
        name
        for name in runs.varied
        if name != "seed" and (runs.numeric(name) or len(set(runs.column(name))) <= MOST_WORDS)
    ]


def _groups(runs: Runs) -> list[tuple[str, str, PassingShare]]:
    """Return the share of passing runs by each value that varies."""
    return [
        (runs.label(name), text, share)
        for name in runs.varied
        for text, share in _shares(runs, name)
    ]


def _shares(runs: Runs, name: str) -> list[tuple[str, PassingShare]]:
    """Return the share of passing runs by value, or by interval of equal numbers of runs where
    there are many values.
    """
    values = runs.column(name)
    different = sorted(set(values) - {None})
    if len(different) <= BINS or not runs.numeric(name):
        return [
            (
                value if isinstance(value, str) else f"{value:.6g}",
                runs.share(np.array([each == value for each in values])),
            )
            for value in different[: 3 * BINS]
        ]
    if name == "seed":
        return []
    numbers = runs.numbers(name)
    edges = np.unique(np.nanpercentile(numbers, np.linspace(0, 100, BINS + 1)))
    bins = np.searchsorted(edges[1:-1], numbers, side="right")
    return [
        (f"{low:.4g} to {high:.4g}", runs.share((bins == place) & np.isfinite(numbers)))
        for place, (low, high) in enumerate(itertools.pairwise(edges))
    ]


def _scatter(runs: Runs, pairs: Sequence[tuple[str, str]], shown: NDArray[np.intp]) -> str:
    from matplotlib import rc_context

    columns = min(2, len(pairs))
    lines = math.ceil(len(pairs) / columns)
    with rc_context(STYLE):
        drawing = new_figure(10.2, 3.3 * lines + 0.3)
        drawing.subplots_adjust(wspace=0.28, hspace=0.5)
        for place, (x, y) in enumerate(pairs, 1):
            ax = drawing.add_subplot(lines, columns, place)
            places = _places(runs, x, y, shown)
            scale_x, scale_y = (
                _scale(runs, name, axis) for name, axis in ((x, ax.xaxis), (y, ax.yaxis))
            )
            # a dot for each place, linked to its run
            for what, colour in PLACES.items():
                chosen = [(at, run) for at, (said, run) in places.items() if said == what]
                if chosen:
                    across, up = (
                        [scale_x(at[0]) for at, _ in chosen],
                        [scale_y(at[1]) for at, _ in chosen],
                    )
                    points = ax.scatter(across, up, 14, color=colour, label=what, linewidths=0)
                    points.set_urls([f"#run-{run}" for _, run in chosen])
            set_labels(ax, runs.label(x), runs.label(y))
            ax.legend(
                loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderpad=0, handletextpad=0.2
            )
        return svg(drawing, "maps")


def _places(
    runs: Runs, x: str, y: str, shown: NDArray[np.intp]
) -> dict[tuple[Any, Any], tuple[str, int]]:
    """Return what all runs do at each pair of values shown, and the run that is linked."""
    there: dict[tuple[Any, Any], list[int]] = {}
    for run, at in enumerate(zip(runs.column(x), runs.column(y), strict=True)):
        there.setdefault(at, []).append(run)
    listed = {int(each) for each in shown}
    places = {}
    for at, members in there.items():
        several = [run for run in members if run in listed]
        if several and None not in at:
            verdicts = {runs.verdict[run] for run in members}
            said = (
                "some pass"
                if "pass" in verdicts
                else "none passes"
                if "fail" in verdicts
                else ERROR_VERDICT
            )
            said = "all pass" if verdicts == {"pass"} else said
            places[at] = said, min(several, key=lambda run: (runs.verdict[run] == "pass", run))
    return places


def _scale(runs: Runs, name: str, axis: Any) -> Callable[[Any], float]:
    """Return where a value stands on an axis; texts side by side, in the order of the runs."""
    if runs.numeric(name):
        return float
    words = list(dict.fromkeys(str(value) for value in runs.column(name) if value is not None))
    axis.set_ticks(range(len(words)), words)
    return lambda value: float(words.index(str(value)))


def _listed(runs: Runs, shown: NDArray[np.intp]) -> list[dict[str, Any]]:
    """Return the runs of the maps with the commands that repeat them."""
    columns = ("run", "command", "failed", "message")
    run, command, failed, message = (runs.column(name) for name in columns)
    return [
        {
            "index": each,
            "name": run[each] if len(runs.sweeps) == 1 else each,
            "verdict": runs.verdict[each],
            "why": [text for text in (failed[each], message[each]) if text],
            "command": command[each],
        }
        for each in shown.tolist()
    ]
