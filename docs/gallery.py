"""Draw docs/images/effects/*.png, what each effect looks like in a residual: python docs/gallery.py
[EFFECT ...]

Two servos get the same input; one has the effect. Left: the positions of both. Right: the torque
that the model without the effect cannot account for along the motion of the other, J a + a2 v + Fc
sgn(v) - b u, over the quantity that the effect depends on.
"""

from __future__ import annotations

import io
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from bristle.model.native import Native
from bristle.plant.effect import Effect
from bristle.plant.effects import effects
from bristle.plant.servo import servo_program

Array = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent / "images" / "effects"
STEP = 1e-3  # s
SECONDS = 6.0
SMOOTHING = 9  # samples of the moving average of the residual torque
J, A2, B, FC = 0.001, 0.002, 0.0065, 0.004  # defaults of the servo and of the Coulomb law, SI
FORWARD, BACKWARD, PLAIN = "#1f6f8b", "#c8553d", "#9a9a9a"

# Sizes at which an effect is well visible beside a friction torque of 0.004 N.m; otherwise the
# defaults.
SIZES = {
    "saturation": {"limit": 2.5},
    "input_delay": {"delay": 0.008},
    "electrical_pole": {"time_constant": 0.008},
    "encoder_play": {"play": 0.3},
    "temperature_friction": {"temperature": 340.0, "dry_fall": 0.005},
    "torque_ripple": {"share": 0.3, "periods": 4.0},
}

# View of the residual -> label and unit of the axis over which the torque is drawn.
AXES = {
    "v": "velocity [rad/s]",
    "a": "acceleration [rad/s²]",
    "u": "input [V]",
    "du": "rate of the input [V/s]",
    "theta": "position [rad]",
    "t": "time [s]",
    "history": "travel since the last reversal [rad]",
    "direction": "velocity [rad/s]",
}
LEAST_TRAVEL = 1e-6  # rad: left end of the axis of travel


def excitation(seconds: float) -> tuple[Array, Array]:
    """Return time [s] and voltage [V], both of shape (n,): three sines that cover reversals, slow
    and fast motion.
    """
    t = np.arange(round(seconds / STEP)) * STEP
    return t, 2.6 * np.sin(2 * math.pi * 0.45 * t) + 1.3 * np.sin(
        2 * math.pi * 1.7 * t
    ) + 0.5 * np.sin(2 * math.pi * 4.3 * t)


def simulate(u: Array, effect: str | None) -> tuple[Array, Array]:
    """Return measured position [rad] and velocity [rad/s], shape (n,), at the samples of the
    input.
    """
    program = servo_program("coulomb", encoder=False, effects=(effect,) if effect else ())
    values = {f"{effect}.{name}": value for name, value in SIZES.get(effect or "", {}).items()}
    inputs = {"u": u, "tau_load": np.zeros_like(u), "load_scale": np.ones_like(u)}
    out, _ = Native(program, values).run(STEP, inputs, ["theta", "v"])
    return out[: len(u), 0], out[: len(u), 1]


def residual_torque(u: Array, v: Array) -> Array:
    """Return the torque [N.m], shape (n,), that the model without an effect lacks; nan where it
    stands still.
    """
    kernel = np.ones(SMOOTHING) / SMOOTHING
    torque = J * np.gradient(v, STEP) + A2 * v + FC * np.sign(v) - B * u
    moving = np.convolve(np.abs(v) > 1e-6, kernel, "same") > 0.99
    return np.where(moving, np.convolve(torque, kernel, "same"), np.nan)


def travel(theta: Array, v: Array) -> Array:
    """Return the distance [rad] from the position of the last reversal, shape (n,)."""
    turned = np.flatnonzero(np.diff(np.sign(v)) != 0) + 1
    last = np.concatenate([[0], turned])[np.searchsorted(turned, np.arange(len(v)), side="right")]
    return np.maximum(np.abs(theta - theta[last]), LEAST_TRAVEL)


def write(figure: Figure, file: Path) -> None:
    """Write a figure as PNG with few colours."""
    picture = io.BytesIO()
    figure.savefig(picture, dpi=110)
    Image.open(picture).convert("RGB").quantize(48).save(file, optimize=True)


def draw(effect: Effect) -> Figure:
    """Return the figure of an effect."""
    t, u = excitation(SECONDS)
    with_effect, without = simulate(u, effect.name), simulate(u, None)
    figure = Figure(figsize=(6.4, 2.1), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(t, without[0], color=PLAIN, lw=1.0, label="without")
    left.plot(t, with_effect[0], color="black", lw=1.0, label="with the effect")
    left.set(xlabel="time [s]", ylabel="position [rad]")
    view = next((part for part in effect.residual[0].split(" x ") if part in AXES), "t")
    v = with_effect[1]
    axes = {
        "v": v,
        "direction": v,
        "a": np.gradient(v, STEP),
        "u": u,
        "du": np.gradient(u, STEP),
        "theta": with_effect[0],
        "t": t,
    }
    x = travel(*with_effect) if view == "history" else axes[view]
    torque = 1e3 * residual_torque(u, v)
    for direction, colour, label in ((v > 0, FORWARD, "forward"), (v < 0, BACKWARD, "backward")):
        right.plot(x[direction], torque[direction], ".", color=colour, ms=1.5, label=label)
    right.set(xlabel=AXES[view], ylabel="residual [mN·m]", ylim=_limits(torque))
    if view == "history":
        right.set(xscale="log", xlim=(LEAST_TRAVEL, 3.0))
    for axis in (left, right):
        axis.legend(
            fontsize=7,
            frameon=False,
            markerscale=4,
            loc="lower left",
            bbox_to_anchor=(0, 0.98),
            ncols=2,
            borderpad=0,
        )
        axis.tick_params(labelsize=7)
        axis.xaxis.label.set_size(8)
        axis.yaxis.label.set_size(8)
        axis.spines[["top", "right"]].set_visible(False)
    return figure


def _limits(torque: Array) -> tuple[float, float]:
    """Return limits that leave out the few samples around reversals, and show nothing that is only
    rounding.
    """
    low, high = np.nanpercentile(torque, [1, 99])
    low, high = min(low, 0.0), max(high, 0.0)
    centre, half = (low + high) / 2, max(0.65 * (high - low), 0.05)
    return centre - half, centre + half


def main(names: list[str]) -> None:
    """Draw the effects that are named, or all."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    known: dict[str, Any] = effects(packages=False)
    for name in names or known:
        write(draw(known[name]), FOLDER / f"{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
