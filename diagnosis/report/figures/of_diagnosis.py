"""The figures of a diagnosis as SVG text: the gap, where before and after differ, and what each
effect would gain.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.drawing import (
    ESTIMATE,
    GREY,
    INK,
    LIMIT,
    MEASURED,
    OTHER,
    PALE,
    STYLE,
    Drawing,
    new_figure,
    set_labels,
    set_title,
    svg,
)
from bristle.common.time_plot import time_curve, time_horizontal, time_panel, time_span
from bristle.diagnosis.answer import CandidateEffect, Diagnosis, RecordTrace, ResidualView, Round
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report.figures.axes import shown
from bristle.diagnosis.report.figures.whole_records import (
    horizon_figure,
    horizons_seen,
    open_loop_figure,
    whole_curves,
    worst,
)
from bristle.diagnosis.report.text.names import AXES, NATS, effect_name, view_name
from bristle.diagnosis.report.text.said import said
from bristle.plant.wording import Wording

Array = NDArray[np.float64]
BEFORE, AFTER = OTHER, ESTIMATE
OVERLAY_SECONDS = 4.0  # of the overlay
ERROR_SLICE = 0.2  # s over which the errors along the records are averaged
LABEL: Any = {"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 0.8}
DRAWN_MAPS = 3  # views that are drawn
DRAWN_BARS = 9  # candidates of a round that are drawn
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NOTE_LETTERS = 30  # letters of a note beside a bar
NAME_WIDTH = 0.31  # part of the width of a figure for the names beside bars
PER_ROW = 2  # rounds beside each other


def view_axis(model: Model, view: str, period: float | None = None) -> tuple[float, str]:
    """Return (factor, label) of the axis of a view, or of one period of it."""
    first, angle, drive = view.split(" ")[0], "m" if model.linear else "rad", model.input_unit
    name, kind = AXES.get("t" if first == "tone" else first, (view, "none"))
    units = {
        "angle": angle,
        "speed": f"{angle}/s",
        "acceleration": f"{angle}/s2",
        "input": drive,
        "input rate": f"{drive}/s",
        "time": "s",
        "frequency": "Hz",
        "none": "1",
    }
    factor, unit = shown(units[kind])
    if period is not None:
        turns = 0 if model.linear or kind != "angle" else round(2 * math.pi / period)
        part = (
            f"1/{turns} of a turn"
            if turns > 1
            else "a turn"
            if turns
            else f"one period of {factor * period:.3g} {unit}"
        )
        name = f"{name} within {part}"
    return factor, f"{name}, {unit.replace('.', '·')}" if unit else name


def draw(diagnosis: Diagnosis) -> dict[str, Drawing]:
    """Return the figures by name, each an <svg> element; a figure without data is left out."""
    from matplotlib import rc_context

    model, made = diagnosis.model, {}
    with rc_context(STYLE):
        for name, figure in (
            ("gap", _gap(diagnosis)),
            ("overlay", _overlay(diagnosis)),
            ("maps", _maps(diagnosis.where, model, improved(diagnosis))),
            ("unnamed", _unnamed(diagnosis)),
            ("candidates", _candidates(diagnosis)),
            ("open_loop", _open_loop(diagnosis)),
            ("horizons", _horizons(diagnosis)),
        ):
            if figure is not None:
                made[name] = svg(figure, name)
                made[name].seen = _SEEN[name](diagnosis)
    return made


def improved(diagnosis: Diagnosis) -> bool:
    """True if there is an "after" that differs from "before"."""
    return bool(diagnosis.found)


def as_given(diagnosis: Diagnosis) -> bool:
    """True if the model was not even fitted, for the data have to be corrected first."""
    return bool(diagnosis.proposals) and not diagnosis.rounds


# -- gap -------------------------------------------------------------------------------------------
def rms(square: float | None, output_unit: str) -> tuple[float, str]:
    """Return a mean square as (root, unit) on the scale of the figures; NaN where there is none."""
    factor, unit = shown(output_unit)
    return (math.nan if square is None or square < 0 else factor * math.sqrt(square)), unit


def drawn_floor(diagnosis: Diagnosis) -> float | None:
    """Return the noise floor [output squared], None where it is not known: what is unexplained is
    partly taken for noise.
    """
    return None if diagnosis.remains.flag else diagnosis.gap.noise_floor


def _gap(diagnosis: Diagnosis) -> Any:
    gap, output_unit = diagnosis.gap, diagnosis.model.output_unit
    first = (
        "before"
        if improved(diagnosis)
        else "model as given"
        if as_given(diagnosis)
        else "refitted model"
    )
    rows = [(first, gap.before, BEFORE)] + (
        [("after", gap.after, AFTER)] if improved(diagnosis) else []
    )
    values = [rms(square, output_unit)[0] for _, square, _ in rows]
    floor, unit = rms(drawn_floor(diagnosis), output_unit)
    if not all(map(math.isfinite, values)) or max(values) <= 0:
        return None
    figure = new_figure(11.0, 0.95 + 0.42 * len(rows))
    ax = figure.subplots()
    right = 1.4 * max([*values, floor if math.isfinite(floor) else 0.0])
    for row, ((name, square, colour), value) in enumerate(zip(rows, values, strict=True)):
        ax.barh(row, value, color=colour, height=0.62)
        # as the sentences have it
        both = f" ({math.sqrt(square):.3g} {output_unit})" if unit != output_unit else ""
        ax.text(
            value + 0.006 * right, row, f"{name}: {value:.3g} {unit}{both}", va="center", color=INK
        )
    if math.isfinite(floor):
        ax.axvspan(0, floor, color=LIMIT, alpha=0.16, linewidth=0, zorder=3)
        ax.axvline(floor, color=LIMIT, linewidth=1.2, linestyle=(0, (4, 3)), zorder=4)
        ax.text(
            floor, -0.52, f" noise floor {floor:.3g} {unit}", va="bottom", color=INK, fontsize=8.5
        )
    ax.set_xlim(0, right)
    ax.set_ylim(len(rows) - 0.55, -0.95)
    ax.set_yticks([])
    ax.grid(axis="y", visible=False)
    ax.spines["left"].set_visible(False)
    set_labels(
        ax, x=f"rms error over {'all' if as_given(diagnosis) else 'held-out'} segments, {unit}"
    )
    figure.subplots_adjust(left=0.25 / figure.get_size_inches()[0])
    return figure


# -- before and after ------------------------------------------------------------------------------
def _mean_square(error: Array, count: int) -> Array:
    """Return the mean square over `count` samples around each sample; NaN, where nothing was
    simulated, does not count.
    """
    good = np.isfinite(error)
    window = np.ones(min(count, len(error)))
    weight = np.convolve(good, window, "same")
    total = np.convolve(np.where(good, np.square(error), 0.0), window, "same")
    return np.where(weight > 0.25 * len(window), total / np.maximum(weight, 1.0), np.nan)


def worst_part(
    traces: Sequence[RecordTrace], seconds: float = OVERLAY_SECONDS
) -> tuple[RecordTrace, slice] | None:
    """Return the record and the part of it in which the error was largest before."""
    best: tuple[float, RecordTrace, slice] | None = None
    for trace in traces:
        if len(trace.time) < 2:
            continue
        count = min(max(2, round(seconds / float(np.median(np.diff(trace.time))))), len(trace.time))
        mean_square = _mean_square(trace.before - trace.measured, count)
        inside = mean_square[count // 2 : max(len(mean_square) - count // 2, count // 2 + 1)]
        if not np.isfinite(inside).any():
            continue
        first = int(np.nanargmax(inside))
        if best is None or inside[first] > best[0]:
            best = float(inside[first]), trace, slice(first, min(first + count, len(trace.time)))
    return None if best is None else best[1:]


def _overlay(diagnosis: Diagnosis) -> Any:
    worst_stretch = worst_part(diagnosis.traces)
    if worst_stretch is None:
        return None
    trace, part = worst_stretch
    model, both = diagnosis.model, improved(diagnosis)
    # the whole record above, its worst part with the errors below
    figure = new_figure(11.0, 6.1)
    grid = figure.add_gridspec(3, 1, height_ratios=[0.7, 1.7, 1.0], hspace=0.5)
    along, top, low = (figure.add_subplot(grid[row]) for row in range(3))
    _along(along, trace, part, model, both)
    factor, unit = shown(model.output_unit)
    time, measured = trace.time, factor * trace.measured
    curves = [("before", trace.before, BEFORE, "-"), ("after", trace.after, AFTER, (0, (3, 2)))][
        : 2 if both else 1
    ]
    for ax in (top, low):
        time_panel(ax, trace.name, (float(time[part][0]), float(time[part][-1])))
        _shade(ax, time, trace.held_out)
    # measured and simulated, and the error below them
    time_curve(top, time, measured, MEASURED, "measured", linewidth=2.6)
    for name, values, colour, style in curves:
        label = f"simulated, {name}" if both else "simulated, refitted model"
        time_curve(top, time, factor * values, colour, label, linestyle=style, linewidth=1.3)
        time_curve(low, time, factor * values - measured, colour, label, linewidth=1.0)
    time_horizontal(low, 0.0, INK, linewidth=0.7)
    top.legend(loc="upper right", ncols=3, bbox_to_anchor=(1.0, 1.19))
    set_title(top, f"{trace.name}, where the error is largest")
    set_labels(top, y=f"{model.output_kind}, {unit}")
    set_labels(low, x="time, s", y=f"error, {unit}")
    return figure


def _along(ax: Any, trace: RecordTrace, part: slice, model: Model, both: bool) -> None:
    """Draw the errors along the whole record, and which part is shown below."""
    factor, unit = shown(model.output_unit)
    count = max(2, round(ERROR_SLICE / float(np.median(np.diff(trace.time)))))
    time_panel(ax, trace.name)
    for values, colour in ((trace.before, BEFORE), (trace.after, AFTER))[: 2 if both else 1]:
        error = factor * np.sqrt(_mean_square(values - trace.measured, count))
        time_curve(ax, trace.time, error, colour, linewidth=1.0)
    time_span(ax, float(trace.time[part][0]), float(trace.time[part][-1]), GREY, 0.22)
    ax.set_xlim(trace.time[0], trace.time[-1])
    ax.set_ylim(bottom=0)
    set_title(
        ax,
        f"{trace.name}, rms error over {ERROR_SLICE:g} s along the record; grey: the part shown"
        " below",
    )
    set_labels(ax, y=f"rms, {unit}")


def _shade(ax: Any, time: Array, held_out: NDArray[np.bool_]) -> None:
    """Shade the held-out segments."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held_out, [False]]).astype(int)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        time_span(ax, float(time[first]), float(time[min(last, len(time) - 1)]), LIMIT, 0.07)


