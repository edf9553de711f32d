"""How far estimates of a servo are off, and how often their intervals cover, on servos of many
kinds in many loops.

    python benchmarks/estimates.py [--pairs 240] [--seed 1] > benchmarks/results/estimates.md

Each pair of records is of a servo drawn at random, from the generator of the blind test: direct
drive, geared motor in which friction dominates, belt axis or pendulum, in a PID loop of 4 to 40 Hz
or driven in open loop, with a disturbance of 3 to 10 % of Fc and a corner of 0.5 to 30 Hz, an
encoder of 1000 to 131072 counts, sampled every 0.25 to 5 ms. Nothing is missing in the model, whose
nominal values are up to a factor of 1.5 off. What is compared is what a diagnosis takes from the
sliding motion.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parent / "blind"))

import scene
import truth
from scene import Generator, log_uniform
from threadpoolctl import threadpool_limits

from bristle.diagnosis import Model, Record, records_from_arrays
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.estimation.fitted_model import sliding_fit

Array = np.ndarray


@dataclass(frozen=True)
class Kind:
    """A servo: its middle parameters, the torque of its drive, how far and fast it goes beside the
    direct drive, and the torque of gravity.
    """

    parameters: Mapping[str, float]
    limit: float
    reach: float = 1.0
    gravity: float = 0.0


KINDS = {
    "direct drive": Kind({"J": 0.01, "a2": 0.02, "Fc": 0.12}, 1.2),
    "geared motor": Kind({"J": 2e-5, "a2": 2e-4, "Fc": 0.01}, 0.1),
    "belt axis": Kind({"J": 5e-3, "a2": 0.1, "Fc": 0.3}, 3.0, 1.5),
    "pendulum": Kind({"J": 0.02, "a2": 0.01, "Fc": 0.05}, 1.2, 0.3, 0.25),
}
LOOPS = ("4-10 Hz", "10-40 Hz", "open loop")
NAMES = {"J": "J", "a2": "a2", "Fc": "coulomb.Fc"}
OFF = 1.5  # factor by which nominal values are off at most
PERIODS: tuple[float, ...] = (0.25e-3, 0.5e-3, 1e-3, 2e-3, 5e-3)


@dataclass(frozen=True)
class Drawn:
    """A pair of records and the truth."""

    kind: str
    loop: str
    disturbance: float  # rms over Fc
    corner: float  # Hz
    counts: float
    h: float
    true: dict[str, float]
    records: list[tuple[Array, Array]]  # input, output


# what is hidden: of a servo's true parameters and the unit of time, the fields of truth.c
Hide = Callable[[Mapping[str, float], float], dict[str, float]]


def draw(rng: Generator, kinds: Sequence[str] = tuple(KINDS), hide: Hide | None = None) -> Drawn:
    """Return a pair of records of a random servo, with what `hide` puts into it.

    The generator samples every millisecond: in another unit of time, that is any other period.
    """
    kind, loop = str(rng.choice(list(kinds))), str(rng.choice(LOOPS))
    servo, h = KINDS[kind], float(rng.choice(PERIODS))
    unit = h / truth.PERIOD  # s, what the generator takes for a second
    true = {name: x * log_uniform(rng, 0.7, 1.3) for name, x in servo.parameters.items()}
    share, corner = log_uniform(rng, 0.03, 0.1), log_uniform(rng, 0.5, 30.0)
    counts = round(log_uniform(rng, 1000, 131072))
    plant = {"J": true["J"] / unit**2, "a2": true["a2"] / unit, "Fc": true["Fc"]}
    plant |= truth.base_friction(plant["J"], plant["Fc"])
    if servo.gravity:
        plant |= {"gravity_amplitude": servo.gravity, "gravity_phase": rng.uniform(-3, 3)}
    hidden = hide(true, unit) if hide else {}
    truth.RESOLUTION, truth.CORNER = 2 * math.pi / counts, corner * unit
    records = []
    for start in scene.STARTS:
        reference = in_unit(scene.rich(rng), unit, servo.reach)
        noise = truth.disturbance(rng, len(reference) + 1, share * true["Fc"])
        gains = loop_of(rng, plant, loop, servo.limit, unit)
        record = truth.run(plant | hidden, gains, start, reference, noise)
        u, theta = record.u, record.theta
        if loop == "open loop":  # what a loop asked for, played back under another disturbance
            noise = truth.disturbance(rng, len(reference) + 1, share * true["Fc"])
            theta = truth.play(plant | hidden, start, u, noise, float(reference[0, 0]))
        records.append((u, theta))
    return Drawn(kind, loop, share, corner, counts, h, true | gravity_of(plant), records)


def gravity_of(plant: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of gravity among those of a plant."""
    return {k: plant[f"gravity_{k}"] for k in ("amplitude", "phase") if f"gravity_{k}" in plant}


def in_unit(reference: Array, unit: float, reach: float) -> Array:
    """Return a reference of 1 ms in another unit of time: position, velocity and acceleration."""
    count = round(len(reference) / unit)
    at = np.minimum(np.arange(count) * unit, len(reference) - 1.0)
    columns = [np.interp(at, np.arange(len(reference)), column) for column in reference.T]
    return np.ascontiguousarray(np.column_stack(columns) * reach * [1.0, unit, unit**2])


