"""Whole records in open loop: measured and simulated, the error, and how it grows with the horizon;
as a figure and as a table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.drawing import (
    BASELINE,
    ESTIMATE,
    INK,
    MEASURED,
    OTHER,
    new_figure,
    set_labels,
    set_title,
)
from bristle.common.time_plot import time_curve, time_horizontal, time_panel
from bristle.diagnosis.answer import RecordTrace, WholeRecords
from bristle.diagnosis.report.figures.axes import shown

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DrawnModel:
    """A model in the figure: its output along the record that is drawn (or None), and (horizon [s],
    rms error) of all records.
    """

    label: str
    colour: str
    simulated: Array | None
    horizons: Sequence[tuple[float, float]]
    style: Any = "-"


def open_loop_figure(
    trace: RecordTrace, curves: Sequence[DrawnModel], output: tuple[str, str]
) -> Any:
    """Return the figure of one record; `output` is kind and SI unit of what was measured."""
    kind, si = output
    factor, name = shown(si)
    figure = new_figure(11.0, 4.8)
    top, low = figure.subplots(2, 1, height_ratios=[1.3, 1.0])
    figure.subplots_adjust(hspace=0.4)
    for ax in (top, low):
        time_panel(ax, trace.name)
    time_curve(top, trace.time, factor * trace.measured, MEASURED, "measured", linewidth=2.6)
    # simulated over measured, and the error below
    for curve in curves:
        if curve.simulated is not None:
            time_curve(
                top,
                trace.time,
                factor * curve.simulated,
                curve.colour,
                curve.label,
                linestyle=curve.style,
            )
            time_curve(
                low,
                trace.time,
                factor * (curve.simulated - trace.measured),
                curve.colour,
                curve.label,
                linewidth=1.0,
            )
    time_horizontal(low, 0.0, INK, linewidth=0.7)
    for ax in (top, low):
        ax.set_xlim(trace.time[0], trace.time[-1])
    top.legend(loc="lower right", ncols=3, bbox_to_anchor=(1.0, 1.0), fontsize=8)
    set_title(top, trace.name)
    set_labels(top, y=f"{kind}, {name}")
    set_labels(low, x="time, s", y=f"error, {name}")
    return figure


def horizon_figure(curves: Sequence[DrawnModel], si: str) -> Any:
    """Return the figure of the error against the horizon, in the SI unit `si` of the output; None
    if there is no error.
    """
    from matplotlib.ticker import LogLocator, NullLocator

    factor, name = shown(si)
    points_by_curve = [
        (curve, [(x, factor * y) for x, y in curve.horizons if math.isfinite(y) and y > 0])
        for curve in curves
    ]
    if not any(points for _, points in points_by_curve):
        return None
    figure = new_figure(11.0, 3.2)
    ax = figure.subplots()
    for curve, points in points_by_curve:
        if points:
            ax.plot(
                *zip(*points, strict=True),
                color=curve.colour,
                linestyle=curve.style,
                marker="o",
                label=curve.label,
            )
    for axis, scale in ((ax.xaxis, ax.set_xscale), (ax.yaxis, ax.set_yscale)):
        scale("log")
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
    ax.legend(loc="upper left", fontsize=8)
    set_title(ax, "error against horizon")
    set_labels(ax, x="simulated anew after, s", y=f"rms error, {name}")
    return figure


def horizons_seen(curves: Sequence[DrawnModel], si: str) -> str:
    """Return what the figure of the error against the horizon shows: its ends."""
    factor, name = shown(si)
    words = []
    for curve in curves:
        points = [(x, factor * y) for x, y in curve.horizons if math.isfinite(y)]
        if points:
            ends = " and ".join(
                f"{y:.3g} {name} after {x:.3g} s" for x, y in (points[0], points[-1])
            )
            words.append(f"{curve.label}: rms error {ends}")
    return "; ".join(words)


def worst(whole: WholeRecords) -> int:
    """Return the place of the record with the largest error after the search, over its motion."""
    fits = [r.fit_after if math.isfinite(r.fit_after) else -math.inf for r in whole.records]
    return int(np.argmin(fits))


def whole_curves(whole: WholeRecords, both: bool) -> list[DrawnModel]:
    """Return the models of the figures of a diagnosis, along the record that fits worst; `both` if
    before and after differ.
    """
    trace = whole.traces[worst(whole)]
    seconds = [h.seconds for h in whole.horizons]
    after = list(zip(seconds, (h.after for h in whole.horizons), strict=True))
    before = list(zip(seconds, (h.before for h in whole.horizons), strict=True))
    curves = [DrawnModel("before", OTHER, trace.before, before)] if both else []
    if whole.refitted:
        segments = list(zip(seconds, (h.segments for h in whole.horizons), strict=True))
        curves.append(DrawnModel("as fitted to segments", BASELINE, None, segments))
    curves.append(
        DrawnModel(
            "after" if both else "refitted model",
            ESTIMATE,
            trace.after,
            after,
            (0, (3, 2)) if both else "-",
        )
    )
    return curves