# -- residual maps ---------------------------------------------------------------------------------
def drawn_views(views: Sequence[ResidualView]) -> list[ResidualView]:
    """Return the views that are drawn."""
    return [view for view in views if view.centres.size > 1 and view.before.size][:DRAWN_MAPS]


def _maps(views: Sequence[ResidualView], model: Model, both: bool) -> Any:
    drawn = drawn_views(views)
    if not drawn:
        return None
    figure = new_figure(11.0, 3.5)
    axes = figure.subplots(1, len(drawn), squeeze=False)[0]
    figure.subplots_adjust(wspace=0.26)
    _, torque = shown("N" if model.linear else "N.m")
    power = _thousands([each for view in drawn for each in (view.before, view.after)])
    for ax, view in zip(axes, drawn, strict=True):
        _map(ax, view, model, both, 10.0**-power)
    scale = f"10{str(power).translate(RAISED)} " if power else ""
    set_labels(axes[0], y=f"residual {model.wording.torque}, {scale}{torque}")
    return figure


def _thousands(values: Sequence[Array]) -> int:
    """Return a power of ten that keeps the numbers beside an axis short: a power of a thousand, or
    0 where they are anyhow.
    """
    most = max(
        (float(np.nanmax(np.abs(each))) for each in values if np.isfinite(each).any()), default=0.0
    )
    return 0 if most == 0 or 0.01 <= most < 1e4 else 3 * math.floor(math.log10(most) / 3)


