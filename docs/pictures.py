"""Draw the pictures of the README and of the page on exchange: python docs/pictures.py [run]
[diagnosis] [exchange]

The last one needs another importer: pip install 'bristle[interop]'.
"""

from __future__ import annotations

import io
import math
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

import bristle

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
SCENARIO = "repaired_two_step"
CASE = ROOT / "scenarios" / "hidden" / "07"
SHOWN = 2.0  # s of the record in which the model without the effect is worst
TRUE, BEFORE, AFTER = "#9a9a9a", "#c8553d", "#1f6f8b"
# inches, points, points: legible where a narrow page shrinks the picture
WIDTH, TEXT, TICKS = 7.2, 9, 8.5


def write(figure: Figure, name: str) -> None:
    """Write a figure as PNG with few colours."""
    picture = io.BytesIO()
    figure.savefig(picture, dpi=150)
    Image.open(picture).convert("RGB").quantize(64).save(IMAGES / name, optimize=True)


def run() -> None:
    """Draw every estimate of a run that has an error against its true value."""
    with tempfile.TemporaryDirectory() as out:
        result = bristle.run(ROOT / "scenarios" / f"{SCENARIO}.toml", out)
        signals = result.signals()
    shown = {
        name: found
        for name, found in result.estimates.items()
        if math.isfinite(found["error_percent"])
    }
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = figure.subplots(2, 4).ravel()
    for axis, (name, found) in zip(axes, shown.items(), strict=False):
        axis.axhline(found["true"], color=TRUE, lw=2.5, label="true value")
        axis.plot(signals["time"], signals[f"{name}_hat"], color=AFTER, lw=1.1, label="estimate")
        axis.set_title(
            f"{name} [{found['unit']}]\nerror {found['error_percent']:.2g} %",
            fontsize=TEXT,
            loc="left",
        )
        low, high = sorted((0.0, 1.6 * found["true"]))
        axis.set(ylim=(low, high), xlim=(0, signals["time"][-1]))
        axis.tick_params(labelsize=TICKS)
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes[len(shown) :]:
        axis.axis("off")
        axis.legend(
            *axes[0].get_legend_handles_labels(), loc="center", fontsize=TEXT, frameon=False
        )
    figure.supxlabel("time [s]", fontsize=TEXT)
    write(figure, f"{SCENARIO}.png")


def diagnosis() -> None:
    """Draw measurement and simulation with and without the effect that was found, and the errors on
    held-out segments.
    """
    found = bristle.diagnose(CASE / "model.toml", [CASE / "a.npz", CASE / "b.npz"])
    trace = found.traces[0]
    count = round(SHOWN / float(np.median(np.diff(trace.time))))
    error = np.convolve(
        np.nan_to_num(np.square(trace.before - trace.measured)), np.ones(count), "valid"
    )
    part = slice(int(np.argmax(error)), int(np.argmax(error)) + count)
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=[1.5, 1.5, 1])
    left.plot(trace.time[part], trace.measured[part], color=TRUE, lw=3.5, label="measured")
    for values, colour, label in (
        (trace.before, BEFORE, "model refitted, without the effect"),
        (trace.after, AFTER, "model refitted, with the effect found"),
    ):
        left.plot(trace.time[part], values[part], color=colour, lw=1.2, label=label)
        middle.plot(trace.time[part], 1e3 * (values - trace.measured)[part], color=colour, lw=1.2)
    left.set(xlabel="time [s]", ylabel="position [rad]")
    figure.legend(
        *left.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=3,
        fontsize=TEXT,
        frameon=False,
    )
    middle.set(xlabel="time [s]", ylabel="error [mrad]")
    bars = {
        "without\neffect": found.gap.before,
        "with\neffect": found.gap.after,
        "noise\nfloor": found.gap.noise_floor or 0.0,
    }
    heights = [1e3 * square**0.5 for square in bars.values()]
    right.bar(list(bars), heights, color=[BEFORE, AFTER, TRUE])
    for place, height in enumerate(heights):
        right.annotate(f"{height:.2g}", (place, height), ha="center", va="bottom", fontsize=TEXT)
    right.set(ylabel="rms error, held-out segments [mrad]")
    for axis in (left, middle, right):
        axis.tick_params(labelsize=TICKS)
        axis.xaxis.label.set_size(TEXT)
        axis.yaxis.label.set_size(TEXT)
        axis.spines[["top", "right"]].set_visible(False)
    write(figure, "diagnosis_hidden_07.png")


