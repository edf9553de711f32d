"""Time axes of figures: drawn thinned so that no spike is lost, with data of the whole time for a
plot to zoom into.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COLUMNS_A_POINT = 0.9  # of the width of a picture
MOST_UNITS = 65000  # of a difference of times; below 65535, which rounding could exceed
# columns of pixels of a plot over the width of a page, and of one beside others
WIDE, NARROW = 700, 300


@dataclass
class TimePanel:
    """What a plot shows of one pair of axes: `clock` names the time that it shares, `part` is what
    the picture shows of it [s].
    """

    clock: str
    part: tuple[float, float] | None
    columns: int
    items: list[dict[str, Any]] = field(default_factory=list)


def extremes(values: Array, columns: int) -> NDArray[np.intp]:
    """Return indices of the least and the largest sample in each of `columns` equal parts, of the
    ends and of gaps (NaN).
    """
    n = len(values)
    size = -(-n // columns)
    if size <= 2:
        return np.arange(n)
    padded = np.append(values, np.full(-n % size, values[-1])).reshape(-1, size)
    gap, begin = np.isnan(padded), size * np.arange(len(padded))
    low, high = (
        np.where(gap, np.inf, padded).argmin(axis=1),
        np.where(gap, -np.inf, padded).argmax(axis=1),
    )
    broken = gap.any(axis=1)
    index = np.concatenate(
        [begin + low, begin + high, (begin + gap.argmax(axis=1))[broken], [0, n - 1]]
    )
    return np.unique(np.minimum(index, n - 1))


def time_panel(ax: Any, clock: str = "run", part: tuple[float, float] | None = None) -> None:
    """Make time axes of axes, for `time_curve`, `time_band` and `time_mark`; the picture shows
    `part` [s], or all.
    """
    single = ax.get_position().width > 0.5
    ax.time_panel = TimePanel(clock, part, WIDE if single else NARROW)
    if part is not None:
        ax.set_xlim(*part)


def time_curve(
    ax: Any, time: Array, values: Array, colour: str, label: str = "", **style: Any
) -> None:
    """Draw values over time [s], shape (n,); NaN is a gap. `style` is matplotlib's."""
    drawn, parts = _indices(ax, time, (values,))
    named = {"label": label} if label else {}
    [line] = ax.plot(time[drawn], values[drawn], color=colour, **named, **style)
    dashes = [round(float(each), 1) for each in line._dash_pattern[1] or ()]
    item = {"label": label, "colour": colour, "width": line.get_linewidth(), "dashes": dashes}
    ax.time_panel.items.append(item | _data(time, {"y": values}, parts))


def time_band(ax: Any, time: Array, low: Array, high: Array, colour: str, alpha: float) -> None:
    """Fill between two lines over time [s], each of shape (n,)."""
    drawn, parts = _indices(ax, time, (low, high))
    ax.fill_between(time[drawn], low[drawn], high[drawn], color=colour, alpha=alpha, linewidth=0)
    ax.time_panel.items.append(
        {"colour": colour, "alpha": alpha} | _data(time, {"y": low, "high": high}, parts)
    )


def time_span(ax: Any, first: float, last: float, colour: str, alpha: float) -> None:
    """Shade a part of the time [s]."""
    ax.axvspan(first, last, color=colour, alpha=alpha, linewidth=0)
    ax.time_panel.items.append(
        {"colour": colour, "alpha": alpha, "from": float(first), "to": float(last)}
    )


def time_mark(ax: Any, at: float, colour: str) -> None:
    """Draw a dotted line at a time [s]."""
    ax.axvline(at, color=colour, linewidth=1.0, linestyle=":")
    ax.time_panel.items.append({"colour": colour, "at": float(at)})


def time_horizontal(
    ax: Any, value: float, colour: str, dashes: Sequence[float] = (), **style: Any
) -> None:
    """Draw a value that holds all the time."""
    ax.axhline(value, color=colour, linestyle=(0, tuple(dashes)) if dashes else "-", **style)
    ax.time_panel.items.append({"colour": colour, "level": float(value), "dashes": list(dashes)})


def _indices(
    ax: Any, time: Array, rows: Sequence[Array]
) -> tuple[NDArray[np.intp], list[NDArray[np.intp]]]:
    """Return the samples for the picture, and those for the plot: of the whole time, and of the
    part that the picture shows.
    """
    panel, everything = ax.time_panel, slice(0, len(time))
    part = everything
    if panel.part is not None:
        first, last = np.searchsorted(time, panel.part)
        part = slice(int(first), int(last) + 1)
    columns = COLUMNS_A_POINT * 72 * ax.figure.get_size_inches()[0] * ax.get_position().width
    parts = [everything] if panel.part is None else [everything, part]
    return _thinned(rows, part, round(columns)), [
        _thinned(rows, each, panel.columns) for each in parts
    ]


def _data(
    time: Array, rows: Mapping[str, Array], parts: Sequence[NDArray[np.intp]]
) -> dict[str, Any]:
    """Return times and values as report.js reads them: of the whole time, and as `fine` of the part
    in the picture.
    """
    whole, *part = [
        {"x": _steps(time[index])} | {key: _packed(row[index]) for key, row in rows.items()}
        for index in parts
    ]
    return whole | ({"fine": part[0]} if part else {})


def _thinned(rows: Sequence[Array], part: slice, columns: int) -> NDArray[np.intp]:
    if len(rows[0][part]) == 0:
        return np.empty(0, dtype=np.intp)
    index = (part.start or 0) + np.unique(
        np.concatenate([extremes(row[part], columns) for row in rows])
    )
    gap = np.isnan(rows[0][index])
    # one sample on either side shows a gap
    inside = gap & np.append(True, gap[:-1]) & np.append(gap[1:], True)
    kept: NDArray[np.intp] = index[~inside]
    return kept


def _packed(values: Array, kind: str = "<f4") -> str:
    """Return numbers as text: little-endian, by default 32-bit floating point, in base 64."""
    return base64.b64encode(values.astype(kind).tobytes()).decode()


def _steps(time: Array) -> dict[str, Any]:
    """Return rising times as their first, a unit [s] and 16-bit differences in this unit."""
    unit = float(np.diff(time).max(initial=0.0)) / MOST_UNITS or 1.0
    places = np.round((time - time[:1]) / unit)
    return {
        "first": float(time[0]) if len(time) else 0.0,
        "unit": unit,
        "steps": _packed(np.diff(places), "<u2"),
    }


def plot_data(figure: Any) -> str:
    """Return the time axes of a figure as JSON for report.js, nothing if it has none."""
    axes = [ax for ax in figure.axes if hasattr(ax, "time_panel")]
    if not axes:
        return ""
    panels = [_described(ax) for ax in axes]
    columns = len({round(ax.get_position().x0, 3) for ax in axes})
    return json.dumps(
        {"clock": axes[0].time_panel.clock, "columns": columns, "panels": panels},
        separators=(",", ":"),
    )


def _described(ax: Any) -> dict[str, Any]:
    found: TimePanel = ax.time_panel
    limits = None if ax.get_autoscaley_on() else [float(each) for each in ax.get_ylim()]
    return {
        "title": ax.get_title(loc="left"),
        "note": ax.get_title(loc="right"),
        "y": ax.get_ylabel(),
        "limits": limits,
        "part": found.part,
        "items": found.items,
    }
