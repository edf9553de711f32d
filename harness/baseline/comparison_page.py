"""compare.html: verdict, what differs, each signal in its tube with its worst point, numbers."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common import pages
from bristle.common.drawing import (
    ESTIMATE,
    FAILED,
    GREY,
    PALE,
    STYLE,
    Drawing,
    new_figure,
    set_labels,
    set_title,
    svg,
)
from bristle.common.pages import unit
from bristle.common.time_plot import extremes
from bristle.harness.baseline.tube import EXACT_MARGIN
from bristle.harness.baseline.verdicts import (
    RunComparison,
    SignalCourse,
    SignalVerdict,
    counts,
    differences,
)

PAGE_BYTES = 1_000_000  # of the page, which then fits into a mail
COURSE_SIZE = (8.6, 1.9)  # width and height of the figure of a signal [inch]
CLOSE_ROWS = 40  # compared rows on either side of the worst point in the close view
# columns of the picture of a whole course, of each of which the least and the largest value are
# drawn
COLUMNS = 200
BETWEEN = 0.35  # width between both views over the mean of theirs
# of the largest number at an axis: what a shorter axis shows is counted from a number within it
OFFSET_SPAN = 1e-3
LEAST_POWER, MOST_POWER = -3, 3  # of ten, between which numbers at an axis are written out
DECIMALS = 8  # of numbers at an axis; what is less is the rounding of a difference
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MOST_FIGURES = 24  # signals that are drawn, those farthest from their references first


def render(comparison: RunComparison) -> str:
    """Return the page, of at most `PAGE_BYTES`: figures that do not fit are left out."""
    moving = _moving(comparison)
    figures: dict[str, Drawing] = {}
    page = _page(comparison, figures, len(moving))
    for each in moving[:MOST_FIGURES]:
        course, of = comparison.courses[each.name], comparison.units.get(each.name, "")
        figures[each.name] = _draw(each, course, of)
        larger = _page(comparison, figures, len(moving))
        if len(larger.encode()) > PAGE_BYTES:
            break
        page = larger
    return page


def _page(comparison: RunComparison, figures: Mapping[str, Drawing], moving: int) -> str:
    inside, judged = counts(comparison.signals)
    return pages.render(
        "bristle.harness.baseline/compare.html",
        comparison=comparison,
        inside=inside,
        judged_signals=judged,
        differences=differences(comparison),
        moving=moving,
        figures=figures,
    )


def _moving(comparison: RunComparison) -> list[SignalVerdict]:
    """Return the signals that move, those farthest from their references first."""
    moving = [
        each
        for each in comparison.signals
        if each.name in comparison.courses and _moves(comparison.courses[each.name])
    ]
    return sorted(
        moving, key=lambda each: (each.passed, -(each.share if each.share is not None else np.inf))
    )


def _moves(course: SignalCourse) -> bool:
    values = course.values[np.isfinite(course.values)]
    return len(values) < len(course.values) or bool(np.ptp(values))


def _draw(each: SignalVerdict, course: SignalCourse, of: str) -> Drawing:
    from matplotlib import rc_context

    # the worst point and what is close to it
    place = 0 if each.time is None else int(np.argmin(np.abs(course.time - each.time)))
    close = np.arange(max(0, place - CLOSE_ROWS), min(len(course.time), place + CLOSE_ROWS + 1))
    with rc_context(STYLE):
        drawn = new_figure(*COURSE_SIZE)
        whole, near = drawn.subplots(1, 2, width_ratios=(2, 1))
        drawn.subplots_adjust(wspace=BETWEEN)
        # the whole course, and enlarged around that point
        for ax, rows, title in (
            (whole, np.union1d(extremes(course.values, COLUMNS), [place]), each.name),
            (near, close, "worst point"),
        ):
            _plot(ax, course, rows)
            if each.time is not None and np.isfinite(course.values[place]):
                ax.plot(
                    course.time[place],
                    course.values[place],
                    "o",
                    color=ESTIMATE if each.passed else FAILED,
                    markersize=5,
                )
            elif each.time is not None:
                ax.axvline(course.time[place], color=FAILED)
            set_title(ax, title)
            set_labels(ax, "time, s", _scale(ax, of))
        return svg(drawn, each.name)


def _scale(ax: Any, of: str) -> str:
    """Scale the numbers at the y axis and return what they are in: power of ten and unit; what is
    to be added stands at the right.

    matplotlib would write both over the title.
    """
    low, high = ax.get_ylim()
    large = max(abs(low), abs(high))
    offset = (
        round(0.5 * (low + high), -math.floor(math.log10(high - low)) - 1)
        if high - low < OFFSET_SPAN * large
        else 0.0
    )
    power = math.floor(math.log10(max(abs(low - offset), abs(high - offset), sys.float_info.min)))
    power = 0 if LEAST_POWER <= power <= MOST_POWER else power

    def shown(value: float, _: object) -> str:
        # without a sign before 0
        return f"{round((value - offset) / 10.0**power, DECIMALS) + 0.0:g}".replace("-", "−")

    ax.yaxis.set_major_formatter(shown)
    if offset:
        set_title(ax, f"{offset:+.12g}".replace("-", "−"), loc="right")
    return " ".join(filter(None, (f"10{str(power).translate(RAISED)}" if power else "", unit(of))))


def _plot(ax: Any, course: SignalCourse, rows: NDArray[np.intp]) -> None:
    time = course.time[rows]
    ax.fill_between(
        time,
        *(_bound(each[rows]) for each in (course.lower, course.upper)),
        color=PALE,
        linewidth=0.6,
        edgecolor=GREY,
    )
    ax.plot(time, course.values[rows], color=ESTIMATE, linewidth=1.0)


def _bound(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a bound as drawn: that of a signal that must be 0 would set the scale of the axis."""
    return np.where(
        np.isfinite(values), np.where(np.abs(values) < EXACT_MARGIN, 0.0, values), np.nan
    )
