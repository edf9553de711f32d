"""The report's figures as SVG text; degrees on the axes, SI everywhere else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.drawing import (
    BLUE,
    DEGREES,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    RED,
    STYLE,
    new_figure,
    set_labels,
    set_title,
    svg,
    thin,
)
from bristle.harness.metrics import SETTLING_BAND, Course
from bristle.harness.rig import Rig
from bristle.harness.tracking import Tracking
from bristle.harness.validation import Validation

Array = NDArray[np.float64]

SCATTER_POINTS = 5000  # points of a scatter diagram
LOOP_SECONDS, LOOP_SPEED = 5.0, 0.25  # s at the end of the run, share of the rms speed: friction loops near rest that are shown
SPREAD = 2.0  # standard deviations to either side of an estimate that its band shows
EXCURSION = 1.5  # of the size of what is shown, by which an estimate may leave it before it is cut off
SHOWN_SECONDS = 10.0  # s at the end of the run: signals that are shown
PLAIN_SYMBOLS = {  # of the parameters, as plain characters: mathematical typesetting takes as long as a figure
    "alpha2": "α₂", "b": "b", "Fc": "Fc", "sigma0": "σ₀", "sigma1": "σ₁", "sigma2": "σ₂", "c": "c", "tau": "τ",
    "a0": "a₀", "a1": "a₁", "v0": "v₀",
}  # fmt: skip
MODEL_LABELS = {  # of the models that are compared
    "model": "observer's model",
    "floor": "best-fit floor: fitted 7-parameter model",
    "coulomb": "fitted viscous + Coulomb",
    "linear": "fitted viscous",
}
INPUT_LABELS = {"V": "voltage, V", "A": "current, A", "N.m": "torque, N·m", "N": "force, N"}  # by the unit of the input
SPEED_SCALES = {"rad": (DEGREES, "deg/s"), "m": (1.0, "m/s")}  # by the unit of the position: factor and unit on the axes
MODEL_COLOURS = {"model": BLUE, "floor": GREEN, "coulomb": ORANGE, "linear": GREY}


@dataclass
class Pictures:
    """The data of the figures, in SI units; `measured`: they are those of a record, which nobody knows the truth of."""

    time: Array
    estimates: Mapping[str, Mapping[str, Any]]
    published: Mapping[str, Course]
    true: Mapping[str, Array]
    rig: Rig = field(default_factory=Rig)
    measured: bool = False
    signals: Mapping[str, Array] = field(default_factory=dict)
    friction: tuple[Array, Array] | None = None  # v, F/J of the plant
    friction_hat: tuple[Array, Array] | None = None
    validation: Validation | None = None
    tracking: Tracking | None = None

    @property
    def step(self) -> float:
        """Time between two rows."""
        return float(self.time[1] - self.time[0]) if len(self.time) > 1 else 1.0

    @property
    def speed_scale(self) -> float:
        """Factor of a speed on the axes."""
        return SPEED_SCALES[self.rig.position][0]

    @property
    def speed_label(self) -> str:
        """Name and unit of a speed on the axes."""
        return f"velocity, {SPEED_SCALES[self.rig.position][1]}"


def draw(pictures: Pictures) -> dict[str, str]:
    """Return the figures by name, each an <svg> element."""
    from matplotlib import rc_context

    made = {}
    with rc_context(STYLE):
        for name, painter in (
            ("estimates", _estimates), ("signals", _signals), ("tracking", _tracking), ("friction", _friction),
            ("validation", _validation),
        ):  # fmt: skip
            figure = painter(pictures)
            if figure is not None:
                made[name] = svg(figure, name)
    return made


def _unit(text: str) -> str:
    """Write a unit the way people do: 1/s2 -> s⁻², rad/s2 -> rad/s²."""
    return {"1/s": "s⁻¹", "1/s2": "s⁻²", "1/rad": "rad⁻¹", "1/m": "m⁻¹", "1": ""}.get(
        text, text.replace("s2", "s²").replace(".", "·")
    )


# -- estimates -------------------------------------------------------------------------------------------------------


def _estimates(pictures: Pictures) -> Any:
    names = list(pictures.published)
    if not names:
        return None
    columns = len(names) if len(names) <= 3 else 2 if len(names) == 4 else 3 if len(names) <= 6 else 4
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
    hat = course.hat
    index = thin(len(hat))
    time = pictures.time[index]
    unit = _unit(facts["unit"])
    set_title(ax, f"{PLAIN_SYMBOLS.get(name, name)}" + (f",  {unit}" if unit else ""))
    true = pictures.true.get(name)
    if true is not None:
        level = true[index]
        ax.fill_between(
            time, level * (1 - SETTLING_BAND / 100), level * (1 + SETTLING_BAND / 100), color=GREY, alpha=0.22, linewidth=0
        )
        ax.plot(time, level, color=INK, linestyle=(0, (4, 3)), linewidth=1.1)
    _limits(ax, course, true)
    _course(ax, time, course, index)
    ax.set_xlim(0, pictures.time[-1] or 1.0)
    ax.yaxis.get_offset_text().set_x(-0.22)  # a factor of the ticks, which would cover the title
    settled, error = facts.get("settling_s"), facts.get("error_percent")
    if settled and math.isfinite(settled):
        ax.axvline(settled, color=GREEN, linewidth=1.0, linestyle=":")
    if not facts["valid"]:
        set_title(ax, "not valid", loc="right", fontsize=8, color=RED)
    elif error is not None and math.isfinite(error):
        when = f"{settled:.3g} s" if settled is not None and math.isfinite(settled) else "not settled"
        set_title(ax, f"{error:+.2g} %, {when}", loc="right", fontsize=8, color=GREEN if abs(error) <= SETTLING_BAND else RED)


def _course(ax: Any, time: Array, course: Course, index: NDArray[np.intp]) -> None:
    """Draw an estimate with its band: in colour where it is valid, grey and dashed where it is not."""
    valid, hat = course.valid[index].astype(bool), course.hat[index]
    spread = np.zeros(len(index)) if course.sd is None else SPREAD * course.sd[index]
    for chosen, colour, style in ((~valid, GREY, (0, (2, 2))), (valid, BLUE, "solid")):
        shown = np.where(chosen, hat, np.nan)
        if spread.any():
            ax.fill_between(time, shown - spread, shown + spread, color=colour, alpha=0.25, linewidth=0)
        ax.plot(time, shown, color=colour, linestyle=style)


def _limits(ax: Any, course: Course, true: Array | None) -> None:
    """Show the truth, if it is known, and where the estimate goes that counts, but not the whole of a first excursion."""
    finite, valid = np.isfinite(course.hat), course.valid.astype(bool)
    counts = finite & (valid if valid[-1] else np.arange(len(finite)) >= len(finite) // 2)
    hat = course.hat[counts if true is None else finite]
    if not len(hat):
        return
    spread = SPREAD * float(np.median(course.sd[counts])) if course.sd is not None and counts.any() else 0.0
    low, high = np.percentile(hat, (1, 99)).tolist()
    if true is None:
        size = high - low + spread or abs(high) or 1.0
    else:
        size, least, most = float(np.max(np.abs(true))) or spread or high - low or 1.0, float(true.min()), float(true.max())
        low, high = max(min(low, least), least - EXCURSION * size), min(max(high, most), most + EXCURSION * size)
        if valid[-1]:  # what counts is shown, however far off it is
            low, high = min(low, float(course.hat[-1])), max(high, float(course.hat[-1]))
    margin = max(0.08 * (high - low), 0.08 * size, min(spread, EXCURSION * size))
    ax.set_ylim(low - margin, high + margin)


# -- signals ---------------------------------------------------------------------------------------------------------


def _window(time: Array) -> slice:
    """Return the last seconds of a run."""
    first = int(np.searchsorted(time, time[-1] - SHOWN_SECONDS))
    return slice(first, len(time))


def _signals(pictures: Pictures) -> Any:
    signals, part = pictures.signals, _window(pictures.time)
    if "v" not in signals or len(pictures.time[part]) < 2:
        return None
    figure = new_figure(11.0, 4.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1])
    index = np.arange(len(pictures.time))[part]
    index = index[thin(len(index), 2000)]
    time = pictures.time[index]
    measured = "measured velocity" if pictures.measured else "velocity"
    curves = (("reference", PALE, "reference"), ("v", BLUE, measured), ("v_hat", ORANGE, "observer's estimate"))
    for key, colour, label in curves:
        if key in signals and np.isfinite(signals[key][index]).any():
            style: dict[str, Any] = {"linestyle": (0, (3, 2)), "linewidth": 1.2} if key == "v_hat" else {}
            style |= {"linewidth": 0.9} if key == "reference" else {}
            top.plot(time, signals[key][index] * pictures.speed_scale, color=colour, label=label, **style)
    set_labels(top, y=pictures.speed_label)
    top.legend(loc="upper right", ncols=3, bbox_to_anchor=(1.0, 1.16))
    if "u" in signals:
        bottom.plot(time, signals["u"][index], color=INK, linewidth=1.0)
    set_labels(bottom, x="time, s", y=INPUT_LABELS[pictures.rig.input])
    bottom.set_xlim(time[0], time[-1])
    return figure


# -- tracking --------------------------------------------------------------------------------------------------------


def _tracking(pictures: Pictures) -> Any:
    found = pictures.tracking
    if found is None or len(found.time) < 2:
        return None
    figure = new_figure(11.0, 4.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1, 1.3])
    index = np.arange(len(found.time))[_window(found.time)]
    index = index[thin(len(index), 2000)]
    time = found.time[index]
    top.plot(time, found.reference[index] * DEGREES, color=INK, linewidth=0.9, label="reference")
    for error, colour, label in ((found.alone, ORANGE, "controller alone"), (found.compensated, BLUE, "with compensation")):
        top.plot(time, (found.reference - error)[index] * DEGREES, color=colour, linewidth=1.0)
        bottom.plot(time, error[index] * DEGREES, color=colour, linewidth=1.0, label=label)
    bottom.legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.16))
    top.legend(loc="upper right", bbox_to_anchor=(1.0, 1.2))
    set_labels(top, y="velocity, deg/s")
    set_labels(bottom, x="time, s", y="tracking error, deg/s")
    bottom.set_xlim(time[0], time[-1])
    return figure


# -- friction --------------------------------------------------------------------------------------------------------


def _friction(pictures: Pictures) -> Any:
    if pictures.friction is None and pictures.friction_hat is None:
        return None
    figure = new_figure(11.0, 3.9)
    wide, near = figure.subplots(1, 2, width_ratios=[1.25, 1])
    slow = LOOP_SPEED * pictures.speed_scale * float(np.sqrt(np.mean(pictures.signals["v"] ** 2))) or 1.0
    for cloud, colour, size, label in (
        (pictures.friction, PALE, 4.5, "plant, F/J"),
        (pictures.friction_hat, BLUE, 1.6, "observer"),
    ):
        if cloud is None:
            continue
        v, force = cloud[0] * pictures.speed_scale, cloud[1]
        index = thin(len(v), SCATTER_POINTS)
        wide.plot(v[index], force[index], ".", color=colour, markersize=size, markeredgewidth=0, label=label, rasterized=True)
        last = slice(-round(LOOP_SECONDS / pictures.step), None)
        line = {"linewidth": 2.6, "color": PALE} if colour == PALE else {"linewidth": 0.9, "color": BLUE}
        near.plot(v[last], np.where(np.abs(v[last]) < 1.5 * slow, force[last], np.nan), **line)
    set_labels(wide, y=f"friction over {'mass' if pictures.rig.position == 'm' else 'inertia'}, {pictures.rig.position}/s²")
    set_title(wide, "whole range")
    set_title(near, f"near rest, the last {LOOP_SECONDS:g} s: presliding loops")
    near.set_xlim(-slow, slow)
    wide.legend(loc="upper left", markerscale=3)
    for ax in (wide, near):
        set_labels(ax, x=pictures.speed_label)
    return figure


# -- validation ------------------------------------------------------------------------------------------------------


def _validation(pictures: Pictures) -> Any:
    found = pictures.validation
    if found is None:
        return None
    figure = new_figure(11.0, 4.6)
    grid = figure.add_gridspec(2, 2, width_ratios=[2.1, 1], height_ratios=[1.5, 1])
    top = figure.add_subplot(grid[0, 0])
    low = figure.add_subplot(grid[1, 0], sharex=top)
    bars = figure.add_subplot(grid[:, 1])
    index = np.arange(len(found.time))[_window(found.time)]
    index = index[thin(len(index), 1500)]
    time = found.time[index]
    top.plot(time, found.measured[index] * DEGREES, color=INK, linewidth=2.2, alpha=0.35, label="plant")
    for name in ("linear", "coulomb", "floor", "model"):
        if name in found.predictions:
            error = (found.predictions[name] - found.measured)[index] * DEGREES
            low.plot(time, error, color=MODEL_COLOURS[name], linewidth=1.0)
    if "model" in found.predictions:
        top.plot(time, found.predictions["model"][index] * DEGREES, color=BLUE, linestyle=(0, (3, 2)), label=MODEL_LABELS["model"])
    top.legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.16))
    set_labels(top, y="velocity, deg/s")
    top.tick_params(labelbottom=False)
    set_labels(low, x="time, s (second record, open loop)", y="error, deg/s")
    low.set_xlim(time[0], time[-1])
    _bars(bars, found.scores)
    return figure


def _bars(ax: Any, scores: Mapping[str, float]) -> None:
    shown = [
        (name, scores[name]) for name in ("model", "floor", "coulomb", "linear") if name in scores and math.isfinite(scores[name])
    ]
    set_title(ax, "MSE, % of variance (log scale)")
    ax.grid(axis="y", visible=False)
    if not shown:
        ax.text(0.5, 0.5, "no model could be scored", ha="center", transform=ax.transAxes, color=GREY)
        ax.set_axis_off()
        return
    values = [max(value, 1e-14) for _, value in shown]
    left = 10 ** math.floor(math.log10(min(values)) - 0.5)
    right = max(values) * 1.5
    for row, ((name, value), bar) in enumerate(zip(shown, values, strict=True)):
        ax.barh(row, bar - left, left=left, color=MODEL_COLOURS[name], height=0.42)
        ax.text(left * 1.15, row - 0.34, f"{MODEL_LABELS[name]}: {value:.3g} %", va="center", fontsize=8.5, color=INK)
    ax.set_xscale("log")
    ax.set_xlim(left, right)
    ax.set_ylim(len(shown) - 0.5, -0.7)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