# lower left corners in the picture
BOXES = {"controller": (0.0, 0.55), "plant": (0.42, 0.55), "observer": (0.84, 0.05)}
BOX = (0.16, 0.36)
ARROWS = (  # label and corners of each connection of `quick`
    ("u", [(0.16, 0.73), (0.42, 0.73)]),
    ("theta_enc, v_enc", [(0.58, 0.73), (0.92, 0.73), (0.92, 0.41)]),
    ("u", [(0.27, 0.73), (0.27, 0.23), (0.84, 0.23)]),
    ("v", [(0.66, 0.73), (0.66, 1.05), (-0.07, 1.05), (-0.07, 0.73), (0.0, 0.73)]),
)


def exchange() -> None:
    """Draw what is in an exported scenario, and what another importer makes of it beside the
    reference that lies within.
    """
    from ecospy import EcosSimulation

    from bristle.harness.exchange.kit import export

    with tempfile.TemporaryDirectory() as out:
        package = export(ROOT / "scenarios" / "quick.toml", Path(out))
        reference = np.genfromtxt(
            Path(out) / "reference" / "signals.csv", delimiter=",", names=True, deletechars=""
        )
        names = ("plant.theta", "observer.Fc_hat")
        simulation = EcosSimulation(ssp_path=str(package), step_size=1e-3)
        simulation.init()
        theirs, stride = [], round((reference["time"][1] - reference["time"][0]) / 1e-3)
        for _ in reference["time"][1:]:
            simulation.step(stride)
            theirs.append([simulation.get_real(name.replace(".", "::", 1)) for name in names])
    figure = Figure(figsize=(WIDTH, 5.0), layout="constrained")
    top, below = figure.subfigures(2, 1, height_ratios=[1.0, 1.5])
    _wiring(top.subplots())
    panels = below.subplots(2, 2, sharex=True, height_ratios=[2, 1])
    for column, name, unit, got in zip(
        panels.T, names, ("rad", "rad/s2"), np.array(theirs).T, strict=True
    ):
        time, expected = reference["time"], reference[name]
        column[0].plot(time, expected, color=TRUE, lw=3, label="reference in the package")
        column[0].plot(time[1:], got, color=AFTER, lw=1, label="Ecos")
        column[1].plot(time[1:], got - expected[1:], color=BEFORE, lw=1)
        column[0].set_title(f"{name} [{unit}]", fontsize=TEXT, loc="left")
        column[1].set_title("Ecos less reference", fontsize=TEXT, loc="left")
        column[1].set_xlabel("time [s]", fontsize=TEXT)
        for axis in column:
            axis.tick_params(labelsize=TICKS)
            axis.spines[["top", "right"]].set_visible(False)
    panels[0, 0].legend(fontsize=TEXT, frameon=False)
    write(figure, "exchange.png")


def _wiring(axis: Axes) -> None:
    """Draw the connections of the package."""
    axis.set(xlim=(-0.09, 1.02), ylim=(0.0, 1.12))
    axis.axis("off")
    for name, corner in BOXES.items():
        axis.add_patch(Rectangle(corner, *BOX, facecolor="#eef3f6", edgecolor=AFTER))
        axis.annotate(
            f"{name}.fmu",
            (corner[0] + BOX[0] / 2, corner[1] + BOX[1] / 2),
            ha="center",
            va="center",
            fontsize=TEXT,
        )
    for label, corners in ARROWS:
        axis.plot(*np.array(corners[:-1]).T, color="#444444", lw=1.1)
        axis.annotate(
            "",
            corners[-1],
            corners[-2],
            arrowprops={"arrowstyle": "-|>", "color": "#444444", "shrinkA": 0, "shrinkB": 0},
        )
        (x, y), (x2, y2) = max(pairwise(corners), key=lambda pair: abs(pair[0][0] - pair[1][0]))
        axis.annotate(
            label,
            ((x + x2) / 2, (y + y2) / 2),
            (0, 3),
            textcoords="offset points",
            ha="center",
            fontsize=TICKS,
        )


def main(names: list[str]) -> None:
    """Draw the pictures that are named, or all."""
    for draw in (run, diagnosis, exchange):
        if not names or draw.__name__ in names:
            draw()


if __name__ == "__main__":
    main(sys.argv[1:])
