"""What a servo did, in numbers that no sample shows: sticking, break-away, cycle, energy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STICK_SPEED = 0.01  # share of the rms velocity below which the servo counts as standing still
STICK_SECONDS = 0.02  # s that it must stand still to stick; a passage through zero is shorter
CYCLE_PERIODS = 5  # periods of a limit cycle, at least
CYCLE_SPREAD = 0.05  # standard deviation of these periods over their mean, at most
# share of the amplitude by which the velocity must pass its mean, so that noise makes no period
CYCLE_THRESHOLD = 0.1
LEAST_CYCLE = 1e-6  # amplitude of a limit cycle over the largest velocity of the run, at least
# what moves a servo from outside
MOVING_INPUTS = ("reference", "u_ff", "reference_scale", "tau_load", "load_scale")


@dataclass(frozen=True)
class Quantity:
    """A number with its unit; None where it does not exist, and why."""

    unit: str
    value: float | None
    why: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return it as result.json has it."""
        if self.value is not None and not math.isfinite(self.value):
            return {"unit": self.unit, "value": None, "why": "a signal is not finite"}
        return {"unit": self.unit, "value": self.value} | ({"why": self.why} if self.why else {})


@dataclass(frozen=True)
class PlantMotion:
    """A simulated run of a plant: step h [s], signals of shape (n,), J [kg.m2] and b [N.m/V] where
    the plant says what they are.
    """

    h: float
    signals: Mapping[str, Array]
    inertia: float | None
    gain: float | None
    u_max: float = math.inf
    open_loop: bool = False
    speed_unit: str = "rad/s"
    torque_unit: str = "N.m"


def behaviour(motion: PlantMotion) -> dict[str, Quantity]:
    """Return stick share, break-away torque, amplitude and period of a limit cycle, and the energy
    balance.

    The break-away torque holds the viscous torque at the velocity at which standstill ends.
    """
    return _sticking(motion) | _cycle(motion) | _energy(motion)


def stick_intervals(v: Array, h: float) -> list[tuple[int, int]]:
    """Return the rows (first, end) over which |v| stays low for `STICK_SECONDS` or longer."""
    slow = np.abs(v) < STICK_SPEED * float(np.sqrt(np.mean(v**2)))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(int)))
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(first, end) for first, end in pairs if (end - first) * h >= STICK_SECONDS]


def _sticking(motion: PlantMotion) -> dict[str, Quantity]:
    v, force = motion.signals["v"], motion.signals.get("F")
    intervals = stick_intervals(v, motion.h)
    if not intervals:
        why = f"it never stands still for {STICK_SECONDS:g} s"
        return {
            "stick_share": Quantity("1", None, why),
            "break_away_torque": Quantity(motion.torque_unit, None, why),
        }
    share = Quantity("1", sum(end - first for first, end in intervals) / len(v))
    left = [(first, end) for first, end in intervals if end < len(v)]
    if force is None or not left:
        why = (
            "the plant has no output F"
            if force is None
            else "it never moves again after it has stuck"
        )
        return {"stick_share": share, "break_away_torque": Quantity(motion.torque_unit, None, why)}
    peaks = [float(np.abs(force[first : end + 1]).max()) for first, end in left]
    return {
        "stick_share": share,
        "break_away_torque": Quantity(motion.torque_unit, float(np.median(peaks))),
    }


def _cycle(motion: PlantMotion) -> dict[str, Quantity]:
    """Return amplitude (half of peak to peak velocity) and period, over the run's second half."""
    late = slice(len(motion.signals["v"]) // 2, None)
    demands = [*MOVING_INPUTS, *(["u"] if motion.open_loop else [])]
    moving = [
        name for name in demands if name in motion.signals and np.ptp(motion.signals[name][late])
    ]
    if moving:
        return _no_cycle(
            motion,
            f"{moving[0]} moves in the second half of the run: what follows it is no limit cycle",
        )
    v = motion.signals["v"][late] - np.mean(motion.signals["v"][late])
    amplitude = 0.5 * float(np.ptp(v))
    if not amplitude > LEAST_CYCLE * float(np.abs(motion.signals["v"]).max()):
        return _no_cycle(motion, "its velocity is constant in the second half of the run")
    periods = np.diff(_upward(v, CYCLE_THRESHOLD * amplitude)) * motion.h
    if len(periods) < CYCLE_PERIODS or np.std(periods) > CYCLE_SPREAD * np.mean(periods):
        return _no_cycle(
            motion,
            f"its velocity does not repeat {CYCLE_PERIODS} times at equal intervals in the second"
            " half of the run",
        )
    return {
        "limit_cycle_amplitude": Quantity(motion.speed_unit, amplitude),
        "limit_cycle_period": Quantity("s", float(np.mean(periods))),
    }


def _no_cycle(motion: PlantMotion, why: str) -> dict[str, Quantity]:
    return {
        "limit_cycle_amplitude": Quantity(motion.speed_unit, None, why),
        "limit_cycle_period": Quantity("s", None, why),
    }


def _upward(v: Array, threshold: float) -> NDArray[np.intp]:
    """Return the rows at which v rises above `threshold` after it was below -threshold."""
    state = np.where(v > threshold, 1, np.where(v < -threshold, -1, 0))
    rows = np.flatnonzero(state)
    return rows[1:][np.diff(state[rows]) > 0]


def _energy(motion: PlantMotion) -> dict[str, Quantity]:
    """Return the work of drive and friction, and what of the first neither friction, load nor
    kinetic energy account for.

    The voltage of a row acts until the next one; friction is taken as linear between two rows.
    """
    needed = {
        "J": motion.inertia,
        "b": motion.gain,
        "output F": motion.signals.get("F"),
        "u": motion.signals.get("u"),
    }
    missing = [name for name, given in needed.items() if given is None]
    if missing:
        why = f"the plant has no {' and no '.join(missing)}"
        return {
            name: Quantity(unit, None, why)
            for name, unit in (
                ("drive_work", "J"),
                ("friction_work", "J"),
                ("energy_residual_percent", "%"),
            )
        }
    # works over each step, with the voltage held and the mean of the friction torque
    assert motion.inertia is not None
    assert motion.gain is not None
    v, force, moved = motion.signals["v"], motion.signals["F"], np.diff(motion.signals["theta"])
    power = motion.gain * np.clip(motion.signals["u"][:-1], -motion.u_max, motion.u_max) * moved
    drive, friction = float(np.sum(power)), float(np.sum(0.5 * (force[1:] + force[:-1]) * moved))
    load = (
        float(np.sum(motion.signals["tau_load"][:-1] * moved))
        if "tau_load" in motion.signals
        else 0.0
    )
    # what is left of the balance, over the work of the drive without its sign
    kinetic = 0.5 * motion.inertia * float(v[-1] ** 2 - v[0] ** 2)
    size = float(np.sum(np.abs(power)))
    residual = (
        Quantity("%", 100 * (drive + load - friction - kinetic) / size)
        if size
        else Quantity("%", None, "the drive does no work")
    )
    return {
        "drive_work": Quantity("J", drive),
        "friction_work": Quantity("J", friction),
        "energy_residual_percent": residual,
    }
