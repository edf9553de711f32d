"""The page docs/study/compensation.md: goals, tables of ratios at each speed, and the map of them
at the low one.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.colors import BoundaryNorm, ListedColormap

Json = dict[str, Any]
Found = Mapping[tuple[str, str, str, int], Json]
STUDY_FOLDER = Path(__file__).resolve().parents[2] / "docs" / "study"
# tracking error over that of the controller alone: aimed at, and not to be exceeded
GOAL, NO_HELP = 0.5, 1.0
# a ratio that rounds to 1.00 is no worse: nothing was compensated, or next to nothing
ROUNDING = 0.005
WAYS = {"valid": "Only valid estimates", "adapted": "All estimates on trial, once adapted"}
CLASSES = {  # upper limit of the ratio, and its colour
    0.25: "#1a7f37",
    GOAL: "#9bd3a8",
    0.9: "#e3efe6",
    NO_HELP + ROUNDING: "#d9d9d9",
    math.inf: "#c62828",
}


class Ratios:
    """Tracking errors over those of the controller alone, by who compensates."""

    def __init__(self, found: Found, references: tuple[str, ...]) -> None:
        self.found, (self.alone, *self.known) = found, references
        self.laws = list(dict.fromkeys(job[2] for job in found))

    def who(self, way: str) -> list[str]:
        """Return the observers, by which of their estimates count."""
        return list(dict.fromkeys(job[0] for job in self.found if job[1] == way and way))

    def of(self, who: str, way: str, law: str, speed: str) -> list[float]:
        """Return the ratio of every run on a law; infinite where a run ended early."""
        out = []
        for (name, how, plant, seed), result in self.found.items():
            base = self.found.get((self.alone, "", law, seed), {})
            if (name, how, plant) == (who, way, law) and "rms" in base:
                out.append(
                    result["rms"][speed] / base["rms"][speed] if "rms" in result else math.inf
                )
        return out

    def largest(self, who: str, way: str, law: str, speed: str) -> float:
        """Return the larger ratio of the runs on a law."""
        return max(self.of(who, way, law, speed), default=math.nan)

    def errors(self, law: str, speed: str) -> list[float]:
        """Return the tracking errors of the controller alone."""
        return [
            r["rms"][speed]
            for (name, _, plant, _), r in self.found.items()
            if (name, plant) == (self.alone, law) and "rms" in r
        ]


def _shown(value: float) -> str:
    text = "failed" if math.isinf(value) else f"{value:.2f}"
    return f'**<span style="color:#c62828">{text}</span>**' if value > NO_HELP + ROUNDING else text


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [
        f"| {' | '.join(head)} |",
        f"|{'---|' * len(head)}",
        *(f"| {' | '.join(row)} |" for row in rows),
        "",
    ]


def _goals(ratios: Ratios, way: str, speeds: Sequence[str]) -> list[str]:
    rows = []
    for name in ratios.who(way) if way else ratios.known:
        row = [f"`{name}`"]
        for speed in speeds:
            values = [x for law in ratios.laws for x in ratios.of(name, way, law, speed)]
            worse = sum(x > NO_HELP + ROUNDING for x in values)
            row += [
                f"{sum(x <= GOAL for x in values)} of {len(values)}",
                _shown(statistics.median(values)),
                _shown(max(values)),
                str(worse),
            ]
        rows.append(row)
    each = [
        what.format(speed)
        for speed in speeds
        for what in ("{} deg/s: ratio <= 0.5", "median", "largest", "got worse")
    ]
    return _table(["observer", *each], rows)


def _by_law(ratios: Ratios, who: Sequence[tuple[str, str]], speed: str) -> list[str]:
    rows = [
        [f"`{name}`", *(_shown(ratios.largest(name, way, law, speed)) for law in ratios.laws)]
        for name, way in who
    ]
    return _table(["", *ratios.laws], rows)


def _map(ratios: Ratios, who: Sequence[tuple[str, str]], speed: str) -> None:
    cells = np.array([[ratios.largest(*each, law, speed) for law in ratios.laws] for each in who])
    figure, axes = plt.subplots(figsize=(10, 0.32 * len(who) + 2.2), layout="constrained")
    limits = [0.0, *(limit if math.isfinite(limit) else 1e9 for limit in CLASSES)]
    colours = ListedColormap(list(CLASSES.values()))
    axes.imshow(
        np.minimum(cells, 1e8), cmap=colours, norm=BoundaryNorm(limits, len(CLASSES)), aspect="auto"
    )
    for (row, column), value in np.ndenumerate(cells):
        dark = value <= min(CLASSES) or value > NO_HELP + ROUNDING
        text = f"{value:.2f}" if math.isfinite(value) else "failed"
        axes.text(
            column,
            row,
            text,
            ha="center",
            va="center",
            fontsize=8,
            color="white" if dark else "black",
        )
    axes.set_xticks(range(len(ratios.laws)), ratios.laws, rotation=40, ha="right")
    axes.set_yticks(range(len(who)), [name for name, _ in who], fontsize=8)
    axes.set_xticks(np.arange(len(ratios.laws) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(who) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=0.8)
    axes.tick_params(which="both", length=0)
    figure.savefig(STUDY_FOLDER / "compensation.png", dpi=110)
    plt.close(figure)


def publish(found: Found, speeds: Sequence[str], references: tuple[str, ...]) -> None:
    """Write the page and its figure from the results, by (who compensates, which estimates count,
    law, seed).
    """
    ratios, slow_first = Ratios(found, references), list(reversed(speeds))
    known = [(name, "") for name in ratios.known]
    _map(ratios, [*known, *((name, "adapted") for name in ratios.who("adapted"))], slow_first[0])
    lines = [TEXT, "## Goals", ""]
    for way, meaning in {**WAYS, "": "True and wrong parameters"}.items():
        lines += [
            f"**{meaning}**, over all laws and references:",
            "",
            *_goals(ratios, way, slow_first),
        ]
    lines += [
        LIMITS,
        "## The controller alone",
        "",
        "Tracking error in deg/s rms, mean over the references.",
        "",
    ]
    alone = [
        [
            f"{speed} deg/s",
            *(f"{statistics.mean(ratios.errors(law, speed)):.2f}" for law in ratios.laws),
        ]
        for speed in slow_first
    ]
    lines += _table(["rms of the reference", *ratios.laws], alone)
    for speed in slow_first:
        lines += [
            f"## Ratios at {speed} deg/s rms",
            "",
            "The largest, if there are several references.",
            "",
        ]
        for way, meaning in WAYS.items():
            who = [*known, *((name, way) for name in ratios.who(way))]
            lines += [f"**{meaning}**", "", *_by_law(ratios, who, speed)]
    (STUDY_FOLDER / "compensation.md").write_text(
        "\n".join(lines).rstrip() + "\n", encoding="utf-8"
    )


TEXT = """# Friction compensation by every observer

