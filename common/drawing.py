"""Style of all figures: colours, sizes, labels at fixed places, and reproducible SVG text."""

from __future__ import annotations

import io
import math
import re
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.time_plot import plot_data

# colours by Okabe and Ito, which colour-blind readers can distinguish
BLUE, ORANGE, GREEN, RED, GREY, PALE, INK = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#8a8f98",
    "#b9bec7",
    "#1f2430",
)
# what a colour stands for, in all figures; each has a contrast of 3 and more against white, most of
# 4.5 and can colour text
TRUTH, MEASURED, ESTIMATE, REFERENCE_COLOUR, LIMIT = INK, "#878c96", BLUE, "#9c4f96", "#007a5a"
# a second model or run, a third one, what is not as it must be
OTHER, BASELINE, FAILED = "#b65c00", "#cf3a7c", "#b3440a"
ROLES = {
    "truth": TRUTH,
    "measured": MEASURED,
    "estimate": ESTIMATE,
    "reference": REFERENCE_COLOUR,
    "limit": LIMIT,
    "second model": OTHER,
    "third model": BASELINE,
    "failure": FAILED,
    "not valid": GREY,
}
DEGREES = 180.0 / math.pi
PATH, COORDINATE = re.compile(r'(?<= d=")[^"]*'), re.compile(r"-?\d+\.\d{2,}")  # of SVG text
TICKS = 5  # intervals between ticks, at most
MARGINS = (0.74, 0.15, 0.5, 0.36)  # margins left, right, below and above the axes [inch]
# both gaps beside the tick labels together, mean width of their letters [inch]
BESIDE, LETTER = 0.16, 0.074
STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Helvetica", "Arial"],
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e8ec",
    "grid.linewidth": 0.7,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "lines.linewidth": 1.4,
    "lines.solid_joinstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "svg.hashsalt": "bristle",
    "path.simplify": True,
}


def thin(n: int, points: int) -> NDArray[np.intp]:
    """Return at most `points` evenly spread indices of n samples."""
    return np.unique(np.linspace(0, n - 1, min(n, points)).round().astype(np.intp))


class Drawing(str):
    """SVG text of a figure.

    `plot` holds the data of its time axes as JSON, nothing if it has none; `seen` says what it
    shows, for those who cannot see it.
    """

    plot, seen = "", ""


def svg(figure: Any, salt: str) -> Drawing:
    """Return a figure as an <svg> element; `salt` keeps the ids of different figures apart."""
    from matplotlib import rc_context
    from matplotlib.ticker import AutoLocator

    for ax in figure.axes:  # ticks take most of the time of drawing
        for axis in (ax.xaxis, ax.yaxis):
            if isinstance(axis.get_major_locator(), AutoLocator):
                axis.get_major_locator().set_params(nbins=TICKS)
    _place_labels(figure)
    out = io.StringIO()
    with rc_context({"svg.hashsalt": f"bristle-{salt}"}), warnings.catch_warnings():
        # a record may have any name; characters that the font lacks are drawn as boxes
        warnings.filterwarnings("ignore", "Glyph")
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    drawing = Drawing(PATH.sub(_shortened, text[text.index("<svg") :]))
    drawing.plot = plot_data(figure)
    return drawing


def _shortened(path: re.Match[str]) -> str:
    """Return the points of a path to a tenth of a point, without needless spaces: what is finer
    cannot be seen.
    """
    rounded = COORDINATE.sub(lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), path[0])
    return re.sub(r"\s*([A-Za-z])\s*", r"\1", rounded).strip()


def _place_labels(figure: Any) -> None:
    """Put the names of y axes beside their tick labels, in line for axes that begin alike."""
    named = [ax for ax in figure.axes if ax.get_ylabel()]
    columns: dict[float, float] = {}
    for ax in named:
        ticks = ax.yaxis.get_major_formatter().format_ticks(ax.yaxis.get_majorticklocs())
        place = round(ax.get_position().x0, 3)
        columns[place] = max(
            columns.get(place, 0.0), BESIDE + LETTER * max(map(len, ticks), default=0)
        )
    for ax in named:
        width = ax.get_position().width * figure.get_size_inches()[0]
        ax.yaxis.set_label_coords(-columns[round(ax.get_position().x0, 3)] / width, 0.5)


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure of a size in inches."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    FigureCanvasSVG(figure)
    # fixed margins in inches: a layout engine would measure every label twice
    left, right, bottom, top = MARGINS
    figure.subplots_adjust(left / width, bottom / height, 1 - right / width, 1 - top / height)
    return figure


def set_title(ax: Any, text: str, **style: Any) -> None:
    """Set a title at a fixed height, so that matplotlib need not measure the axes."""
    ax.set_title(text, y=1.0, pad=5, **style)


def set_labels(ax: Any, x: str | None = None, y: str | None = None) -> None:
    """Name the axes, that of x at a fixed distance in inches, that of y where `svg` puts it."""
    height = ax.figure.get_size_inches()[1] * ax.get_position().height
    if x is not None:
        ax.set_xlabel(x)
        ax.xaxis.set_label_coords(0.5, -0.31 / height)
    if y is not None:
        ax.set_ylabel(y)
