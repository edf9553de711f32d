"""Whole records in open loop: measured and simulated, the error, and how it grows with the horizon; as a figure and as a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.drawing import BLUE, GREEN, INK, ORANGE, new_figure, set_labels, set_title, thin
from bristle.common.html import number, table, unit
from bristle.diagnosis.report.axes import shown
from bristle.diagnosis.report.result import Trace, WholeRecords

Array = NDArray[np.float64]
OPEN_LOOP_POINTS = 2000  # points of a curve along a record


@dataclass(frozen=True)
class Curve:
    """A model in the figure: its output along the record that is drawn (or None), and (horizon [s], rms error) of all records."""

    label: str
    colour: str
    simulated: Array | None
    horizons: Sequence[tuple[float, float]]
    style: Any = "-"


def open_loop_figure(trace: Trace, curves: Sequence[Curve], output: tuple[str, str]) -> Any:
    """Return the figure of one record; `output` is kind and SI unit of what was measured."""
    from matplotlib.ticker import LogLocator, NullLocator

    kind, si = output
    factor, name = shown(si)
    index = thin(len(trace.time), OPEN_LOOP_POINTS)
    time = trace.time[index]
    figure = new_figure(11.0, 5.6)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.9, 1.0], hspace=0.5, wspace=0.24)
    top, low, side = (figure.add_subplot(grid[place]) for place in ((0, 0), (1, 0), (slice(None), 1)))
    top.plot(time, factor * trace.measured[index], color=INK, linewidth=3.0, alpha=0.28, label="measured")
    for curve in curves:
        if curve.simulated is not None:
            top.plot(time, factor * curve.simulated[index], color=curve.colour, linestyle=curve.style, label=curve.label)
            low.plot(time, factor * (curve.simulated - trace.measured)[index], color=curve.colour, linewidth=1.0)
        points = [(x, factor * y) for x, y in curve.horizons if math.isfinite(y) and y > 0]
        if points:
            side.plot(*zip(*points, strict=True), color=curve.colour, linestyle=curve.style, marker="o", label=curve.label)
    low.axhline(0, color=INK, linewidth=0.7)
    for ax in (top, low):
        ax.set_xlim(trace.time[0], trace.time[-1])
    top.legend(loc="lower right", ncols=3, bbox_to_anchor=(1.0, 1.0), fontsize=8)
    set_title(top, trace.name)
    set_labels(top, y=f"{kind}, {name}")
    set_labels(low, x="time, s", y=f"error, {name}")
    for axis, scale in ((side.xaxis, side.set_xscale), (side.yaxis, side.set_yscale)):
        scale("log")
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
    if side.lines:
        side.legend(loc="upper left", fontsize=8)
    set_title(side, "error against horizon")
    set_labels(side, x="simulated anew after, s", y=f"rms error, {name}")
    return figure


def worst(whole: WholeRecords) -> int:
    """Return the place of the record with the largest error after the search, relative to its motion."""
    fits = [r.fit_after if math.isfinite(r.fit_after) else -math.inf for r in whole.records]
    return int(np.argmin(fits))


def whole_figure(whole: WholeRecords, kind: str, both: bool) -> Any:
    """Return the figure of a diagnosis: the record that fits worst; `both` if before and after differ."""
    trace = whole.traces[worst(whole)]
    seconds = [h.seconds for h in whole.horizons]
    after = list(zip(seconds, (h.after for h in whole.horizons), strict=True))
    curves = (
        [Curve("before", ORANGE, trace.before, list(zip(seconds, (h.before for h in whole.horizons), strict=True)))] if both else []
    )
    if whole.refitted:
        curves.append(
            Curve("as fitted to segments", GREEN, None, list(zip(seconds, (h.segments for h in whole.horizons), strict=True)))
        )
    curves.append(Curve("after" if both else "refitted model", BLUE, trace.after, after, (0, (3, 2)) if both else "-"))
    return open_loop_figure(trace, curves, (kind, whole.records[0].unit))


def whole_table(whole: WholeRecords, both: bool) -> str:
    """Return the table of the errors of all records."""
    per = unit(whole.records[0].unit)
    rows = []
    for r in whole.records:
        cells = [number(r.rms_after, 3), number(r.fit_after, 4)]
        rows.append([escape(r.record), *([number(r.rms_before, 3), number(r.fit_before, 4)] if both else []), *cells])
    when = (f"rms error before, {per}", "FIT before, %", f"rms error after, {per}", "FIT after, %")
    head = ("record", *when) if both else ("record", f"rms error, {per}", "FIT, %")
    return table(head, rows, tuple(range(1, len(head))))
