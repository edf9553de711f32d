"""compare.html: verdict, what differs, each signal in its tube with its worst point, and the
numbers.
"""

from __future__ import annotations

import math
import sys
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.drawing import (
    ESTIMATE,
    FAILED,
    GREY,
    PALE,
    STYLE,
    new_figure,
    set_labels,
    set_title,
    svg,
)
from bristle.common.html import badge, figure, identifier, number, page, table, unit, written_unit
from bristle.common.time_plot import extremes
from bristle.harness.baseline.comparison import (
    Comparison,
    QuantityVerdict,
    SignalCourse,
    SignalVerdict,
    counts,
    differences,
)
from bristle.harness.baseline.tube import EXACT_MARGIN

PAGE_BYTES = 1_000_000  # of the page, which then fits into a mail
LINE_BYTES = 200  # of what is said of figures that do not fit
COURSE_SIZE = (8.6, 1.9)  # width and height of the figure of a signal [inch]
CLOSE_ROWS = 40  # compared rows on either side of the worst point in the close view
# columns of the picture of a whole course, of each of which the least and the largest value are
# drawn
COLUMNS = 200
BETWEEN = 0.35  # width between both views over the mean of theirs
MOST_SHARE = 1e4  # of what is allowed; a larger share tells no more
# of the largest number at an axis: what a shorter axis shows is counted from a number within it
OFFSET_SPAN = 1e-3
LEAST_POWER, MOST_POWER = -3, 3  # of ten, between which numbers at an axis are written out
DECIMALS = 8  # of numbers at an axis; what is less is the rounding of a difference
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MOST_FIGURES = 24  # signals that are drawn, those farthest from their references first


def render(found: Comparison) -> str:
    """Return the page, of at most `PAGE_BYTES`: figures that do not fit are left out."""
    head = badge("good", "pass") if found.passed else badge("bad", "differs")
    inside, judged = counts(found.signals)
    lead = (
        f"{inside} of {judged} signals inside their tubes at {found.rows} of the {found.instants}"
        " instants of A"
    )
    parts = [
        f"<header><h1>{escape(found.scenario)} against its reference {head}</h1>"
        f"<p class='lead'>{lead}. A: {escape(found.first)}; B: {escape(found.second)}</p></header>"
    ]
    parts += [f'<p class="alarm">{escape(line)}</p>' for line in found.refused]
    different = differences(found)
    if different and not found.refused:
        parts.append(
            "<h2>What differs</h2><ul>"
            + "".join(f"<li>{escape(line)}</li>" for line in different)
            + "</ul>"
        )
    if found.notes:
        parts.append(
            "<h2>Not the same, and not judged</h2><ul>"
            + "".join(f"<li>{escape(n)}</li>" for n in found.notes)
            + "</ul>"
        )
    if found.quantities:
        columns = ("number", "unit", "A", "B", "allowed ±", "")
        parts.append(
            "<h2>Numbers</h2>"
            + table(columns, [_quantity(each) for each in found.quantities], (2, 3, 4))
        )
    if found.signals:
        names = (
            "signal",
            "unit",
            "worst at, s",
            "A",
            "B",
            "B − A",
            "allowed",
            "of what is allowed",
            "",
        )
        rows = [_signal(each, found.units.get(each.name, "")) for each in found.signals]
        parts.append("<h2>Signals</h2>" + table(names, rows, (2, 3, 4, 5, 6, 7)))
    title = f"{found.scenario} against its reference"
    parts += _figures(found, PAGE_BYTES - len(page(title, "\n".join(parts)).encode()))
    return page(title, "\n".join(parts))


def _quantity(each: QuantityVerdict) -> tuple[str, ...]:
    words = {
        True: badge("good", "same"),
        False: badge("bad", "differs"),
        None: badge("open", "not judged"),
    }[each.passed]
    cells = (number(each.first, 6), number(each.second, 6), number(each.tolerance, 2))
    return (
        identifier(each.path),
        unit(each.unit),
        *cells,
        words + escape(f" {each.why}" if each.why else ""),
    )


def _signal(each: SignalVerdict, of: str) -> tuple[str, ...]:
    word = badge("good", "inside") if each.passed else badge("bad", "outside")
    if each.passed and each.why:
        word = badge("open", "not judged")
    off = None if each.value is None or each.reference is None else each.value - each.reference
    cells = (
        number(each.time),
        number(each.reference, 6),
        number(each.value, 6),
        number(off, 2),
        _margins(each),
        _share(each.share),
    )
    return (
        identifier(each.name),
        unit(of),
        *cells,
        word + escape(f" {each.why}" if each.why else ""),
    )


def _margins(each: SignalVerdict) -> str:
    """Return how far B may be from A: one number where it is as far on both sides."""
    if each.margins is None:
        return ""
    below, above = each.margins
    if not above:
        return "exactly 0"
    low, high = number(-below, 2), number(above, 2)
    return f"± {high}" if low == f"−{high}" else f"{low} to +{high}"


def _share(share: float | None) -> str:
    if share is None:
        return ""
    return (
        f"{number(100 * share, 2)} %"
        if share < MOST_SHARE
        else f"over {number(100 * MOST_SHARE)} %"
    )


def _figures(found: Comparison, room: int) -> list[str]:
    """Return the figures of signals that move, as many as fit into so many bytes, those farthest
    from their references first.
    """
    moving = [
        each
        for each in found.signals
        if each.name in found.courses and _moves(found.courses[each.name])
    ]
    worst = sorted(
        moving, key=lambda each: (each.passed, -(each.share if each.share is not None else np.inf))
    )
    parts = ["<h2>Courses</h2>"] if worst else []
    room -= LINE_BYTES
    drawn = 0
    for each in worst[:MOST_FIGURES]:
        caption = (
            f"{each.name}: B (blue) in its tube (grey), its worst point marked; right: around that"
            " point"
        )
        picture = figure(
            each.name,
            _draw(each, found.courses[each.name], found.units.get(each.name, "")),
            caption,
        )
        room -= len(picture.encode())
        if room < 0:
            break
        parts.append(picture)
        drawn += 1
    if left := len(worst) - drawn:
        parts.append(
            f'<p class="sub">Not drawn: {left} more signals that move, nearer to their'
            " references.</p>"
        )
    return parts


def _moves(course: SignalCourse) -> bool:
    values = course.values[np.isfinite(course.values)]
    return len(values) < len(course.values) or bool(np.ptp(values))


def _draw(each: SignalVerdict, course: SignalCourse, of: str) -> str:
    from matplotlib import rc_context

    place = 0 if each.time is None else int(np.argmin(np.abs(course.time - each.time)))
    close = np.arange(max(0, place - CLOSE_ROWS), min(len(course.time), place + CLOSE_ROWS + 1))
    with rc_context(STYLE):
        drawn = new_figure(*COURSE_SIZE)
        whole, near = drawn.subplots(1, 2, width_ratios=(2, 1))
        drawn.subplots_adjust(wspace=BETWEEN)
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
    return " ".join(
        filter(None, (f"10{str(power).translate(RAISED)}" if power else "", written_unit(of)))
    )


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
    """Return a bound as it is drawn: that of a signal that must be 0 would set the scale of the
    axis.
    """
    return np.where(
        np.isfinite(values), np.where(np.abs(values) < EXACT_MARGIN, 0.0, values), np.nan
    )
