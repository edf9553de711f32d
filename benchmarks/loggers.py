"""Pairs of log files of one simulated servo, as ten loggers write them: what bristle init and
diagnose make of them.

    python benchmarks/loggers.py             # bristle init on each pair, against the truth
    python benchmarks/loggers.py --diagnose  # and a diagnosis with the proposed file as it is

The servo is that of the blind test (benchmarks/blind/truth.c), with a cogging torque that the
proposed model does not have.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent / "blind"))

from scene import Scene, draw_scene
from truth import COUNTS, PERIOD, Record

from bristle.common.errors import BristleError
from bristle.diagnosis.init.proposal import Proposal, propose
from bristle.diagnosis.report.proposed_model import resolution_of, write_model

Array = NDArray[np.float64]
DEG = 180.0 / np.pi
RPM = 30.0 / np.pi
SERVO = {"J": 0.01, "a2": 0.02, "Fc": 0.12}  # kg.m2, N.m.s/rad, N.m
COGGING = {"cogging_amplitude": 0.05, "cogging_periods": 7.0}  # N.m, periods a turn
TORQUE_CONSTANT = 0.25  # N.m/A, of the motors whose current is logged
DRIVE_GAIN = 0.1  # N.m/V, of those whose voltage is logged
TACHO = 0.2  # V.s/rad
START = np.datetime64("2026-11-24T17:50:41.000000000")


@dataclass(frozen=True)
class Style:
    """How a logger writes a record, and what `propose` should say of it.

    `write` takes path, time [s], torque [N.m], position [rad] and speed [rad/s]. `gain`: torque per
    unit of the input; `worth`: output in its own SI unit per rad (1, unless it is the voltage of a
    sensor); `step`: of the output as logged, in the unit of its column, None if there is none to be
    found.
    """

    suffix: str
    write: Callable[[Path, Array, Array, Array, Array], None]
    columns: tuple[str, str, str]
    kinds: tuple[str, str]
    units: tuple[str, str, str]
    step: float | None
    gain: float = 1.0
    worth: float = 1.0


@cache
def servo_records(seed: int = 5) -> tuple[Record, Record]:
    """Return two records of the servo, 20 s each at 1 kHz."""
    drawn = draw_scene(np.random.default_rng(seed), "rich")
    scale = SERVO["Fc"] / drawn.base["Fc"]
    scene = Scene(
        SERVO,
        drawn.friction | {"sigma0": drawn.friction["sigma0"] * scale},
        drawn.loop,
        drawn.references,
        drawn.noises,
    )
    first, second = scene.records(COGGING)
    return first, second


def _text(
    path: Path, head: str, rows: Sequence[Sequence[str]], mark: str, encoding: str = "utf-8"
) -> None:
    path.write_bytes((head + "".join(mark.join(row) + "\n" for row in rows)).encode(encoding))


def _fixed(values: Array, digits: int, comma: bool = False) -> list[str]:
    texts = [f"{value:.{digits}f}" for value in values]
    return [text.replace(".", ",") for text in texts] if comma else texts


def _german(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    columns = [
        _fixed(t, 3, True),
        _fixed(torque, 4, True),
        _fixed(theta * DEG, 4, True),
        ["läuft"] * len(t),
    ]
    head = "Prüfstand 3;;;\nZeit [s];Drehmoment [Nm];Winkel [°];Zustand\n"
    _text(path, head, list(zip(*columns, strict=True)), ";", "cp1252")


def _oscilloscope(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    volts = [
        _fixed(1e3 * t, 3),
        _fixed(torque / DRIVE_GAIN, 3),
        _fixed(np.round(TACHO * speed / 0.005) * 0.005, 3),
    ]
    _text(path, "Time,Channel A,Channel B\n(ms),(V),(V)\n\n", list(zip(*volts, strict=True)), ",")


def _ros(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    stamps = START.astype(np.int64) + np.round(t * 1e9).astype(np.int64)
    # when they arrived
    late = [str(stamp + 40_000 + 90_000 * (k * k % 7)) for k, stamp in enumerate(stamps)]
    index = [str(k) for k in range(len(t))]
    columns = [
        late,
        index,
        [str(s) for s in stamps],
        ["joint"] * len(t),
        *(_fixed(x, 9) for x in (theta, speed, torque)),
    ]
    fields = "header.seq header.stamp name0 position0 velocity0 effort0"
    head = ",".join(["%time", *(f"field.{name}" for name in fields.split())]) + "\n"
    _text(path, head, list(zip(*columns, strict=True)), ",")


def _struct(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    from scipy.io import savemat

    savemat(
        path,
        {
            "log": {"time": t[:, None], "torque": torque[:, None], "theta": theta[:, None]},
            "Ts": PERIOD,
        },
        do_compression=True,
    )


def _version_73(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (
            ("t", t),
            ("i_q", torque / TORQUE_CONSTANT),
            ("theta", theta),
            ("theta_ref", np.round(theta, 1)),
        ):
            file.create_dataset(name, data=values[None, :], compression="gzip")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def _workbook(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    sheet = book.create_sheet("log")
    sheet.append(["Time [ms]", "Motor current [A]", "Position [deg]", "Remark"])
    for row in zip(1e3 * t, np.round(torque / TORQUE_CONSTANT, 4), theta * DEG, strict=True):
        sheet.append([*map(float, row), "ok"])
    book.save(path)


def _tabs(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    columns = [_fixed(t, 4), _fixed(torque / TORQUE_CONSTANT, 4), _fixed(speed * RPM, 2)]
    _text(
        path,
        "# Lauf 7\nZeit\tStrom\tDrehzahl\ns\tA\tU/min\n",
        list(zip(*columns, strict=True)),
        "\t",
    )


def _iso(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    stamps = (START + np.round(t * 1e6).astype("timedelta64[us]")).astype("datetime64[us]")
    columns = [
        [f"{stamp}Z" for stamp in stamps],
        ["RUN"] * len(t),
        _fixed(torque, 5),
        _fixed(theta, 6),
    ]
    _text(path, "timestamp,state,torque_Nm,angle_rad\n", list(zip(*columns, strict=True)), ",")


def _rpm(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    columns = [
        [str(round(1e3 * x)) for x in t],
        _fixed(torque / DRIVE_GAIN, 3),
        _fixed(speed * RPM, 1),
    ]
    _text(path, "t_ms,voltage_V,speed_rpm\n", list(zip(*columns, strict=True)), ",")


def _blanks(path: Path, t: Array, torque: Array, theta: Array, speed: Array) -> None:
    counts = [str(int(x)) for x in (theta / (2 * np.pi) * COUNTS + 0.25) % COUNTS]
    u = _fixed(torque, 4)
    for k in range(700, len(t), 5000):
        counts[k] = u[k + 9] = u[k + 10] = ""
    columns = [_fixed(t, 3), u, counts, [""] * len(t)]
    _text(
        path,
        "Time (s)\tTorque (N.m)\tEncoder (counts)\t\n",
        list(zip(*columns, strict=True)),
        "\t",
        "utf-16",
    )


STEP = 360.0 / COUNTS  # deg, of the encoder
STYLES = {
    "german spreadsheet": Style(
        ".csv",
        _german,
        ("Zeit [s]", "Drehmoment [Nm]", "Winkel [°]"),
        ("torque", "position"),
        ("s", "N.m", "deg"),
        STEP,
    ),
    "oscilloscope": Style(
        ".csv",
        _oscilloscope,
        ("Time", "Channel A", "Channel B"),
        ("voltage", "velocity"),
        ("ms", "V", "V"),
        0.005,
        DRIVE_GAIN,
        TACHO,
    ),
    "ROS": Style(
        ".csv",
        _ros,
        ("field.header.stamp", "field.effort0", "field.position0"),
        ("torque", "position"),
        ("ns", "N.m", "rad"),
        STEP / DEG,
    ),
    "MATLAB struct": Style(
        ".mat",
        _struct,
        ("log.time", "log.torque", "log.theta"),
        ("torque", "position"),
        ("s", "N.m", "rad"),
        STEP / DEG,
    ),
    "MATLAB 7.3": Style(
        ".mat",
        _version_73,
        ("t", "i_q", "theta"),
        ("current", "position"),
        ("s", "A", "rad"),
        STEP / DEG,
        TORQUE_CONSTANT,
    ),
    "workbook": Style(
        ".xlsx",
        _workbook,
        ("Time [ms]", "Motor current [A]", "Position [deg]"),
        ("current", "position"),
        ("ms", "A", "deg"),
        STEP,
        TORQUE_CONSTANT,
    ),
    "tabs and units": Style(
        ".txt",
        _tabs,
        ("Zeit", "Strom", "Drehzahl"),
        ("current", "velocity"),
        ("s", "A", "rpm"),
        0.01,
        TORQUE_CONSTANT,
    ),
    "ISO time": Style(
        ".csv",
        _iso,
        ("timestamp", "torque_Nm", "angle_rad"),
        ("torque", "position"),
        ("s", "N.m", "rad"),
        STEP / DEG,
    ),
    "ms and rpm": Style(
        ".csv",
        _rpm,
        ("t_ms", "voltage_V", "speed_rpm"),
        ("voltage", "velocity"),
        ("ms", "V", "rpm"),
        0.1,
        DRIVE_GAIN,
    ),
    "counts and blanks": Style(
        ".txt",
        _blanks,
        ("Time (s)", "Torque (N.m)", "Encoder (counts)"),
        ("torque", "position"),
        ("s", "N.m", "1"),
        1.0,
    ),
}


def write_pair(style: Style, folder: Path, seconds: float = 20.0) -> list[Path]:
    """Write two records as a logger does; return the files."""
    paths = []
    for number, record in enumerate(servo_records(), start=1):
        n = round(seconds / PERIOD)
        paths.append(folder / f"run{number}{style.suffix}")
        t: Array = PERIOD * np.arange(n, dtype=float) + (number - 1) * 60.0
        style.write(paths[-1], t, record.u[:n], record.theta[:n], record.states[:n, 1])
    return paths


def mistakes(style: Style, found: Proposal, factor: float = 2.0) -> list[str]:
    """Return what a proposal has wrong: columns, kinds, units, step, and parameters that are off by
    more than a factor.
    """
    chosen = (found.time, found.input, found.output)
    said = {
        "columns": tuple(each.column.column for each in chosen),
        "kinds": (found.input.kind, found.output.kind),
        "units": tuple(each.column.unit for each in chosen),
    }
    wrong = [f"{name} {value}" for name, value in said.items() if value != getattr(style, name)]
    shown = resolution_of(found)
    step = None if shown is None else float(shown[1])
    if (step is None) != (style.step is None) or (
        step and style.step and abs(step / style.step - 1.0) > 0.05
    ):
        wrong.append(f"step {step}")
    for name, ratio in ratios(style, found).items():
        if not 1.0 / factor < ratio < factor:
            wrong.append(f"{name} x{ratio:.3g}")
    return wrong


def ratios(style: Style, found: Proposal) -> Mapping[str, float]:
    """Return the rough parameters over the true ones, in the units in which the record holds
    them.
    """
    true = {
        "J": SERVO["J"] / style.gain / style.worth,
        "a2": SERVO["a2"] / style.gain / style.worth,
        "Fc": SERVO["Fc"] / style.gain,
    }
    return {name: found.rough[name].value / value for name, value in true.items()}


def _diagnosed(model: Path, paths: Sequence[Path], out: Path) -> str:
    """Diagnose with the proposed file as it is; return the answer, or the error."""
    command = ["bristle", "diagnose", str(model), "--data", *map(str, paths), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode or not (out / "report.html").exists():
        return f"error: {done.stderr.strip()}"
    said = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    return str(said["verdict"]) + "".join(f" {effect['name']}" for effect in said["effects"])


def main() -> int:
    """Write all pairs, propose a model for each, compare it with the truth; print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("styles", nargs="*", help="names of loggers; all without one")
    parser.add_argument(
        "--diagnose", action="store_true", help="diagnose with the proposed file as it is"
    )
    arguments = parser.parse_args()
    right = reports = 0
    chosen = {
        name: style
        for name, style in STYLES.items()
        if not arguments.styles or name in arguments.styles
    }
    print(
        "| files | input, output | J, a2, Fc over the truth | proposal | diagnosis"
        " |\n|---|---|---|---|---|"
    )
    for name, style in chosen.items():
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            paths = write_pair(style, folder)
            try:
                found = propose(paths)
                write_model(found, folder / "model.toml")
            except BristleError as error:
                print(f"| {name} | | | {error} | |", flush=True)
                continue
            wrong = mistakes(style, found)
            right += not wrong
            shown = ", ".join(f"{ratio:.2f}" for ratio in ratios(style, found).values())
            said = (
                _diagnosed(folder / "model.toml", paths, folder / "out")
                if arguments.diagnose
                else ""
            )
            reports += bool(said) and not said.startswith("error")
            print(
                f"| {name} | {', '.join(style.kinds)} | {shown} | {'; '.join(wrong) or 'right'} |"
                f" {said} |",
                flush=True,
            )
    print(
        f"\n{right} of {len(chosen)} proposals right"
        + (f", {reports} reports." if arguments.diagnose else ".")
    )
    return 0 if right == len(chosen) else 1


if __name__ == "__main__":
    sys.exit(main())
