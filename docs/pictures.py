"""Draw the two pictures of the README, a run and a diagnosis: python docs/pictures.py [run] [diagnosis]"""

from __future__ import annotations

import io
import math
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import bristle

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
SCENARIO = "repaired_two_step"
CASE = ROOT / "scenarios" / "hidden" / "07"
SHOWN = 2.0  # s of the record in which the model without the effect is worst
TRUE, BEFORE, AFTER = "#9a9a9a", "#c8553d", "#1f6f8b"
WIDTH, TEXT, TICKS = 7.2, 9, 8.5  # inches, points, points: legible where a narrow page shrinks the picture


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
    shown = {name: found for name, found in result.estimates.items() if math.isfinite(found["error_percent"])}
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = figure.subplots(2, 4).ravel()
    for axis, (name, found) in zip(axes, shown.items(), strict=False):
        axis.axhline(found["true"], color=TRUE, lw=2.5, label="true value")
        axis.plot(signals["time"], signals[f"{name}_hat"], color=AFTER, lw=1.1, label="estimate")
        axis.set_title(f"{name} [{found['unit']}]\nerror {found['error_percent']:.2g} %", fontsize=TEXT, loc="left")
        low, high = sorted((0.0, 1.6 * found["true"]))
        axis.set(ylim=(low, high), xlim=(0, signals["time"][-1]))
        axis.tick_params(labelsize=TICKS)
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes[len(shown) :]:
        axis.axis("off")
        axis.legend(*axes[0].get_legend_handles_labels(), loc="center", fontsize=TEXT, frameon=False)
    figure.supxlabel("time [s]", fontsize=TEXT)
    write(figure, f"{SCENARIO}.png")


def diagnosis() -> None:
    """Draw measurement and simulation with and without the effect that was found, and the errors on held-out segments."""
    found = bristle.diagnose(CASE / "model.toml", [CASE / "a.npz", CASE / "b.npz"])
    trace = found.traces[0]
    count = round(SHOWN / float(np.median(np.diff(trace.time))))
    error = np.convolve(np.nan_to_num(np.square(trace.before - trace.measured)), np.ones(count), "valid")
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
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=TEXT, frameon=False)
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


def main(names: list[str]) -> None:
    """Draw the pictures that are named, or both."""
    for draw in (run, diagnosis):
        if not names or draw.__name__ in names:
            draw()


if __name__ == "__main__":
    main(sys.argv[1:])
