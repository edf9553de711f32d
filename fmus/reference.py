"""Short reference runs of the shipped FMUs, the check that a run stays within a tube around them,
and errors by step size.

``python -m bristle.fmus.reference`` accepts the present behaviour: it rewrites reference.csv in
each FMU's folder, and steps.csv in the plant's.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.signals import signals_of
from bristle.fmus.build import FMU_NAMES, program_of
from bristle.fmus.interface import Interface
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.plant.friction import laws

Array = NDArray[np.float64]

# communication step [s], their number in a run, steps between rows of the file
REFERENCE_RUN_STEP, REFERENCE_RUN_STEPS, STEPS_PER_ROW = 1e-3, 2000, 20
STEP_SIZES = (5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # s, of which the error is measured
FINEST_STEP = 6.25e-5  # s, of the run that they are compared with
# s between two times at which they are compared, a multiple of all step sizes
COMPARISON_STEP = 2e-2
TUBE_HALF_WIDTH = 1e-6  # half width of the tube over the range of the signal


def _voltage(t: NDArray[np.floating[Any]]) -> Array:
    return np.asarray(6.0 * np.sin(5.0 * t) + 2.0 * np.sin(23.0 * t))


def waves(t: NDArray[np.floating[Any]]) -> dict[str, Array]:
    """Return what inputs of the FMUs are in a short run at times t [s], by their names."""
    return {
        "u": _voltage(t),
        "tau_load": np.where(t < 1.0, 0.0, 0.002),
        "load_scale": np.where(t < 1.5, 1.0, 1.5),
        "y_theta": np.asarray(0.8 - 0.8 * np.cos(5.0 * t)),
        "y_v": np.asarray(4.0 * np.sin(5.0 * t)),
    }


def inputs(program: Program) -> dict[str, Array]:
    """Return the inputs of the reference run of a program, one value a step."""
    known = waves(REFERENCE_RUN_STEP * np.arange(REFERENCE_RUN_STEPS))
    return {x.name: known[x.name] for x in Interface(program).of("input") if x.name in known}


def reference_run(what: str) -> dict[str, Array]:
    """Simulate the program behind an FMU, without FMI: time, inputs and numeric outputs."""
    program = program_of(what)
    given = inputs(program)
    names = [x.name for x in Interface(program).of("output")]
    record, _ = Native(program).run(REFERENCE_RUN_STEP, given, names)
    columns: dict[str, Array] = {
        "time": REFERENCE_RUN_STEP * np.arange(REFERENCE_RUN_STEPS + 1, dtype=np.float64)
    }
    columns |= {name: np.array([*values, values[-1]]) for name, values in given.items()}
    columns |= {
        name: values
        for name, values in zip(names, record.T, strict=True)
        if np.all(np.isfinite(values))
    }
    return {name: values[::STEPS_PER_ROW] for name, values in columns.items()}


def read_reference(what: str) -> dict[str, Array]:
    """Return the columns of an FMU's reference.csv."""
    time, columns = signals_of(
        (files("bristle.fmus") / what / "reference.csv").read_bytes(), "reference.csv"
    )
    return {"time": time, **columns}


def outside(reference: Mapping[str, Array], result: Mapping[str, Array]) -> dict[str, float]:
    """Return the signals of `reference` that `result` misses, with their largest distance over the
    tube's half width.

    A missing signal, a missing row or a NaN is outside.
    """
    found = {}
    for name, expected in reference.items():
        got = result.get(name)
        if got is None or len(got) != len(expected):
            found[name] = np.inf
            continue
        width = TUBE_HALF_WIDTH * max(
            float(np.ptp(expected)), float(np.max(np.abs(expected))), np.finfo(float).tiny
        )
        distance = np.abs(got - expected) / width
        if not np.all(distance <= 1.0):
            found[name] = float(np.max(np.where(np.isnan(distance), np.inf, distance)))
    return found


def step_errors(law: str, held: bool) -> list[float]:
    """Return the rms error of the plant's velocity over the rms velocity, by communication step
    (`STEP_SIZES`).

    The input is a sum of two sines, of which a host gives the value at the start of each step;
    `held`: it changes only at the times at which velocities are compared, so that what is left is
    the error of the integration.
    """
    program, end = program_of("plant", law), REFERENCE_RUN_STEP * REFERENCE_RUN_STEPS

    def velocity(step: float) -> Array:
        k, ratio = np.arange(round(end / step)), round(COMPARISON_STEP / step)
        t = COMPARISON_STEP * (k // ratio) if held else step * k
        record, _ = Native(program).run(step, {"u": _voltage(t)}, ["v"])
        return np.asarray(record[::ratio, 0])

    exact = velocity(FINEST_STEP)
    return [
        float(np.sqrt(np.mean((velocity(step) - exact) ** 2) / np.mean(exact**2)))
        for step in STEP_SIZES
    ]


def write_step_errors(folder: Path) -> None:
    """Write steps.csv into the plant's folder: a row a step size, the largest error of all laws."""
    worst = [np.max([step_errors(law, held) for law in laws()], axis=0) for held in (False, True)]
    rows = [
        ",".join([f"{step:g}", *(f"{error:.2g}" for error in errors)])
        for step, *errors in zip(STEP_SIZES, *worst, strict=True)
    ]
    text = "\n".join(["step [s],error,error of the integration", *rows]) + "\n"
    (folder / "steps.csv").write_text(text, encoding="utf-8", newline="\n")


def write_reference(what: str, folder: Path) -> None:
    """Write reference.csv into an FMU's folder."""
    columns = reference_run(what)
    lines = [",".join(f'"{name}"' for name in columns)]
    lines += [
        ",".join(f"{value:.12g}" for value in row) for row in zip(*columns.values(), strict=True)
    ]
    (folder / "reference.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    for each in FMU_NAMES:
        write_reference(each, Path(__file__).parent / each)
    write_step_errors(Path(__file__).parent / "plant")
