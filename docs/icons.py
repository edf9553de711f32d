"""Draw the icons of the FMUs, fmus/icons: `python docs/icons.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
from bristle.common.drawing import BLUE, GREEN, GREY, INK, ORANGE, svg

FOLDER = Path(__file__).resolve().parent.parent / "fmus" / "icons"
INCH, DOTS = 1.0, 128  # size of an icon and its resolution
LINE = 5.0  # points


def plant(ax: Any) -> None:
    """A mass that bristles hold."""
    ax.add_patch(
        matplotlib.patches.Rectangle(
            (-0.6, -0.05), 1.2, 0.65, facecolor=BLUE, edgecolor=INK, linewidth=LINE / 2
        )
    )
    for x in np.linspace(-0.5, 0.5, 5):
        y = np.linspace(0, 1, 20)
        ax.plot(
            x - 0.02 + 0.16 * y**2,
            -0.62 + 0.55 * y,
            color=ORANGE,
            linewidth=LINE,
            solid_capstyle="round",
        )
    ax.plot([-0.85, 0.85], [-0.68, -0.68], color=INK, linewidth=LINE)


def observer(ax: Any) -> None:
    """An estimate that tends to a truth."""
    t = np.linspace(0, 1, 200)
    ax.plot([-0.8, 0.8], [0.35, 0.35], color=GREY, linewidth=LINE, linestyle=(0, (2, 1)))
    ax.plot(
        -0.8 + 1.6 * t, 0.35 - 1.0 * np.exp(-5 * t) * np.cos(14 * t), color=BLUE, linewidth=LINE
    )


def controller(ax: Any) -> None:
    """A loop: a sum, a gain, and the way back."""
    ax.add_patch(
        matplotlib.patches.Circle(
            (-0.55, 0.25), 0.22, facecolor="white", edgecolor=INK, linewidth=LINE / 1.5
        )
    )
    ax.add_patch(
        matplotlib.patches.Rectangle(
            (0.0, 0.0), 0.6, 0.5, facecolor=GREEN, edgecolor=INK, linewidth=LINE / 2
        )
    )
    for x, y in (
        ([-0.9, -0.77], [0.25, 0.25]),
        ([-0.33, 0.0], [0.25, 0.25]),
        ([0.6, 0.9], [0.25, 0.25]),
    ):
        ax.plot(x, y, color=INK, linewidth=LINE / 1.5)
    ax.plot([0.78, 0.78, -0.55, -0.55], [0.25, -0.5, -0.5, 0.03], color=INK, linewidth=LINE / 1.5)


ICONS = {"ServoPlant": plant, "AdaptiveObserver": observer, "Controller": controller}


def main() -> None:
    """Write each icon as SVG and PNG."""
    from matplotlib import pyplot as plt

    FOLDER.mkdir(exist_ok=True)
    for name, draw in ICONS.items():
        figure = plt.figure(figsize=(INCH, INCH))
        ax = figure.add_axes((0, 0, 1, 1))
        ax.set(xlim=(-1, 1), ylim=(-1, 1))
        ax.set_axis_off()
        draw(ax)
        figure.savefig(
            FOLDER / f"{name}.png", dpi=DOTS, transparent=True, metadata={"Software": None}
        )
        (FOLDER / f"{name}.svg").write_text(
            svg(figure, name) + "\n", encoding="utf-8", newline="\n"
        )
        plt.close(figure)


if __name__ == "__main__":
    main()
