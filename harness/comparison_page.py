"""compare.html: verdict, what differs, each signal in its tube with its worst point, and the numbers."""

from __future__ import annotations

from html import escape

import numpy as np

from bristle.common.drawing import ESTIMATE, FAILED, GREY, PALE, STYLE, new_figure, set_labels, set_title, svg
from bristle.common.html import badge, figure, identifier, number, page, table, unit
from bristle.common.time_plot import WIDE, extremes
from bristle.harness.comparison import Comparison, QuantityVerdict, SignalCourse, SignalVerdict, counts, differences

COURSE_SIZE = (8.6, 1.9)  # width and height of the figure of a signal [inch]
CLOSE_ROWS = 40  # compared rows on either side of the worst point in the close view
MOST_FIGURES = 24  # signals that are drawn, those farthest from their references first


def render(found: Comparison) -> str:
    """Return the page."""
    head = badge("good", "pass") if found.passed else badge("bad", "differs")
    inside, judged = counts(found.signals)
    lead = f"{inside} of {judged} signals inside their tubes at {found.rows} of the {found.instants} instants of A"
    parts = [
        f"<header><h1>{escape(found.scenario)} against its reference {head}</h1>"
        f"<p class='lead'>{lead}. A: {escape(found.first)}; B: {escape(found.second)}</p></header>"
    ]
    parts += [f'<p class="alarm">{escape(line)}</p>' for line in found.refused]
    different = differences(found)
    if different and not found.refused:
        parts.append("<h2>What differs</h2><ul>" + "".join(f"<li>{escape(line)}</li>" for line in different) + "</ul>")
    if found.notes:
        parts.append("<h2>Not the same, and not judged</h2><ul>" + "".join(f"<li>{escape(n)}</li>" for n in found.notes) + "</ul>")
    if found.quantities:
        columns = ("number", "unit", "A", "B", "allowed ±", "")
        parts.append("<h2>Numbers</h2>" + table(columns, [_quantity(each) for each in found.quantities], (2, 3, 4)))
    if found.signals:
        bounds = ("signal", "worst at, s", "B", "A", "allowed from", "to", "of what is allowed", "")
        parts.append("<h2>Signals</h2>" + table(bounds, [_signal(each) for each in found.signals], (1, 2, 3, 4, 5, 6)))
    parts += _figures(found)
    return page(f"{found.scenario} against its reference", "\n".join(parts))


def _quantity(each: QuantityVerdict) -> tuple[str, ...]:
    words = {True: badge("good", "same"), False: badge("bad", "differs"), None: badge("open", "not judged")}[each.passed]
    cells = (number(each.first, 6), number(each.second, 6), number(each.tolerance, 2))
    return (identifier(each.path), unit(each.unit), *cells, words + escape(f" {each.why}" if each.why else ""))


def _signal(each: SignalVerdict) -> tuple[str, ...]:
    word = badge("good", "inside") if each.passed else badge("bad", "outside")
    if each.passed and each.why:
        word = badge("open", "not judged")
    share = "" if each.share is None else f"{number(100 * each.share, 2)} %"
    cells = (number(each.time), *(number(value, 6) for value in (each.value, each.reference, each.low, each.high)), share)
    return (identifier(each.name), *cells, word + escape(f" {each.why}" if each.why else ""))


def _figures(found: Comparison) -> list[str]:
    """Return the figures of signals that move, those farthest from their references first."""
    moving = [each for each in found.signals if each.name in found.courses and _moves(found.courses[each.name])]
    worst = sorted(moving, key=lambda each: (each.passed, -(each.share if each.share is not None else np.inf)))
    parts = ["<h2>Courses</h2>"] if worst else []
    for each in worst[:MOST_FIGURES]:
        caption = f"{each.name}: B (blue) in its tube (grey), its worst point marked; right: around that point"
        parts.append(figure(each.name, _draw(each, found.courses[each.name]), caption))
    return parts


def _moves(course: SignalCourse) -> bool:
    values = course.values[np.isfinite(course.values)]
    return len(values) < len(course.values) or bool(np.ptp(values))


def _draw(each: SignalVerdict, course: SignalCourse) -> str:
    from matplotlib import rc_context

    place = 0 if each.time is None else int(np.argmin(np.abs(course.time - each.time)))
    close = np.arange(max(0, place - CLOSE_ROWS), min(len(course.time), place + CLOSE_ROWS + 1))
    with rc_context(STYLE):
        drawn = new_figure(*COURSE_SIZE)
        whole, near = drawn.subplots(1, 2, width_ratios=(2, 1))
        for ax, rows, title in (
            (whole, np.union1d(extremes(course.values, WIDE), [place]), each.name),
            (near, close, "around the worst point"),
        ):
            _plot(ax, course, rows)
            if each.time is not None and np.isfinite(course.values[place]):
                ax.plot(course.time[place], course.values[place], "o", color=ESTIMATE if each.passed else FAILED, markersize=5)
            elif each.time is not None:
                ax.axvline(course.time[place], color=FAILED)
            set_title(ax, title)
            set_labels(ax, "time, s")
        return svg(drawn, each.name)


def _plot(ax: object, course: SignalCourse, rows: np.ndarray[tuple[int], np.dtype[np.intp]]) -> None:
    time = course.time[rows]
    bounds = [np.where(np.isfinite(each[rows]), each[rows], np.nan) for each in (course.lower, course.upper)]
    ax.fill_between(time, *bounds, color=PALE, linewidth=0.6, edgecolor=GREY)  # type: ignore[attr-defined]  # of matplotlib
    ax.plot(time, course.values[rows], color=ESTIMATE, linewidth=1.0)  # type: ignore[attr-defined]