def loop_of(
    rng: Generator, plant: Mapping[str, float], loop: str, limit: float, unit: float
) -> dict[str, float]:
    """Return a PID position controller, in the generator's unit of time."""
    lowest, highest = (10.0, 40.0) if loop == "10-40 Hz" else (4.0, 10.0)
    # a loop is no faster than a fiftieth of the sampling rate
    omega = min(2 * math.pi * unit * log_uniform(rng, lowest, highest), 2 * math.pi * 20.0)
    kp = plant["J"] * omega**2
    return {
        "kp": kp,
        "ki": kp * unit * rng.uniform(0.5, 3.0) if rng.random() < 0.5 else 0.0,
        "kd": 2 * rng.uniform(0.7, 1.1) * plant["J"] * omega,
        "filter": 0.2 / omega,
        "limit": limit,
        "forward_J": plant["J"] * rng.uniform(0.7, 1.0),
        "forward_a2": plant["a2"],
        "forward_Fc": plant["Fc"] * rng.uniform(0.5, 1.0),
    }


def model_of(rng: Generator, drawn: Drawn) -> Model:
    """Return the model of a servo with nominal values that are off."""
    near = {name: drawn.true[name] * log_uniform(rng, 1 / OFF, OFF) for name in NAMES}
    tree: dict[str, object] = {
        "friction": "coulomb",
        "parameters": near,
        "bounds": {"J": [near["J"] / 5, near["J"] * 5], "a2": [0.0, 10 * near["a2"]]}
        | {"Fc": [0.0, 10 * near["Fc"]]},
        "time": {"column": "t", "unit": "s"},
        "input": {"column": "u", "kind": "torque", "unit": "N.m"},
        "output": {"column": "y", "kind": "position", "unit": "rad"}
        | {"resolution": 2 * math.pi / drawn.counts},
    }
    if "amplitude" in drawn.true:
        amplitude = drawn.true["amplitude"] * log_uniform(rng, 1 / OFF, OFF)
        tree["effects"] = {"gravity": {"amplitude": amplitude, "phase": drawn.true["phase"] + 0.3}}
    return Model.from_dict(tree)


def measured(rng: Generator, drawn: Drawn) -> tuple[Model, list[Record]]:
    """Return the model of a servo and what was recorded of it."""
    model = model_of(rng, drawn)
    t = [start + drawn.h * np.arange(len(drawn.records[0][0])) for start in (0.0, 100.0)]
    columns = [(f"run {k}", t[k], u, y) for k, (u, y) in enumerate(drawn.records)]
    return model, records_from_arrays(model, columns)


@dataclass(frozen=True)
class Estimated:
    """Errors relative to the truth and in standard deviations, of J, a2, Fc; seconds of CPU."""

    drawn: Drawn
    errors: Array
    deviations: Array
    seconds: float


def estimated(rng: Generator) -> Estimated | None:
    """Return what is estimated of a random servo; None where too little of it slides."""
    drawn = draw(rng)
    model, records = measured(rng, drawn)
    dataset = dataset_of(model, records)
    begun = time.process_time()
    fit = sliding_fit(dataset, *base_servo_of(model, dataset))
    if fit is None:
        return None
    known, seconds = fit.deviations(), time.process_time() - begun
    off = np.array([fit.values[full] - drawn.true[name] for name, full in NAMES.items()])
    true = np.array([drawn.true[name] for name in NAMES])
    return Estimated(drawn, off / true, off / [known[full] for full in NAMES.values()], seconds)


def row(name: str, pairs: list[Estimated]) -> str:
    """Return a line of the table."""
    rms = 100 * np.sqrt(np.mean(np.square([p.errors for p in pairs]), axis=0))
    median = 100 * np.median(np.abs([p.errors for p in pairs]), axis=0)
    covered = np.sum(np.abs([p.deviations for p in pairs]) < 1.96, axis=0)
    three = [" / ".join(f"{x:.2g}" for x in each) for each in (rms, median)]
    return f"| {name} | {len(pairs)} | {three[0]} | {three[1]} | {' / '.join(map(str, covered))} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=240)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    done, still = list[Estimated](), 0
    with threadpool_limits(1, user_api="blas"):
        for k in range(given.pairs):
            one = estimated(np.random.default_rng([given.seed, k]))
            still += one is None
            done += [one] if one else []
            print(f"{k + 1} of {given.pairs}", file=sys.stderr, end="\r", flush=True)
    print("# Estimates of servos of many kinds\n")
    print(f"`python benchmarks/estimates.py --pairs {given.pairs} --seed {given.seed}`:", end=" ")
    print("\n\n".join(__doc__.split("\n\n")[2:]))
    print("| | pairs | rms error of J / a2 / Fc, % | median, % | 95 % intervals that cover |")
    print("|---|---|---|---|---|")
    for title, of in (
        ("servo", lambda d: d.kind),
        ("loop", lambda d: d.loop),
        ("period", lambda d: f"{1e3 * d.h:g} ms"),
        ("counts", lambda d: "below 8000" if d.counts < 8000 else "8000 and more"),
        ("disturbance", lambda d: "below 3 Hz" if d.corner < 3 else "3 Hz and more"),
    ):
        for value in sorted({of(p.drawn) for p in done}):
            print(row(f"{title}: {value}", [p for p in done if of(p.drawn) == value]))
    print(row("all", done))
    seconds = [p.seconds for p in done]
    print(
        f"\nToo little slides in {still} pairs. CPU: {np.median(seconds):.2f} s in the median,",
        end=" ",
    )
    print(f"{max(seconds):.1f} s at most.")


if __name__ == "__main__":
    main()
