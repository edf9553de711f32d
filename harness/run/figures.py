"""The report's figures as SVG text; degrees on the axes, SI everywhere else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

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
    thin,
)
from bristle.common.signals import Array
from bristle.common.time_plot import time_band, time_curve, time_mark, time_panel
from bristle.harness.metrics.estimates import SETTLING_BAND, Course
from bristle.harness.run.figure_text import MODEL_LABELS, seen
from bristle.harness.run.pictures import Pictures

SCATTER_POINTS = 5000  # points of a scatter diagram
# s at the end of the run, share of the rms speed: friction loops near rest that are shown
LOOP_SECONDS, LOOP_SPEED = 5.0, 0.25
SPREAD = 2.0  # standard deviations to either side of an estimate that its band shows
# of the size of what is shown, by which an estimate may leave it before it is cut off
EXCURSION = 1.5
SHOWN_SECONDS = 10.0  # s at the end of the run: signals that are shown
# of the parameters, as plain characters: mathematical typesetting takes as long as a figure
PLAIN_SYMBOLS = {
    "alpha2": "α₂",
    "b": "b",
    "Fc": "Fc",
    "sigma0": "σ₀",
    "sigma1": "σ₁",
    "sigma2": "σ₂",
    "c": "c",
    "tau": "τ",
    "a0": "a₀",
    "a1": "a₁",
    "v0": "v₀",
}
# by the unit of the input
INPUT_LABELS = {"V": "voltage, V", "A": "current, A", "N.m": "torque, N·m", "N": "force, N"}
MODEL_COLOURS = {"model": ESTIMATE, "floor": LIMIT, "coulomb": OTHER, "linear": BASELINE}


def draw(pictures: Pictures) -> dict[str, Drawing]:
    """Return the figures by name, each an <svg> element."""
    from matplotlib import rc_context

    made = {}
    with rc_context(STYLE):
        for name, painter in (
            ("estimates", _estimates),
            ("signals", _signals),
            ("tracking", _tracking),
            ("friction", _friction),
            ("validation", _validation),
            ("models", _models),
        ):
            figure = painter(pictures)
            if figure is not None:
                made[name] = svg(figure, name)
                made[name].seen = seen(name, pictures)
    return made


def _unit(text: str) -> str:
    """Write a unit the way people do: 1/s2 -> s⁻², rad/s2 -> rad/s²."""
    return {"1/s": "s⁻¹", "1/s2": "s⁻²", "1/rad": "rad⁻¹", "1/m": "m⁻¹", "1": ""}.get(
        text, text.replace("s2", "s²").replace(".", "·")
    )


# -- estimates -------------------------------------------------------------------------------------


def _estimates(pictures: Pictures) -> Any:
    names = list(pictures.published)
    if not names:
        return None
    columns = (
        len(names) if len(names) <= 3 else 2 if len(names) == 4 else 3 if len(names) <= 6 else 4
    )
    rows = -(-len(names) // columns)
    figure = new_figure(11.0, 2.15 * rows + 0.35)
    axes = np.atleast_1d(figure.subplots(rows, columns, sharex=True, squeeze=False)).ravel()
    figure.subplots_adjust(wspace=0.34 if columns > 3 else 0.24, hspace=0.42)
    for ax, name in zip(axes, names, strict=False):
        _estimate(ax, pictures, name)
    for ax in axes[len(names) :]:
        ax.set_visible(False)
    for ax in axes[max(0, len(names) - columns) : len(names)]:
        set_labels(ax, x="time, s")
        ax.tick_params(labelbottom=True)
    return figure


def _estimate(ax: Any, pictures: Pictures, name: str) -> None:
    facts, course = pictures.estimates[name], pictures.published[name]
    time, unit = pictures.time, _unit(facts["unit"])
    set_title(ax, f"{PLAIN_SYMBOLS.get(name, name)}" + (f",  {unit}" if unit else ""))
    time_panel(ax)
    true = pictures.true.get(name)
    # the true value with the band in which an estimate counts as settled
    if true is not None:
        drawn = true if np.ptp(true) else true[[0, -1]]
        when = time if np.ptp(true) else time[[0, -1]]
        time_band(
            ax,
            when,
            drawn * (1 - SETTLING_BAND / 100),
            drawn * (1 + SETTLING_BAND / 100),
            LIMIT,
            0.16,
        )
        time_curve(ax, when, drawn, TRUTH, "true value", linestyle=(0, (4, 3)), linewidth=1.1)
    # the estimate
    _limits(ax, course, true)
    _course(ax, time, course)
    ax.set_xlim(0, time[-1] or 1.0)
    ax.yaxis.get_offset_text().set_x(-0.22)  # a factor of the ticks, which would cover the title
    # when it settled and how far it is off, in the title
    settled, error = facts.get("settling_s"), facts.get("error_percent")
    if settled and math.isfinite(settled):
        time_mark(ax, settled, LIMIT)
    if not facts["valid"]:
        set_title(ax, "not valid", loc="right", fontsize=8, color=FAILED)
    elif error is not None and math.isfinite(error):
        when_settled = (
            f"{settled:.3g} s" if settled is not None and math.isfinite(settled) else "not settled"
        )
        inside = abs(error) <= SETTLING_BAND
        set_title(
            ax,
            f"{error:+.2g} %, {when_settled}",
            loc="right",
            fontsize=8,
            color=LIMIT if inside else FAILED,
        )


def _course(ax: Any, time: Array, course: Course) -> None:
    """Draw an estimate with its band: in colour where valid, grey and dashed where it is not."""
    valid = course.valid.astype(bool)
    spread = None if course.sd is None or not course.sd.any() else SPREAD * course.sd
    for chosen, colour, style, label in (
        (~valid, GREY, (0, (2, 2)), "estimate, not valid"),
        (valid, ESTIMATE, "solid", "estimate"),
    ):
        if not chosen.any():
            continue
        shown = np.where(chosen, course.hat, np.nan)
        if spread is not None:
            time_band(ax, time, shown - spread, shown + spread, colour, 0.25)
        time_curve(ax, time, shown, colour, label, linestyle=style)


def _limits(ax: Any, course: Course, true: Array | None) -> None:
    """Show the truth, if it is known, and where the estimate goes that counts, but not the whole of
    a first excursion.
    """
    finite, valid = np.isfinite(course.hat), course.valid.astype(bool)
    counts = finite & (valid if valid[-1] else np.arange(len(finite)) >= len(finite) // 2)
    hat = course.hat[counts if true is None else finite]
    if not len(hat):
        return
    spread = (
        SPREAD * float(np.median(course.sd[counts]))
        if course.sd is not None and counts.any()
        else 0.0
    )
    low, high = np.percentile(hat, (1, 99)).tolist()
    if true is None:
        size = high - low + spread or abs(high) or 1.0
    else:
        size, least, most = (
            float(np.max(np.abs(true))) or spread or high - low or 1.0,
            float(true.min()),
            float(true.max()),
        )
        low, high = (
            max(min(low, least), least - EXCURSION * size),
            min(max(high, most), most + EXCURSION * size),
        )
        if valid[-1]:  # what counts is shown, however far off it is
            low, high = min(low, float(course.hat[-1])), max(high, float(course.hat[-1]))
    margin = max(0.08 * (high - low), 0.08 * size, min(spread, EXCURSION * size))
    ax.set_ylim(low - margin, high + margin)


# -- signals ---------------------------------------------------------------------------------------


def _part(time: Array) -> tuple[float, float] | None:
    """Return where the last seconds of a run begin and end, nothing of a run that has no more."""
    begin, end = float(time[0]), float(time[-1])
    return (end - SHOWN_SECONDS, end) if end - begin > SHOWN_SECONDS else None


def _signals(pictures: Pictures) -> Any:
    signals, time = pictures.signals, pictures.time
    if "v" not in signals or len(time) < 2:
        return None
    figure = new_figure(11.0, 4.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1])
    time_panel(top, part=_part(time))
    shown = (
        (MEASURED, "measured velocity", {"linewidth": 0.9})
        if pictures.measured
        else (TRUTH, "velocity", {"linewidth": 0.9})
    )
    curves = (
        ("reference", REFERENCE_COLOUR, "reference", {"linewidth": 0.9}),
        ("v_hat", ESTIMATE, "estimate of the velocity", {"linewidth": 2.4}),
        ("v", *shown),
    )
    for key, colour, label, style in curves:
        if key in signals and np.isfinite(signals[key]).any():
            time_curve(top, time, signals[key] * pictures.speed_scale, colour, label, **style)
    set_labels(top, y=pictures.speed_label)
    top.legend(loc="upper right", ncols=3, bbox_to_anchor=(1.0, 1.16))
    time_panel(bottom, part=_part(time))
    if "u" in signals:
        time_curve(bottom, time, signals["u"], INK, linewidth=1.0)
    set_labels(bottom, x="time, s", y=INPUT_LABELS[pictures.rig.input])
    return figure


# -- tracking --------------------------------------------------------------------------------------


def _tracking(pictures: Pictures) -> Any:
    tracking = pictures.tracking
    if tracking is None or len(tracking.time) < 2:
        return None
    figure = new_figure(11.0, 4.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1, 1.3])
    time = tracking.time
    for ax in (top, bottom):
        time_panel(ax, part=_part(time))
    time_curve(
        top, time, tracking.reference * DEGREES, REFERENCE_COLOUR, "reference", linewidth=0.9
    )
    for error, colour, label in (
        (tracking.alone, OTHER, "controller alone"),
        (tracking.compensated, ESTIMATE, "with compensation"),
    ):
        time_curve(top, time, (tracking.reference - error) * DEGREES, colour, linewidth=1.0)
        time_curve(bottom, time, error * DEGREES, colour, label, linewidth=1.0)
    bottom.legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.16))
    top.legend(loc="upper right", bbox_to_anchor=(1.0, 1.2))
    set_labels(top, y="velocity, deg/s")
    set_labels(bottom, x="time, s", y="tracking error, deg/s")
    return figure


# -- friction --------------------------------------------------------------------------------------


def _friction(pictures: Pictures) -> Any:
    if pictures.friction is None and pictures.friction_hat is None:
        return None
    figure = new_figure(11.0, 3.9)
    wide, near = figure.subplots(1, 2, width_ratios=[1.25, 1])
    slow = (
        LOOP_SPEED * pictures.speed_scale * float(np.sqrt(np.mean(pictures.signals["v"] ** 2)))
        or 1.0
    )
    # the observer below the plant; on the right the last loops near rest
    for cloud, colour, size, label in (
        (pictures.friction_hat, ESTIMATE, 4.5, "observer"),
        (pictures.friction, TRUTH, 1.6, "plant, F/J"),
    ):
        if cloud is None:
            continue
        v, force = cloud[0] * pictures.speed_scale, cloud[1]
        index = thin(len(v), SCATTER_POINTS)
        wide.plot(
            v[index],
            force[index],
            ".",
            color=colour,
            markersize=size,
            markeredgewidth=0,
            label=label,
            rasterized=True,
        )
        last = slice(-round(LOOP_SECONDS / pictures.step), None)
        width = 2.6 if colour == ESTIMATE else 0.9
        near.plot(
            v[last],
            np.where(np.abs(v[last]) < 1.5 * slow, force[last], np.nan),
            color=colour,
            linewidth=width,
        )
    # units of the rig, and the range near rest
    position = pictures.rig.position
    inertia = "mass" if position == "m" else "inertia"
    set_labels(wide, y=f"friction over {inertia}, {position}/s²")
    set_title(wide, "whole range")
    seconds = min(LOOP_SECONDS, pictures.step * len(pictures.signals["v"]))
    set_title(near, f"near rest, the last {seconds:.3g} s: presliding loops")
    near.set_xlim(-slow, slow)
    wide.legend(loc="upper left", markerscale=3)
    for ax in (wide, near):
        set_labels(ax, x=pictures.speed_label)
    return figure


# -- validation ------------------------------------------------------------------------------------


def _validation(pictures: Pictures) -> Any:
    validation = pictures.validation
    if validation is None:
        return None
    figure = new_figure(11.0, 4.2)
    top, low = figure.subplots(2, 1, sharex=True, height_ratios=[1.5, 1])
    time = validation.time
    for ax in (top, low):
        time_panel(ax, "second record", _part(time))
    for name in ("linear", "coulomb", "floor", "model"):
        if name in validation.predictions:
            error = (validation.predictions[name] - validation.measured) * DEGREES
            time_curve(low, time, error, MODEL_COLOURS[name], MODEL_LABELS[name], linewidth=1.0)
    if "model" in validation.predictions:
        model = validation.predictions["model"] * DEGREES
        time_curve(top, time, model, ESTIMATE, MODEL_LABELS["model"], linewidth=2.4)
    time_curve(top, time, validation.measured * DEGREES, TRUTH, "plant", linewidth=0.9)
    top.legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.16))
    set_labels(top, y="velocity, deg/s")
    set_labels(low, x="time, s (second record, open loop)", y="error, deg/s")
    return figure


def _models(pictures: Pictures) -> Any:
    if pictures.validation is None:
        return None
    figure = new_figure(11.0, 2.6)
    _bars(figure.subplots(), pictures.validation.scores)
    return figure


def _bars(ax: Any, scores: Mapping[str, float]) -> None:
    shown = [
        (name, scores[name])
        for name in ("model", "floor", "coulomb", "linear")
        if name in scores and math.isfinite(scores[name])
    ]
    set_title(ax, "MSE, % of variance (log scale)")
    ax.grid(axis="y", visible=False)
    if not shown:
        ax.text(
            0.5, 0.5, "no model could be scored", ha="center", transform=ax.transAxes, color=INK
        )
        ax.set_axis_off()
        return
    # bars on a log scale, which a perfect model may not leave to the left
    values = [max(value, 1e-14) for _, value in shown]
    left = 10 ** math.floor(math.log10(min(values)) - 0.5)
    right = max(values) * 1.5
    for row, ((name, value), bar) in enumerate(zip(shown, values, strict=True)):
        ax.barh(row, bar - left, left=left, color=MODEL_COLOURS[name], height=0.42)
        ax.text(
            left * 1.15,
            row - 0.34,
            f"{MODEL_LABELS[name]}: {value:.3g} %",
            va="center",
            fontsize=8.5,
            color=INK,
        )
    ax.set_xscale("log")
    ax.set_xlim(left, right)
    ax.set_ylim(len(shown) - 0.5, -0.7)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
