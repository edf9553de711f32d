"""Figures of the measured data sets, as PNG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from cases import Run, torque_along
from matplotlib import rc_context

from bristle.common.drawing import (
    BLUE,
    DEGREES,
    GREY,
    INK,
    ORANGE,
    PALE,
    STYLE,
    new_figure,
    set_title,
    thin,
)
from bristle.diagnosis.estimation.dataset import SEGMENT_SECONDS
from bristle.diagnosis.report.figures.of_diagnosis import worst_part

DPI = 130
NAMED, OTHER = BLUE, PALE


def emps(runs: Sequence[Run]) -> Any:
    """Position and open-loop errors of the whole record."""
    [run] = runs
    d = run.data
    figure = new_figure(8.6, 4.2)
    top, low = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [1, 1.5]})
    figure.subplots_adjust(hspace=0.34, left=0.09)
    i = thin(len(d["time"]), 3000)
    top.plot(d["time"][i], 1e3 * d["measured"][i], color=INK)
    set_title(top, "measured position")
    top.set_ylabel("position, mm")
    for name, colour in (("before", ORANGE), ("after", BLUE)):
        label = f"{name}: {1e3 * d['rmse'][name]:.2f} mm rms"
        low.plot(d["time"][i], 1e3 * (d[name] - d["measured"])[i], color=colour, label=label)
    low.axhline(0, color=INK, linewidth=0.7)
    low.legend(loc="upper left", ncols=2)
    low.margins(y=0.2)
    set_title(low, "simulated in open loop over the whole record, less measured")
    low.set_ylabel("error, mm")
    low.set_xlabel("time, s")
    low.set_xlim(d["time"][0], d["time"][-1])
    return figure


def xl330(runs: Sequence[Run]) -> Any:
    """The error where it was worst, before and after, and the gains of the first two rounds."""
    [run] = runs
    figure = new_figure(8.6, 5.2)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.2, 1], hspace=0.5, wspace=0.12)
    ax = figure.add_subplot(grid[0, :])
    _errors(ax, run)
    for column, number in enumerate((0, 1)):
        if number < len(run.found.rounds):
            _bars(figure.add_subplot(grid[1, column]), run.found.rounds[number], number + 1)
    return figure


def _errors(ax: Any, run: Run) -> None:
    found = worst_part(run.found.traces)
    assert found is not None
    trace, part = found
    time = trace.time[part]
    first = (
        np.arange(len(trace.time)) % round(SEGMENT_SECONDS / float(np.median(np.diff(trace.time))))
        == 0
    )
    added = f"with {', '.join(e.name for e in run.found.effects) or 'nothing'}"
    for simulated, colour, label in (
        (trace.before, ORANGE, "refitted model"),
        (trace.after, BLUE, added),
    ):
        # no line from one segment to the next
        error = np.where(first, np.nan, simulated - trace.measured)
        ax.plot(time, DEGREES * error[part], color=colour, label=label)
    ax.axhline(0, color=INK, linewidth=0.7)
    ax.margins(y=0.25)
    ax.legend(loc="upper left", ncols=2)
    set_title(
        ax,
        f"{trace.name}, simulated less measured where it was worst; each segment of 0.4 s starts"
        " anew",
    )
    ax.set_xlabel("time, s")
    ax.set_ylabel("error, deg")
    ax.set_xlim(time[0], time[-1])


def _bars(ax: Any, each: Any, number: int) -> None:
    ranked = [c for c in each.candidates if math.isfinite(c.gain)][:6]
    right = 1.75 * max(c.gain for c in ranked)
    ax.axvspan(0, each.null_level, color=GREY, alpha=0.25, linewidth=0)
    for row, c in enumerate(ranked):
        gain = max(c.gain, 0.0)
        ax.barh(row, gain, color=NAMED if c.name == each.added else OTHER, height=0.62)
        ax.text(
            gain + 0.015 * right, row, f"{c.name}  {c.gain:.0f}", va="center", fontsize=8, color=INK
        )
    ax.set_xlim(0, right)
    ax.set_ylim(len(ranked) - 0.5, -0.6)
    ax.set_yticks([])
    ax.grid(axis="y", visible=False)
    ax.spines["left"].set_visible(False)
    set_title(ax, f"round {number}: {each.added or 'nothing'} added")
    ax.set_xlabel("gain of the likelihood, nats")


def go1(runs: Sequence[Run]) -> Any:
    """Weight and inertia that were found, over the load, with a line through the origin and through
    the unloaded motor.
    """
    figure = new_figure(8.6, 2.9)
    axes = figure.subplots(1, 2)
    figure.subplots_adjust(wspace=0.26, left=0.09, bottom=0.2)
    known = [run for run in runs if "A" in run.data]
    mass = np.array([run.data["mass"] for run in known])
    for ax, key, factor, label, title in (
        (axes[0], "A", 1.0, "A, N·m", "amplitude of gravity"),
        (axes[1], "J", 1e3, "J, 10⁻³ kg·m²", "inertia beside it"),
    ):
        found = [run.data[key] for run in known]
        value = factor * np.array([e.value for e in found])
        error = factor * np.array([[e.value - e.ci95[0], e.ci95[1] - e.value] for e in found]).T
        slope, offset = (
            np.polyfit(mass, value, 1) if key == "J" else (float(mass @ value / (mass @ mass)), 0.0)
        )
        line = np.array([0.0, 3.2])
        ax.plot(line, offset + slope * line, color=GREY, linewidth=1.0)
        ax.errorbar(mass, value, yerr=error, fmt="o", color=BLUE, capsize=3, markersize=5)
        ax.set_xlim(0, 3.2)
        ax.set_ylim(bottom=0)
        set_title(ax, f"{title}: {slope:.3g} {'N·m' if key == 'A' else '10⁻³ kg·m²'} a kilogram")
        ax.set_ylabel(label)
        ax.set_xlabel("load, kg")
    return figure


def odrive(runs: Sequence[Run]) -> Any:
    """Torque of the motor along the position, with and without compensation, and the cogging that
    was named.
    """
    figure = new_figure(8.6, 3.1)
    axes = figure.subplots(1, 2, sharey=True)
    figure.subplots_adjust(wspace=0.08, left=0.09, bottom=0.19)
    for ax, run in zip(axes, runs, strict=True):
        middle = []
        for record in run.records:
            theta, torque = torque_along(record, run.data["gain"])
            i = thin(len(theta), 1500)
            label = f"motor, {len(run.records)} records" if record is run.records[0] else None
            ax.plot(
                DEGREES * theta[i],
                1e3 * torque[i],
                color=ORANGE,
                linewidth=0.9,
                alpha=0.8,
                label=label,
            )
            middle.append(float(np.mean(torque)))
        for e in run.found.effects:
            if e.name == "cogging":
                p = {name: each.value for name, each in e.parameters.items()}
                theta = np.linspace(
                    min(r.y.min() for r in run.records), max(r.y.max() for r in run.records), 800
                )
                angle = p["periods"] * theta
                cogging = p["amplitude"] * np.sin(angle + p["phase"])
                cogging += p.get("amplitude2", 0.0) * np.sin(2 * angle + p.get("phase2", 0.0))
                for n in (3, 4):
                    sine, cosine = p.get(f"sine{n}", 0.0), p.get(f"cosine{n}", 0.0)
                    wave = sine * np.sin(n * angle) + cosine * np.cos(n * angle)
                    cogging += p["amplitude"] * wave
                label = f"against cogging as named, {p['periods']:.2f} in a turn"
                ax.plot(DEGREES * theta, 1e3 * (np.mean(middle) - cogging), color=BLUE, label=label)
        ax.margins(y=0.28)
        ax.legend(loc="upper left", fontsize=8)
        set_title(
            ax, f"compensation {'on' if run.data['compensated'] else 'off'}; said: {run.said}"
        )
        ax.set_xlabel("position, deg")
    axes[0].set_ylabel("torque, 10⁻³ N·m")
    return figure


FIGURES = {"emps": emps, "bam_xl330_gain": xl330, "bam_go1_load": go1, "odrive_cogging": odrive}


def write(folder: str, runs: Sequence[Run], out: Path) -> Path:
    """Draw the figure of a data set."""
    out.mkdir(parents=True, exist_ok=True)
    make = FIGURES[folder]
    path = out / f"measured_{make.__name__}.png"
    with rc_context(STYLE):
        make(runs).savefig(path, dpi=DPI, metadata={"Software": None})
    return path
