"""Style of all figures: colours, sizes, labels at fixed places, and SVG text that is reproducible."""

from __future__ import annotations

import io
import math
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

# colours by Okabe and Ito, which colour-blind readers can distinguish
BLUE, ORANGE, GREEN, RED, GREY, PALE, INK = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#8a8f98", "#b9bec7", "#1f2430"
DEGREES = 180.0 / math.pi
THINNED_POINTS = 1200  # points of a curve, at most
TICKS = 5  # intervals between ticks, at most
MARGINS = (0.74, 0.15, 0.5, 0.36)  # margins left, right, below and above the axes [inch]
BESIDE, LETTER = 0.16, 0.074  # both gaps beside the tick labels together, mean width of their letters [inch]
STYLE: Any = {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans", "Helvetica", "Arial"], "font.size": 9,
    "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": GREY, "axes.labelcolor": INK,
    "axes.titlesize": 9.5, "axes.titlelocation": "left", "axes.linewidth": 0.8, "axes.grid": True, "axes.axisbelow": True,
    "grid.color": "#e6e8ec", "grid.linewidth": 0.7, "xtick.color": INK, "ytick.color": INK, "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5, "lines.linewidth": 1.4, "lines.solid_joinstyle": "round", "legend.frameon": False,
    "legend.fontsize": 8.5, "svg.hashsalt": "bristle", "path.simplify": True,
}  # fmt: skip


def thin(n: int, points: int = THINNED_POINTS) -> NDArray[np.intp]:
    """Return at most `points` evenly spread indices of n samples."""
    return np.unique(np.linspace(0, n - 1, min(n, points)).round().astype(np.intp))


def svg(figure: Any, salt: str) -> str:
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
        warnings.filterwarnings("ignore", "Glyph")  # a record may have any name; characters that the font lacks are drawn as boxes
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    return text[text.index("<svg") :]


def _place_labels(figure: Any) -> None:
    """Put the names of y axes beside their tick labels, in one line for axes that begin at one place."""
    named = [ax for ax in figure.axes if ax.get_ylabel()]
    columns: dict[float, float] = {}
    for ax in named:
        ticks = ax.yaxis.get_major_formatter().format_ticks(ax.yaxis.get_majorticklocs())
        place = round(ax.get_position().x0, 3)
        columns[place] = max(columns.get(place, 0.0), BESIDE + LETTER * max(map(len, ticks), default=0))
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