def _map(ax: Any, view: ResidualView, model: Model, both: bool, scale: float) -> None:
    factor, label = view_axis(model, view.view, view.period)
    x = factor * view.centres
    # a line for each row of the map, before and after
    for row, before in enumerate(np.atleast_2d(view.before)):
        style: Any = ("-", (0, (4, 2)))[row % 2]
        name = f" {view.lines[row]}" if row < len(view.lines) else ""
        ax.plot(
            x,
            scale * before,
            color=BEFORE,
            linestyle=style,
            label=f"{'before' if both else 'residual'}{name}",
        )
        if both and view.after.size:
            ax.plot(
                x,
                scale * np.atleast_2d(view.after)[row],
                color=AFTER,
                linestyle=style,
                label=f"after{name}",
            )
    ax.axhline(0, color=INK, linewidth=0.7)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.28 * (high - low))  # room for the legend
    ax.legend(
        loc="upper left",
        ncols=2,
        fontsize=8,
        handlelength=1.8,
        columnspacing=1.0,
        borderaxespad=0.2,
    )
    share = f"{100 * view.share:.0f} %" + (f" → {100 * view.share_after:.0f} %" if both else "")
    set_title(ax, f"{view_name(view.view, view.label)}\n{share} of the residual")
    set_labels(ax, x=label)