Written by `python benchmarks/compensation/run.py`. The
[controller](../../fmus/controller/README.md) gets the estimates of an observer and adds to its PI
the voltage that the model needs along the reference, as far as this has made tracking better
([equations](../mathematics.md#friction-compensation)). Each run has 100 s at 120 deg/s rms, where
the observer identifies, then 20 s at 60 deg/s and 20 s at 15 deg/s, where it goes on; the tracking
error, reference minus true velocity, is taken over the last 15 s of each. The reference has order
2; laws and servo have their default parameters. The controller and the observers that read the
position get the encoder (40000 counts a turn: one count a sample is 9 deg/s), observers that read
the velocity the true one. No observer gets a true value.

A number in the tables is the tracking error over that of the same controller without compensation:
0.5 is half the error; above 1 (red) it got worse; 1.00 where nothing that counts was there. *true b
and alpha2* and *all true parameters* get the truth of the law in place of estimates: the first
shows what inertia and viscous friction alone are worth, the second what friction adds. A law
without a true c or Stribeck weights gives its Coulomb friction there, or nothing. The rows below
them, such as *b / 3*, get the true alpha2, b and Fc but for what the row names, all of it called
valid.

![Tracking error with compensation over that without, at the low speed, with all estimates on
trial](compensation.png)
"""
LIMITS = """The goal: at most half of the error of the controller alone at the low speed, and never
more than it.

## What limits the rest

- *Validity.* `self_starting_ekf` calls nothing valid on a law that its model does not contain, and
  is right to: there is no true c. Its estimates still describe the friction, which the trial shows:
  compare both tables. `approach_one` and `two_step_printed` do not converge; what they find is
  worth about what b and alpha2 alone are.
- *Restarts.* When an observer restarts, it says that it is not adapted, and the compensation fades
  out until it is again. On `modified_parallel` a restart of `self_starting_ekf` 8 s after the
  change to 15 deg/s takes it away for the rest of the run.
- *Coulomb friction alone.* The observers of step 1 find friction at high speed. Its share is fitted
  at low speed, up to twice, but not its shape: on `coulomb` and `stribeck_static`, whose friction
  turns at once at a reversal, W turns over a travel of 1/`assumed_c`. There, `swapped` and
  `two_step_drem` are limited by their c.
- *The reference.* One of order 1 has white noise as acceleration; r'/b alone then is 32 V rms at
  full speed, beyond the drive's 24 V. With `ORDER = 1.0` in the script `gms` and `leuven` end some
  runs, because their internal step becomes too small for it.
"""
