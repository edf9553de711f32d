"""The figures of `reproduce` as SVG: each with the axes of the paper's, schemes side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from bristle.common.drawing import (
    BASELINE,
    DEGREES,
    ESTIMATE,
    FAILED,
    GREY,
    INK,
    LIMIT,
    MEASURED,
    OTHER,
    REFERENCE_COLOUR,
    STYLE,
    TRUTH,
    Drawing,
    new_figure,
    set_labels,
    set_title,
    svg,
)
from bristle.common.time_plot import time_curve, time_horizontal, time_panel
from bristle.harness.paper.printed_numbers import PRINTED
from bristle.harness.paper.schemes import (
    BASELINE_SCHEME,
    FILTER_ORDERS,
    LETTERS,
    SCHEMES,
    Key,
    PaperComparison,
    SchemeCase,
)
from bristle.harness.run.figure_text import MODEL_LABELS
from bristle.harness.run.figures import MODEL_COLOURS, PLAIN_SYMBOLS

SCHEME_COLOURS = {"printed": BASELINE, "repaired": OTHER, "best": ESTIMATE}
# several estimates in one pair of axes need several colours
STEP1 = {"alpha2": ESTIMATE, "b": OTHER}
STEP2 = {"sigma0": ESTIMATE, "sigma1": OTHER, "sigma2": LIMIT, "c": BASELINE}
TAKEN_LARGER = {"step1": 1.0, "step2": 100.0}  # parameters of set S over the printed levels
DASHED: Any = (0, (4, 3))
SHOWN_SPEED = 100.0  # deg/s: right end of Fig. 1


def draw(comparison: PaperComparison) -> dict[str, Drawing]:
    """Return the figures by name, each an <svg> element."""
    from matplotlib import rc_context

    made = {}
    with rc_context(STYLE):
        for name, painter in (
            ("eq25", _eq25),
            ("figure_1", _stribeck),
            ("figure_3", _reference),
            ("figure_4", _step1),
            ("figure_5", _step2),
            ("figure_6", _validation),
        ):
            made[name] = svg(painter(comparison), f"reproduce-{name}")
    return made


def _case(
    comparison: PaperComparison, scheme: str, plant: str = "S", order: int = FILTER_ORDERS[0]
) -> SchemeCase:
    return comparison.cases[Key(scheme, plant, order)]


# -- eq. (25) --------------------------------------------------------------------------------------


def _eq25(comparison: PaperComparison) -> Any:
    """Draw eq. (25) of all models, a row for each record, with the interval the paper prints."""
    rows = comparison.content["eq25"]
    figure = new_figure(11.0, 0.52 * len(rows) + 1.35)
    [ax] = [figure.subplots()]
    figure.subplots_adjust(left=1.75 / 11.0, top=1 - 0.72 / figure.get_size_inches()[1])
    low, high = PRINTED["mse"].values
    ax.axvspan(
        low, high, color=GREY, alpha=0.3, linewidth=0, label=f"printed: {low:g} to {high:g} %"
    )
    # the schemes, and the models fitted to the second record
    looks = {scheme: (SCHEME_COLOURS[scheme], "o", LETTERS[scheme]) for scheme in SCHEMES}
    looks |= {
        name: (INK, mark, MODEL_LABELS[name])
        for name, mark in (("coulomb", "D"), ("floor", "|"), ("linear", "s"))
    }
    # a mark in the row of each record where the model has a score
    for name, (colour, mark, label) in looks.items():
        points = [
            (row[name], k)
            for k, row in enumerate(rows)
            if row[name] is not None and math.isfinite(row[name])
        ]
        x = [max(value, 1e-14) for value, _ in points]
        filled = {"markerfacecolor": "none"} if name in ("linear", "coulomb") else {}
        ax.plot(
            x,
            [k for _, k in points],
            mark,
            color=colour,
            markersize=8,
            markeredgewidth=1.6,
            label=label,
            **filled,
        )
    ax.set_xscale("log")
    ax.set_yticks(range(len(rows)), [f"set {row['plant']}, order {row['order']}" for row in rows])
    ax.set_ylim(len(rows) - 0.5, -0.5)
    set_labels(ax, x="eq. (25) on the second record, % of the variance of the velocity (log scale)")
    ax.legend(
        loc="lower left", ncols=4, bbox_to_anchor=(-0.1, 1.0), columnspacing=1.4, handletextpad=0.3
    )
    return figure


# -- Figure 1 --------------------------------------------------------------------------------------


def _stribeck(comparison: PaperComparison) -> Any:
    figure = new_figure(11.0, 3.9)
    ax = figure.subplots()
    plant = _case(comparison, BASELINE_SCHEME, "L0").values
    friction = {name: float(plant[f"lugre.{name}"]) / float(plant["J"]) for name in ("Fs", "Fc")}
    v0 = float(plant["lugre.vs"]) * DEGREES
    for name, text in (("Fs", "a₀ + a₁"), ("Fc", "a₀")):
        ax.axhline(friction[name], color=GREY, linestyle=DASHED, linewidth=0.9)
        ax.text(SHOWN_SPEED * 0.995, friction[name], text, ha="right", va="bottom", color=INK)
    ax.axvline(v0, color=GREY, linestyle=DASHED, linewidth=0.9)
    top = 1.25 * friction["Fs"]
    ax.text(v0, 0.02 * top, " v₀", ha="left", va="bottom", color=INK)
    for name, (v, curve) in comparison.curves.items():
        label = "original LuGre law, set L0" if name == "plant" else LETTERS[name]
        style = (
            {"linewidth": 5.0, "color": TRUTH}
            if name == "plant"
            else {"color": SCHEME_COLOURS[name]}
        )
        ax.plot(v * DEGREES, curve, label=label, **style)
    ax.set_xlim(0, SHOWN_SPEED)
    ax.set_ylim(0, top)
    set_labels(ax, x="velocity, deg/s", y="friction over inertia, rad/s²")
    ax.legend(loc="upper right", ncols=4, bbox_to_anchor=(1.0, 1.13))
    return figure


# -- Figure 3 --------------------------------------------------------------------------------------


def _reference(comparison: PaperComparison) -> Any:
    figure = new_figure(11.0, 3.2)
    axes = figure.subplots(1, len(FILTER_ORDERS), sharey=True)
    figure.subplots_adjust(wspace=0.08)
    for ax, order in zip(axes, FILTER_ORDERS, strict=True):
        case = _case(comparison, BASELINE_SCHEME, order=order)
        time_panel(ax, "reference", comparison.window("reference_window"))
        time_curve(ax, case.sample_time, case.reference * DEGREES, REFERENCE_COLOUR, linewidth=1.1)
        set_title(
            ax, f"order {order}: {'one section' if order == 1 else 'two sections'} of 5 rad/s"
        )
        set_labels(ax, x="time, s")
    axes[0].set_ylim(*(1.08 * value for value in PRINTED["reference_range"].values))
    set_labels(axes[0], y="reference, deg/s")
    return figure


# -- Figures 4 and 5 -------------------------------------------------------------------------------


def _step1(comparison: PaperComparison) -> Any:
    return _estimates(comparison, STEP1, "step1", "α₂ in s⁻¹, b in rad/(s²·V)")


def _step2(comparison: PaperComparison) -> Any:
    return _estimates(comparison, STEP2, "step2", "σ in s⁻², c in rad⁻¹")


def _estimates(comparison: PaperComparison, colours: dict[str, str], step: str, unit: str) -> Any:
    """Draw estimates over time, a column for each scheme, on the axes of the paper; dashed are the
    levels that it prints.
    """
    figure = new_figure(11.0, 3.7)
    axes = figure.subplots(1, len(SCHEMES), sharey=True)
    figure.subplots_adjust(wspace=0.08)
    first, last = comparison.window(f"{step}_window")
    larger = TAKEN_LARGER[step]
    low, high = (larger * value for value in PRINTED[f"{step}_range"].values)
    for ax, scheme in zip(axes, SCHEMES, strict=True):
        case = _case(comparison, scheme)
        begin = case.begin if step == "step2" else 0.0
        time_panel(ax, step, (first, last))
        # estimates over the values that the paper prints
        for name, colour in colours.items():
            printed = larger * PRINTED[name].values[0]
            time_horizontal(ax, printed, colour, DASHED[1], linewidth=0.9)
            if name in case.hats:
                time_curve(ax, case.time - begin, case.hats[name], colour, PLAIN_SYMBOLS[name])
        set_title(ax, LETTERS[scheme])
        # a scheme that diverged says when
        if failed := case.result.get("diverged"):
            set_title(
                ax, f"diverged at {failed['time_s']:.3g} s", loc="right", fontsize=8, color=FAILED
            )
        set_labels(ax, x=f"time, s{', from the start of step 2' if begin else ''}")
    axes[0].set_ylim(low, high)
    set_labels(axes[0], y=unit)
    axes[0].legend(
        *_marks(axes),
        loc="upper right",
        ncols=len(colours),
        bbox_to_anchor=(1.0, 1.0),
        columnspacing=1.0,
        handletextpad=0.4,
    )
    return figure


def _marks(axes: Sequence[Any]) -> tuple[list[Any], list[str]]:
    """Return the lines of a legend for several axes."""
    for ax in axes:
        handles, labels = ax.get_legend_handles_labels()
        if handles:
            return handles, labels
    return [], []


# -- Figure 6 --------------------------------------------------------------------------------------


def _validation(comparison: PaperComparison) -> Any:
    """Draw measured and predicted velocity, a panel for each scheme and one for the linear model,
    and the errors below.
    """
    panels = [(scheme, "model", LETTERS[scheme], SCHEME_COLOURS[scheme]) for scheme in SCHEMES]
    panels.append((BASELINE_SCHEME, "linear", MODEL_LABELS["linear"], MODEL_COLOURS["linear"]))
    figure = new_figure(11.0, 7.4)
    grid = figure.add_gridspec(
        5, 2, height_ratios=[2.0, 0.9, 0.42, 2.0, 0.9], hspace=0.12, wspace=0.08
    )
    first, last = comparison.window("validation_window")
    for k, (scheme, model, title, colour) in enumerate(panels):
        row, column = 3 * (k // 2), k % 2
        top = figure.add_subplot(grid[row, column])
        low = figure.add_subplot(grid[row + 1, column])
        case = _case(comparison, scheme)
        for ax in (top, low):
            time_panel(ax, "second record", (first, last))
        # velocities and their error, with the score as eq. (25) in the title
        _overlay(top, low, case, model, colour)
        row_of = comparison.content["eq25"][0]
        score = row_of["linear" if model == "linear" else scheme]
        set_title(top, title)
        alone = (
            "α₂, b, Fc alone, "
            if model == "model" and case.model.remark and case.model.remark.kind == "step1"
            else ""
        )
        set_title(
            top,
            "no prediction" if score is None else f"{alone}eq. (25): {score:.2g} %",
            loc="right",
            fontsize=8.5,
        )
        # the axes of the paper, labelled at the left and at the bottom only
        top.set_ylim(*PRINTED["validation_range"].values)
        low.set_ylim(-120, 120)
        for ax in (top, low):
            ax.tick_params(labelleft=column == 0)
        top.tick_params(labelbottom=False)
        if column == 0:
            set_labels(top, y="velocity, deg/s")
            set_labels(low, y="error, deg/s")
        if k // 2 == 1:
            set_labels(low, x="time, s")
        if k == 0:
            top.legend(loc="lower left", ncols=2)
    return figure


def _overlay(top: Any, low: Any, case: SchemeCase, model: str, colour: str) -> None:
    time, measured = case.validation_time, case.measured * DEGREES
    time_curve(top, time, measured, MEASURED, "measured", linewidth=2.4)
    if model not in case.predictions:
        why = "no prediction" if case.model.remark is None else case.model.remark.text
        top.text(0.5, 0.85, why, transform=top.transAxes, ha="center", color=FAILED, fontsize=8)
        return
    predicted = case.predictions[model] * DEGREES
    time_curve(top, time, predicted, colour, "predicted", linewidth=1.1)
    time_curve(low, time, predicted - measured, colour, linewidth=0.9)