# -- unnamed torque --------------------------------------------------------------------------------
def _unnamed(diagnosis: Diagnosis) -> Any:
    """Draw the unexplained residual as functions of one variable each, with their bands."""
    if diagnosis.unnamed is None or not diagnosis.unnamed.curves:
        return None
    model, curves = diagnosis.model, diagnosis.unnamed.curves
    figure = new_figure(11.0, 3.5)
    axes = figure.subplots(1, len(curves), squeeze=False)[0]
    figure.subplots_adjust(wspace=0.26)
    _, torque = shown("N" if model.linear else "N.m")
    power = _thousands([c.values for c in curves])
    for ax, curve in zip(axes, curves, strict=True):
        factor, label = view_axis(model, curve.variable)
        x, scale = factor * curve.places, 10.0**-power
        ax.fill_between(
            x,
            scale * (curve.values - curve.half_width),
            scale * (curve.values + curve.half_width),
            color=AFTER,
            alpha=0.18,
            linewidth=0,
        )
        ax.plot(x, scale * curve.values, color=AFTER, linewidth=1.6)
        ax.axhline(0, color=INK, linewidth=0.7)
        ax.set_xlim(x[0], x[-1])
        set_labels(ax, x=label)
    raised = f"10{str(power).translate(RAISED)} " if power else ""
    set_labels(axes[0], y=f"unnamed {model.wording.torque}, {raised}{torque}")
    return figure


# -- candidates ------------------------------------------------------------------------------------
def _candidates(diagnosis: Diagnosis) -> Any:
    rounds = [r for r in diagnosis.rounds if r.candidates]
    if not rounds:
        return None
    wording, columns = diagnosis.model.wording, min(PER_ROW, len(rounds))
    rows = -(-len(rounds) // columns)
    bars = max(min(DRAWN_BARS, len(r.candidates)) for r in rounds)
    figure = new_figure(11.0, rows * (0.26 * bars + 0.95))
    axes = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    figure.subplots_adjust(
        left=NAME_WIDTH, wspace=NAME_WIDTH * columns / (1.0 - columns * NAME_WIDTH), hspace=0.5
    )
    for number, (ax, each) in enumerate(zip(axes, rounds, strict=False), start=1):
        _bars(ax, each, _tied(diagnosis, each, number == len(rounds)), wording)
        more = len(each.candidates) - DRAWN_BARS
        added = f"{effect_name(each.added, wording)} added" if each.added else "nothing added"
        title = f"round {number}: {added}" + (f"; {more} more gain less" if more > 0 else "")
        set_title(ax, title, x=-0.97 * NAME_WIDTH / ax.get_position().width)
    for ax in axes[len(rounds) :]:
        ax.set_visible(False)
    return figure


def _tied(diagnosis: Diagnosis, each: Round, last: bool) -> set[str]:
    """Return what tied in a round: with what was added or, in the last one, with nothing added."""
    added = {effect.name for effect in diagnosis.found}
    open_ = last and each.added is None
    return {
        name
        for tie in diagnosis.ties
        for name in tie
        if each.added in tie or (open_ and not added & set(tie))
    }


def _bars(ax: Any, each: Round, tied: set[str], wording: Wording) -> None:
    ranked = sorted(each.candidates, key=lambda c: -c.gain if math.isfinite(c.gain) else math.inf)
    drawn = ranked[:DRAWN_BARS]
    best = max((c.gain for c in drawn if math.isfinite(c.gain)), default=0.0)
    right = 1.35 * max(best, each.null_level, 1e-9)
    text: Any = {"va": "center", "fontsize": 8, "color": INK, "clip_on": True, "bbox": LABEL}
    dashed: Any = {"color": LIMIT, "linewidth": 1.0, "linestyle": (0, (4, 3))}
    for row, candidate in enumerate(drawn):
        # what chance reaches, up to a dashed line
        level, name = candidate.level, candidate.name
        ax.barh(row, level, color=LIMIT, alpha=0.16, height=0.98, linewidth=0)
        ax.plot([level] * 2, [row - 0.49, row + 0.49], **dashed)
        # the gain, with its number beside it
        gain = max(candidate.gain, 0.0) if math.isfinite(candidate.gain) else 0.0
        colour = AFTER if name == each.added else BEFORE if name in tied else PALE
        ax.barh(row, gain, color=colour, height=0.62)
        ax.text(gain + 0.012 * right, row, _beside_bar(candidate), **text)
    ax.set_xlim(0, right)
    ax.set_ylim(len(drawn) - 0.5, -0.6)
    ax.set_yticks(
        range(len(drawn)), [effect_name(candidate.name, wording) for candidate in drawn], fontsize=8
    )
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="y", visible=False)
    ax.spines["left"].set_visible(False)
    set_labels(ax, x="gain, nats")


