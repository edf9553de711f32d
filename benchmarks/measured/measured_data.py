"""Measured data sets as (name, time, u, y, extra): arrays in SI as
`bristle.diagnosis.records_from_arrays` takes them.
"""

from __future__ import annotations

import gzip
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Entry = tuple[str, Array, Array, Array, dict[str, Any]]

MEASURED_FOLDER = Path(
    os.environ.get("BRISTLE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")
)
ODRIVE_TURN = 8192.0  # counts


def runs(folder: Path) -> list[tuple[str, dict[str, Any], dict[str, Array]]]:
    """Return (name, settings, logged columns) of each run of a folder in the format of Rhoban's
    bam, in order of time.
    """
    found = []
    for path in sorted(folder.glob("*.json.gz")):
        with gzip.open(path, "rt", encoding="utf-8") as stream:
            content = json.load(stream)
        entries = content.pop("entries")
        columns = {
            key: np.array([entry[key] for entry in entries], dtype=float) for key in entries[0]
        }
        found.append((path.name.removesuffix(".json.gz"), content, columns))
    return found


def _stretch(on: NDArray[np.bool_]) -> slice:
    """Return the longest run of samples with the drive on."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]))).reshape(-1, 2)
    start, end = max(edges.tolist(), key=lambda run: run[1] - run[0], default=(0, 0))
    return slice(start, end)


def _run(
    name: str, settings: dict[str, Any], c: dict[str, Array], u: Array, shortest: float
) -> list[Entry]:
    """Return a run while its drive is on, if long enough; a drive that is off carries no current,
    whatever is logged.
    """
    on = _stretch(c["torque_enable"] > 0.5)
    if c["timestamp"][on][-1] - c["timestamp"][on][0] < shortest:
        return []
    extra = settings | {key: c[key][on] for key in ("goal_position", "speed")}
    return [
        (
            f"{settings['trajectory']}_{name[-8:]}",
            c["timestamp"][on],
            u[on],
            c["position"][on],
            extra,
        )
    ]


def go1(mass: float | None = None, shortest: float = 3.0) -> list[Entry]:
    """Return the Unitree Go1 pendulum: torque demand [N.m, ahead of the gear], position [rad];
    `mass` picks a payload [kg].
    """
    found = runs(MEASURED_FOLDER / "bam_go1_load")
    chosen = [run for run in found if mass is None or run[1]["mass"] == mass]
    return [
        entry
        for name, settings, c in chosen
        for entry in _run(name, settings, c, c["torque_demand"], shortest)
    ]


def xl330(kp: float | None = None, shortest: float = 3.0) -> list[Entry]:
    """Return the Dynamixel XL330 pendulum: drive voltage [V], position [rad]; `kp` picks a gain of
    the firmware.

    The column `load` is the register Present PWM as an unsigned 16 bit number: 885 is the whole
    supply, whose voltage is logged beside it. Where it is not at its limit it equals kp/256 times
    the position error in counts of a 4096th of a turn, with a correlation of 0.999, so that nothing
    has to be reconstructed. Position is read first and the PWM some 2 ms later, in the same turn of
    the loop.
    """
    entries = []
    for name, settings, c in runs(MEASURED_FOLDER / "bam_xl330_gain"):
        if kp is None or settings["kp"] == kp:
            raw = np.where(c["load"] > 32767, c["load"] - 65536, c["load"])
            entries += _run(name, settings, c, raw / 885.0 * c["input_volts"], shortest)
    return entries


def odrive(compensated: bool = False, start: float = 0.5) -> list[Entry]:
    """Return slow turns of a brushless motor: current Iq [A], position [rad], from `start` [s] on.

    Before that some runs turn back by one turn. With the compensation on, the current holds its
    anti-cogging part.
    """
    entries: list[Entry] = []
    for path in sorted(
        (MEASURED_FOLDER / "odrive_cogging" / "slow2").glob(
            "comp_*.npy" if compensated else "nocomp_*.npy"
        )
    ):
        time, counts, current = np.load(path, allow_pickle=False)
        use = time >= start
        position = counts[use] * 2 * np.pi / ODRIVE_TURN
        entries.append(
            (
                path.stem,
                time[use],
                current[use],
                position,
                {"compensated": compensated, "turn": ODRIVE_TURN},
            )
        )
    return entries


def emps() -> list[Entry]:
    """Return the linear axis EMPS: drive input [V] (35.15 N/V), position [m], reference in
    `extra`.
    """
    from scipy.io import loadmat

    content = loadmat(MEASURED_FOLDER / "emps" / "DATA_EMPS.mat")
    found = {
        key: np.asarray(value, dtype=float).ravel()
        for key, value in content.items()
        if not key.startswith("__")
    }
    extra = {"goal_position": found["qg"], "gain": float(found["gtau"][0])}
    return [("emps", found["t"], found["vir"], found["qm"], extra)]