def _beside_bar(candidate: CandidateEffect) -> str:
    """Return the gain of a candidate in figures, or why it was not tried, in short."""
    gained = "not tried"
    if math.isfinite(candidate.gain):
        gained = format(candidate.gain, ".0f" if candidate.gain >= 100 else ".3g")
    if not candidate.reason:
        return gained
    return f"{gained}  ({textwrap.shorten(said(candidate.reason), NOTE_LETTERS, placeholder=' …')})"


# -- whole records ---------------------------------------------------------------------------------
def _open_loop(diagnosis: Diagnosis) -> Any:
    if diagnosis.whole is None:
        return None
    whole = diagnosis.whole
    return open_loop_figure(
        whole.traces[worst(whole)],
        whole_curves(whole, improved(diagnosis)),
        (diagnosis.model.output_kind, whole.records[0].unit),
    )


def _horizons(diagnosis: Diagnosis) -> Any:
    if diagnosis.whole is None:
        return None
    return horizon_figure(
        whole_curves(diagnosis.whole, improved(diagnosis)), diagnosis.whole.records[0].unit
    )


# -- in words --------------------------------------------------------------------------------------
def _gap_seen(diagnosis: Diagnosis) -> str:
    output_unit = diagnosis.model.output_unit
    rows: list[tuple[str, float | None]] = [
        ("rms error" + (" before" if improved(diagnosis) else ""), diagnosis.gap.before)
    ]
    rows += [("after", diagnosis.gap.after)] if improved(diagnosis) else []
    rows += [("noise floor", drawn_floor(diagnosis))]
    measured = [(name, *rms(square, output_unit)) for name, square in rows]
    return ", ".join(
        f"{name} {value:.3g} {unit}" for name, value, unit in measured if math.isfinite(value)
    )


def _overlay_seen(diagnosis: Diagnosis) -> str:
    worst_stretch = worst_part(diagnosis.traces)
    assert worst_stretch is not None
    trace, part = worst_stretch
    ends = f"{trace.name} from {trace.time[part][0]:.4g} to {trace.time[part][-1]:.4g} s: "
    words = []
    for name, values in (("before", trace.before), ("after", trace.after))[
        : 2 if improved(diagnosis) else 1
    ]:
        value, unit = rms(
            float(np.nanmean((values - trace.measured)[part] ** 2)), diagnosis.model.output_unit
        )
        words.append(
            f"rms error {name} {value:.3g} {unit}"
            if improved(diagnosis)
            else f"rms error {value:.3g} {unit}"
        )
    return ends + ", ".join(words)


def _maps_seen(diagnosis: Diagnosis) -> str:
    words = []
    for view in drawn_views(diagnosis.where):
        after = f" before and {100 * view.share_after:.0f} % after" if improved(diagnosis) else ""
        words.append(
            f"{view_name(view.view, view.label)} predicts {100 * view.share:.0f} % of the"
            f" residual{after}"
        )
    return "; ".join(words)


def _unnamed_seen(diagnosis: Diagnosis) -> str:
    assert diagnosis.unnamed is not None
    _, torque = shown("N" if diagnosis.model.linear else "N.m")
    words = []
    for curve in diagnosis.unnamed.curves:
        low, high = float(np.min(curve.values)), float(np.max(curve.values))
        words.append(
            f"from {low:.3g} to {high:.3g} {torque} over the"
            f" {view_axis(diagnosis.model, curve.variable)[1]}"
        )
    return f"unnamed {diagnosis.model.wording.torque} " + "; ".join(words)


def _candidates_seen(diagnosis: Diagnosis) -> str:
    words = []
    for place, each in enumerate(diagnosis.rounds, start=1):
        tried = [c for c in each.candidates if math.isfinite(c.gain)]
        if tried:
            best = max(tried, key=lambda c: c.gain)
            name = effect_name(best.name, diagnosis.model.wording)
            words.append(
                f"round {place}: {name} gains most, {best.gain:.3g} nats; chance gives up to"
                f" {best.level:.3g}"
            )
    return "; ".join(words)


def _open_loop_seen(diagnosis: Diagnosis) -> str:
    assert diagnosis.whole is not None
    record = diagnosis.whole.records[worst(diagnosis.whole)]
    rows = [("before", record.rms_before, record.fit_before)] if improved(diagnosis) else []
    rows.append(("after" if improved(diagnosis) else "", record.rms_after, record.fit_after))
    factor, unit = shown(record.unit)
    known = [row for row in rows if math.isfinite(row[1])]
    words = [
        f"rms error {factor * each:.3g} {unit}, FIT {fit:.4g} % {name}".strip()
        for name, each, fit in known
    ]
    return f"{record.record} in open loop: " + (", ".join(words) or "the simulation fails")


def _horizons_seen(diagnosis: Diagnosis) -> str:
    assert diagnosis.whole is not None
    return horizons_seen(
        whole_curves(diagnosis.whole, improved(diagnosis)), diagnosis.whole.records[0].unit
    )


_SEEN: dict[str, Callable[[Diagnosis], str]] = {
    "gap": _gap_seen,
    "overlay": _overlay_seen,
    "maps": _maps_seen,
    "unnamed": _unnamed_seen,
    "candidates": _candidates_seen,
    "open_loop": _open_loop_seen,
    "horizons": _horizons_seen,
}


def _later_captions(torque: str, refitted: str) -> dict[str, tuple[str, str]]:
    """Return title and caption of the figures of an unnamed torque, of candidates and of whole
    records; `refitted`: what is said of a refit to these.
    """
    return {
        "unnamed": (
            f"Unnamed {torque}",
            (
                f"What is left unexplained, as a {torque} that is a smooth function of one variable"
                " (or a sum of two), with its 95 % band. Fitted to the segments that are not held"
                " out; it says nothing about a cause, and holds only in the range drawn."
            ),
        ),
        "candidates": (
            "Gain of each candidate effect",
            (
                "Rise of the log-likelihood when the effect is added and all parameters are"
                f" refitted, in nats ({NATS}). Shaded up to the dashed line: gains that chance may"
                " give where no effect is missing. Blue: added; orange: tied; pale: neither."
            ),
        ),
        "open_loop": (
            "Whole records in open loop",
            (
                "The record that the model follows worst, simulated from its start to its end with"
                f" nothing but the input{refitted}. Only the position and the velocity at the start"
                " are fitted. FIT: 100 % less the rms error in per cent of the rms deviation of"
                " the output from its mean."
            ),
        ),
        "horizons": (
            "Error against horizon",
            (
                "The rms error over all records, simulated anew, with a fitted start, after so many"
                " seconds; the last point is that of whole records."
            ),
        ),
    }


def captions(diagnosis: Diagnosis) -> dict[str, tuple[str, str]]:
    """Return title and caption of each figure."""
    both, torque = improved(diagnosis), diagnosis.model.wording.torque
    floor = " Green band: the noise floor, what disturbance and sensor noise alone account for."
    band = floor if drawn_floor(diagnosis) is not None else ""
    before = (
        " Before: the model refitted without the effect."
        if both
        else " The model is refitted, without any effect."
    )
    colours = ", before (orange) and after (blue)" if both else ""
    segments = "held-out segments, which took no part in the search"
    if as_given(diagnosis):
        segments = (
            "all segments, of the model as it was given: nothing was fitted and no effect was tried"
        )
    usual = refitted = ""
    if diagnosis.whole is not None and diagnosis.whole.refitted:
        usual = (
            " The parameters are those that the segments gave, before the refit to whole records."
        )
        refitted = f", parameters refitted to horizons of up to {diagnosis.whole.refitted_to:.3g} s"
    return {
        "gap": (
            "Error of the model",
            f"Root of the mean squared error of the output over {segments}.{band}{usual}",
        ),
        "overlay": (
            "Before and after" if both else "Measured and simulated",
            (
                f"Each segment starts from its own fitted position and velocity.{before} Shaded"
                f" green: held-out segments, used neither for the search nor for these fits.{usual}"
            ),
        ),
        "maps": (
            "Where the residual is",
            (
                f"Residual {torque} over the variable that predicts it: averaged in bins or, where"
                f" it is periodic, fitted over one period{colours}; solid: forward, dashed:"
                " backward, where there are two lines. The share is how much of the residual's"
                " power the variable predicts in segments left out of its fit; p: probability of"
                " as much by chance."
            ),
        ),
        **_later_captions(torque, refitted),
    }
